"""What a model's name tells, for those who may not ask the registry: the report reads results alone."""

from __future__ import annotations

FINITE_STRAIN = ("fem",)  # models that can serve as the reference of the small-strain limits
_LARGE = (*FINITE_STRAIN, "mujoco-flex", "newton-vbd")  # models of large displacements, whatever their solver
# which have no answer for an incompressible body
DISPLACEMENT_ELEMENTS = ("fem-p1", "fem-p2", "mujoco-flex", "newton-vbd")
REFINED = " refined"  # what the reference's name gets where it is solved on refinements of the case's mesh
_NOT_LINEAR = ("quasi-linear", "nonlinear", "incremental")  # solvers of another problem than the linear one

# parameters that are numbers: what they are called, and their unit
PARAMETERS = {
    "bulk_modulus": ("B", "Pa"),
    "connectivity_modulus": ("B_ij", "Pa"),
    "shear_modulus": ("shear modulus", "Pa"),
    "foundation": ("foundation k", "Pa/m"),
    "surface_tension": ("tension T", "N/m"),
    "stretch_stiffness": ("stretch stiffness E_s", "N/m"),
    "coarse_nodes": ("nodes of the coarse body", "1"),
    "penalty": ("penalty alpha", "1"),
    "tolerance": ("tolerance", "1"),
}


def takes_fluid(solver: str, compressibility: object) -> bool:
    """Whether the boundary form is filled with a fluid, not the tissue: left out, at large displacements alone."""
    return (compressibility or ("fluid" if solver == "nonlinear" else "tissue")) == "fluid"


def is_vdm(name: str) -> bool:
    """Whether a model is one of the surface models of VDM, whose parameters a calibration fits."""
    return name.startswith(("vdm-", "bem"))


def split(name: str) -> tuple[str, str]:
    """Name in the registry and solver, "linear" where none is named; what tells a refined level is left out."""
    base, _, solver = name.partition(" ")[0].partition(":")
    return base, solver or "linear"


def is_linear(name: str) -> bool:
    """Whether a model solves the linear problem, in small displacements from rest."""
    base, solver = split(name)
    return base not in _LARGE and solver not in _NOT_LINEAR
