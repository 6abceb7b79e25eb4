"""The Volume Distribution Method: a surface-only model of soft tissue (Sundaraj and Laugier 2006)."""
