"""Solvers shared by the VDM formulations, and that of the printed form alone."""

SOLVERS: tuple[str, ...] = (
    "linear",
    "single",
    "refined",
    "lu",
    "quasi-linear",
    "nonlinear",
    "bicg",
    "bicg-cold",
)
FIGURE_8 = "figure-8"
