"""The workbench: study files in, comparison reports out."""
