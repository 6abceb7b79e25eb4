"""Equations of the paper that no solver needs as they stand in print, each as a function of nodal quantities."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array
from vdm.formulations.paper import PaperFormulation


def external_pressure(form: PaperFormulation, displacement: Array, environment: float = 0.0) -> Array:
    """(N,) P_ext = P_ep + P_vp + P_vt [Pa] of normal displacements L (N,) [m] (equations 11 and 13)."""
    return environment + form.volumic_pressure(displacement) + form.volumic_tension(displacement)


def internal_pressure(n_nodes: int, fluid: float, hydrostatic: Array | None = None) -> Array:
    """(N,) P_int = P_fluid + P_gravity [Pa], with P_gravity = rho g delta_i (equation 12)."""
    inside = np.full(n_nodes, fluid)
    return inside if hydrostatic is None else inside + hydrostatic


def pressure_change(fluid: float, environment: float) -> float:
    """dP = P_fluid - P_ep [Pa] (equation 17)."""
    return fluid - environment


def volume_change(areas: Array, area_change: Array, length: Array, length_change: Array) -> Array:
    """(N,) dV_i = A_i dL_i + L_i dA_i [m^3] as printed (equation 20; its sum is 33).

    It is the change of a column of section A_i and length L_i. With x_i . n_i / 3, the length from a point
    inside, the sum is the change of the body's volume. The paper takes the displacement as L_i: A_i dL_i is then
    the whole change, and the second term counts part of it twice.
    """
    change: Array = areas * length_change + length * area_change
    return change
