"""The page of a run. In: a run as read back. Out: one HTML file. It reads store and verdict only."""
