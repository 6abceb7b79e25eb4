"""Linear tetrahedra of a law: what a state of another program's answer is worth by its own law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array

from ..body.mesh import Mesh


@dataclass(frozen=True)
class State:
    """What a displacement means.

    Attributes
    ----------
    force : (n, 3) what supports and loads together must give [N]
    energy : [J]
    pressure : mean of -tr(Cauchy stress)/3 over the rest volume [Pa]
    least_volume : of a tetrahedron, over its volume at rest; below 0 it is turned inside out
    """

    force: Array
    energy: float
    pressure: float
    least_volume: float


# deformation gradients F (E, 3, 3), mu, lambda [Pa] -> W (E,) and first Piola-Kirchhoff stresses P (E, 3, 3)
Law = Callable[[Array, float, float], tuple[Array, Array]]


def saint_venant(deformation: Array, mu: float, lame: float) -> tuple[Array, Array]:
    """W = mu tr(E^2) + lambda/2 tr(E)^2 of the Green strain E = (F^T F - 1)/2, P = F (2 mu E + lambda tr(E))."""
    strain = 0.5 * (np.swapaxes(deformation, 1, 2) @ deformation - np.eye(3))
    trace = np.trace(strain, axis1=1, axis2=2)
    second = 2.0 * mu * strain + lame * trace[:, None, None] * np.eye(3)
    return mu * np.einsum("eij,eij->e", strain, strain) + 0.5 * lame * trace**2, deformation @ second


def stable_neo_hookean(deformation: Array, mu: float, lame: float) -> tuple[Array, Array]:
    """W = mu/2 (tr(F^T F) - 3) + l/2 (J - a)^2 less its value at rest, P = mu F + l (J - a) dJ/dF.

    l = lambda + mu, a = 1 + mu/l: Smith, de Goes and Kim 2018, equation 13, with the moduli of small strain.
    """
    own = lame + mu
    rest = 1.0 + mu / own
    a, b, c = np.moveaxis(deformation, 1, 0)  # rows
    turned = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)  # dJ/dF
    volume = np.einsum("ei,ei->e", a, turned[:, 0])
    energy = 0.5 * mu * (np.einsum("eij,eij->e", deformation, deformation) - 3.0)
    energy += 0.5 * own * ((volume - rest) ** 2 - (1.0 - rest) ** 2)
    return energy, mu * deformation + (own * (volume - rest))[:, None, None] * turned


def moduli_of(young: float, nu: float) -> tuple[float, float]:
    """mu and lambda [Pa] of Young's modulus [Pa] and Poisson's ratio below 0.5."""
    return young / (2.0 * (1.0 + nu)), young * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))


def state(mesh: Mesh, displacement: Array, young: float, nu: float, law: Law = saint_venant) -> State:
    """The state of a displacement. Forces are V P of the gradients of the barycentric coordinates.

    Parameters
    ----------
    displacement : (n, 3) [m]
    young, nu : Young's modulus [Pa] and Poisson's ratio below 0.5
    """
    mu, lame = moduli_of(young, nu)
    rest = np.diff(mesh.points[mesh.tetrahedra][:, [0, 1, 0, 2, 0, 3]], axis=1)[
        :, ::2
    ]  # rows: edges from corner 0
    volume, inverse = np.linalg.det(rest) / 6.0, np.linalg.inv(rest)
    moved = rest + np.diff(displacement[mesh.tetrahedra][:, [0, 1, 0, 2, 0, 3]], axis=1)[:, ::2]
    deformation = np.swapaxes(inverse @ moved, 1, 2)
    energy, first = law(deformation, mu, lame)
    gradients = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2)  # columns: corners
    force = np.zeros_like(displacement)
    np.add.at(force, mesh.tetrahedra, volume[:, None, None] * np.swapaxes(first @ gradients, 1, 2))
    growth = np.linalg.det(deformation)
    cauchy = np.einsum("eij,eij->e", first, deformation) / growth
    pressure = -(volume @ cauchy) / (3.0 * volume.sum())
    return State(force, float(volume @ energy), float(pressure), float(growth.min()))
