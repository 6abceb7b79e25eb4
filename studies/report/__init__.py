"""The report: a run's stored results in, one offline HTML page out. Imports no solver."""
