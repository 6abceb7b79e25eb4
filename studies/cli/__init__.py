"""The command `vdmbench`. In: words of a command line. Out: text, JSON, exit codes."""
