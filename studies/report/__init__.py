"""The report: reads the store, writes one HTML file."""
