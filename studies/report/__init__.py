"""How it is shown. In: a run as read back. Out: one HTML file. It reads store and verdict only."""
