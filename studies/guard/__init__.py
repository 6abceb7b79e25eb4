"""Accuracy kept. In: a run and what was accepted. Out: what is worse, better, missing or not comparable."""
