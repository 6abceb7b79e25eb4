"""Solvers shared by the VDM formulations."""

SOLVERS: tuple[str, ...] = (
    "linear",
    "single",
    "refined",
    "lu",
    "quasi-linear",
    "nonlinear",
    "bicg",
    "bicg-cold",
    "cg",
    "minres",
)
