"""Fits of the surface models' parameters to the reference."""
