"""Solvers shared by the VDM formulations."""
