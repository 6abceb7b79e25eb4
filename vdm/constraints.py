"""What acts on a surface: loads, held nodes, gravity and the environment (equations 10-17 and 23-26)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from solver_common.arrays import Array, Mask
from vdm.surface import SurfaceMesh

ContactSign = Literal["inward", "printed"]
CONTACT_SIGNS: tuple[ContactSign, ...] = get_args(ContactSign)
LARGEST = 1e100  # of a load, in SI units: larger values overflow when squared


class ConstraintError(ValueError):
    """A load or constraint that does not fit the surface; the message says what to change."""


@dataclass(frozen=True)
class Load:
    """One load step on N surface nodes.

    Attributes
    ----------
    contact_pressure : (N,) contact pressure over A_i [Pa], positive inward; the thrust is sum A_i p_i
    contact_force : (N, 3) the same contact as force on each node [N], summed facet by facet; the consistent and
        vector forms use it where given, and -p_i g_i otherwise
    prescribed : (N, 3) displacement of the constrained nodes [m]; scalar formulations use its normal component
    dead_force : (N, 3) further force on each node [N] of constant size and direction, which moves with its node;
        scalar formulations move along normals only and refuse it
    weight : share of the body's weight that acts on the deformed surface; below 1 on the way to a first load
    """

    contact_pressure: Array
    contact_force: Array | None = None
    prescribed: Array | None = None
    dead_force: Array | None = None
    weight: float = 1.0

    def scaled(self, factor: float) -> Load:
        """The same load times a factor."""
        return Load(
            factor * self.contact_pressure,
            None if self.contact_force is None else factor * self.contact_force,
            None if self.prescribed is None else factor * self.prescribed,
            None if self.dead_force is None else factor * self.dead_force,
        )


@dataclass(frozen=True)
class Support:
    """Supports, gravity and environment, constant over a load history.

    Attributes
    ----------
    fixed : (N,) nodes that do not move (25)
    constrained : (N,) nodes moved by `Load.prescribed` (26)
    hydrostatic : (N,) rho g delta_i [Pa] on the rest surface (12), None without gravity
    density : of the fluid [kg/m^3]
    gravity : (3,) [m/s^2], None without
    environment_pressure : P_ep [Pa] (11)
    contact_sign : "inward", or "printed" for +P_cp as in equation 24, which bulges towards the finger
    """

    fixed: Mask
    constrained: Mask
    hydrostatic: Array | None = None
    density: float = 0.0
    gravity: Array | None = None
    environment_pressure: float = 0.0
    contact_sign: ContactSign = "inward"

    @property
    def held(self) -> Mask:
        """(N,) fixed or constrained."""
        return self.fixed | self.constrained

    def signed(self, load: Load) -> Load:
        """The load with the contact's sign as `contact_sign` requires."""
        if self.contact_sign == "inward":
            return load
        force = None if load.contact_force is None else -load.contact_force
        return Load(-load.contact_pressure, force, load.prescribed, load.dead_force)


def node_mask(mask: ArrayLike | None, name: str, n_nodes: int) -> Mask:
    """A mask of nodes, all False where none is given.

    Raises
    ------
    ConstraintError
        for another shape or type.
    """
    if mask is None:
        return np.zeros(n_nodes, dtype=np.bool_)
    array = np.asarray(mask)
    if array.dtype != np.bool_ or array.shape != (n_nodes,):
        raise ConstraintError(
            f"{name} must be a mask of {n_nodes} booleans, not {array.dtype} of shape {array.shape}"
        )
    return array


def check_apart(support: Support) -> None:
    """Refuses a node that is fixed and constrained at once: it cannot rest and move.

    Raises
    ------
    ConstraintError
        with the first such node.
    """
    both = np.flatnonzero(support.fixed & support.constrained)
    if len(both):
        more = f", and {len(both) - 1} more" if len(both) > 1 else ""
        raise ConstraintError(
            f"node {both[0]} is both fixed and constrained{more}; take it out of one of the two masks"
        )


def checked_load(load: Load, support: Support) -> Load:
    """The load with its values as arrays of floats.

    Raises
    ------
    ConstraintError
        values that are not numbers, a wrong shape, nan, inf or beyond 1e100, constrained nodes without a
        displacement, or a displacement where no node is constrained.
    """
    n = len(support.fixed)
    pressure = _checked(load.contact_pressure, "contact_pressure", (n,))
    if pressure is None:
        raise ConstraintError("contact_pressure is missing; zeros where nothing touches the body")
    force = _checked(load.contact_force, "contact_force", (n, 3))
    prescribed = _checked(load.prescribed, "prescribed", (n, 3))
    if prescribed is None and support.constrained.any():
        raise ConstraintError("constrained nodes need the load's prescribed displacement")
    if prescribed is not None and prescribed.any() and not support.constrained.any():
        raise ConstraintError("the load moves nodes and none is constrained; name them in constrained")
    dead = _checked(load.dead_force, "dead_force", (n, 3))
    return Load(pressure, force, prescribed, dead, load.weight)


def _checked(value: ArrayLike | None, name: str, shape: tuple[int, ...]) -> Array | None:
    if value is None:
        return None
    try:
        array = np.asarray(value)
    except ValueError as error:  # rows of different lengths
        raise ConstraintError(f"{name} must have shape {shape}") from error
    if array.dtype.kind not in "iuf":
        raise ConstraintError(f"{name} must be real numbers, not {array.dtype}")
    if array.shape != shape:
        raise ConstraintError(f"{name} must have shape {shape}, not {array.shape}")
    if not np.isfinite(array).all():
        raise ConstraintError(f"{name} contains nan or inf")
    if np.abs(array).max(initial=0.0) > LARGEST:
        raise ConstraintError(f"{name} has values beyond {LARGEST:.0e}; check its unit")
    return np.asarray(array, dtype=np.float64)


def hydrostatic_pressure(surface: SurfaceMesh, density: float, gravity: ArrayLike) -> Array | None:
    """(N,) rho g delta_i [Pa], delta_i the depth below the highest surface point; None without gravity.

    Moving the datum by c changes dP by -rho g c and nothing else (equation 12).

    Raises
    ------
    ConstraintError
        a negative density or a gravity that is not three finite numbers.
    """
    vector = np.asarray(gravity, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConstraintError("gravity must be three finite numbers")
    if not (np.isfinite(density) and density >= 0.0):
        raise ConstraintError(f"density must be finite and not negative, not {density}")
    if density == 0.0 or not vector.any():
        return None
    depth = surface.points @ vector
    pressure: Array = density * (depth - depth.min())
    return pressure
