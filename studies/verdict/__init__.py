"""What it means, in numbers and words, without drawing. In: a run as read back. Out: what is said of it."""
