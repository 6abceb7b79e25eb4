"""Saint Venant-Kirchhoff on linear tetrahedra: what a state of another program's answer is worth by its own law."""

from __future__ import annotations

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


def state(mesh: Mesh, displacement: Array, young: float, nu: float) -> State:
    """The state of a displacement.

    W = mu tr(E^2) + lambda/2 tr(E)^2 of the Green strain E = (F^T F - 1)/2; first Piola-Kirchhoff P = F S with
    S = 2 mu E + lambda tr(E). Forces are -V P of the gradients of the barycentric coordinates.

    Parameters
    ----------
    displacement : (n, 3) [m]
    young, nu : Young's modulus [Pa] and Poisson's ratio below 0.5
    """
    mu, lame = young / (2.0 * (1.0 + nu)), young * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    rest = np.diff(mesh.points[mesh.tetrahedra][:, [0, 1, 0, 2, 0, 3]], axis=1)[
        :, ::2
    ]  # rows: edges from corner 0
    volume, inverse = np.linalg.det(rest) / 6.0, np.linalg.inv(rest)
    moved = rest + np.diff(displacement[mesh.tetrahedra][:, [0, 1, 0, 2, 0, 3]], axis=1)[:, ::2]
    deformation = np.swapaxes(inverse @ moved, 1, 2)
    strain = 0.5 * (np.swapaxes(deformation, 1, 2) @ deformation - np.eye(3))
    trace = np.trace(strain, axis1=1, axis2=2)
    second = 2.0 * mu * strain + lame * trace[:, None, None] * np.eye(3)
    first = deformation @ second
    gradients = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2)  # columns: corners
    force = np.zeros_like(displacement)
    np.add.at(force, mesh.tetrahedra, volume[:, None, None] * np.swapaxes(first @ gradients, 1, 2))
    energy = volume @ (mu * np.einsum("eij,eij->e", strain, strain) + 0.5 * lame * trace**2)
    growth = np.linalg.det(deformation)
    cauchy = np.einsum("eij,eij->e", first, deformation) / growth
    pressure = -(volume @ cauchy) / (3.0 * volume.sum())
    return State(force, float(energy), float(pressure), float(growth.min()))
