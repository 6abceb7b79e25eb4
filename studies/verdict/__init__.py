"""The meaning of a run, in numbers and words, without drawings. In: a run as read back. Out: its verdicts."""
