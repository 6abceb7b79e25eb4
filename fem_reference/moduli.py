"""Moduli of a body, one for all of it or one per tetrahedron."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.mesh import TetMesh
from solver_common.arrays import Array
from solver_common.solution import solver_error


@dataclass(frozen=True)
class Moduli:
    """Moduli in units of a reference, so that equal bodies have equal systems.

    Attributes
    ----------
    youngs_modulus, poisson_ratio : the volume means where they vary [Pa]
    shear_modulus : that of the means [Pa], the unit of stress
    stiffness : (m,) shear modulus of each tetrahedron in that unit; None where it is one everywhere
    poisson_ratios : (m,) where they vary, else None
    """

    youngs_modulus: float
    poisson_ratio: float
    shear_modulus: float
    stiffness: Array | None = None
    poisson_ratios: Array | None = None


def make_moduli(mesh: TetMesh, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike, *, mixed: bool) -> Moduli:
    """Check the moduli of a body.

    Parameters
    ----------
    mesh : of m tetrahedra
    youngs_modulus : one number or (m,) [Pa], positive
    poisson_ratio : one number in (-1, 0.5], or (m,) in (0, 0.5]; below 0.5, and one, for a displacement element
    mixed : whether the element has a pressure

    Raises
    ------
    SolverError
        For moduli that this element cannot take.
    """
    young, nu = (np.asarray(values, dtype=np.float64) for values in (youngs_modulus, poisson_ratio))
    for name, values in (("youngs_modulus", young), ("poisson_ratio", nu)):
        if values.shape not in ((), mesh.volumes.shape):
            raise _bad_material(
                f"{name} has shape {values.shape}",
                f"give one number or one for each of {len(mesh.volumes)} tetrahedra",
            )
    if not (np.isfinite(young).all() and (young > 0.0).all()):
        raise _bad_material(
            f"youngs_modulus is {_first(young, ~(young > 0.0) | ~np.isfinite(young))}",
            "give a positive number of pascals",
        )
    least = -1.0 if nu.ndim == 0 else 0.0
    bad = ~((least < nu) & (nu <= 0.5))
    if bad.any():
        remedy = "give a number in (-1, 0.5]" if nu.ndim == 0 else "where it varies give numbers in (0, 0.5]"
        raise _bad_material(f"poisson_ratio is {_first(nu, bad)}", remedy)
    if not mixed and (nu.ndim or nu == 0.5):
        raise _bad_material(
            "a displacement element cannot be incompressible, nor take a poisson_ratio that varies",
            "use the element P2-P1 or one poisson_ratio < 0.5",
        )
    share = mesh.volumes / mesh.volume
    mean_young, mean_nu = (float(v) if v.ndim == 0 else float(v @ share) for v in (young, nu))
    shear = mean_young / (2.0 * (1.0 + mean_nu))
    if young.ndim == nu.ndim == 0:
        return Moduli(mean_young, mean_nu, shear)
    stiffness = np.broadcast_to(young / (2.0 * (1.0 + nu)) / shear, mesh.volumes.shape)
    return Moduli(mean_young, mean_nu, shear, stiffness, nu if nu.ndim else None)


def check_density(density: float) -> None:
    """Raise a `SolverError` for a density that is not a number, or negative."""
    if not (np.isfinite(density) and density >= 0.0):
        raise _bad_material(f"density is {density}", "give a number of kg/m^3 that is not negative")


def check_fibres(moduli: Moduli) -> None:
    """Raise a `SolverError` for fibres in a body whose Poisson's ratio varies."""
    if moduli.poisson_ratios is not None:
        raise _bad_material(
            "a body with fibres has one poisson_ratio", "give one number, or leave the fibres out"
        )


def _first(values: Array, bad: NDArray[np.bool_]) -> str:
    if values.ndim == 0:
        return f"{values}"
    number = int(np.argmax(bad))
    return f"{values[number]} in tetrahedron {number}"


_bad_material = partial(solver_error, "bad-material")
