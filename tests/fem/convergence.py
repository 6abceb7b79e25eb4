"""Errors against known answers; records them against mesh size and judges the observed order."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from skfem import Basis

from tests.fem.shapes import Array, Body
from tests.verification.records import Verified

# the least supports that stop the rigid motion of a ball of radius 1
THREE_POINTS = (((1, 0, 0), (0, 1, 2)), ((0, 1, 0), (0, 2)), ((0, 0, 1), (1,)))


def relative_l2(basis: Basis, dofs: Array, exact: Callable[[Array], Array]) -> float:
    """Relative L2 error over the body of a dof vector against exact(points), components first."""
    found, true = np.asarray(basis.interpolate(dofs)), exact(np.asarray(basis.global_coordinates()))
    return float(np.sqrt(((found - true) ** 2 * basis.dx).sum() / (true**2 * basis.dx).sum()))


def radial_error(b: Body, displacement: Array, exact: Callable[[Array], Array]) -> float:
    """Of the radial displacement over the surface, the largest, in parts of the largest that is exact."""
    r = np.linalg.norm(b.surface, axis=1)
    true = exact(r)
    return float(np.abs(np.einsum("ni,ni->n", displacement, b.surface) / r - true).max() / np.abs(true).max())


def inner_error(b: Body, displacement: Array, exact: float) -> float:
    """Of the radial displacement at radius 1, the largest, relative."""
    at = np.linalg.norm(b.surface, axis=1) < 1.0 + 1e-9
    return float(np.abs(np.einsum("ni,ni->n", displacement[at], b.surface[at]) / exact - 1.0).max())


def relative_without_motion(found: Array, u: Array, points: Array) -> float:
    """Relative L2 difference over the surface nodes, without rigid motion."""
    modes = np.concatenate(
        [np.tile(np.eye(3), (len(u), 1, 1)), np.stack([np.cross(e, points) for e in np.eye(3)], -1)], -1
    ).reshape(-1, 6)
    difference = (found - u).ravel()
    difference -= modes @ np.linalg.lstsq(modes, difference, rcond=None)[0]
    return float(np.linalg.norm(difference) / np.linalg.norm(u))


@dataclass
class Convergence:
    """Errors of one quantity on ever finer meshes.

    `expected` comes from the method; the observed order of the last two meshes must lie within `slack` of it and
    the last error must be at most `cap`. An error at rounding passes whatever its order.
    """

    name: str
    expected: float
    cap: float
    slack: float = 0.15
    rounding: float = 1e-12
    rows: list[tuple[float, float]] = field(default_factory=list)

    def add(self, mesh_size: float, error: float) -> None:
        self.rows.append((mesh_size, error))

    @property
    def order(self) -> float:
        (h0, e0), (h1, e1) = self.rows[-2:]
        return float(np.log(e0 / e1) / np.log(h0 / h1))

    def check(self, verified: Verified) -> None:
        """Record the finest error and the observed order."""
        h, error = self.rows[-1]
        verified.at_most(f"{self.name}: error at h = {h:.4g}", error, self.cap)
        if error > self.rounding:
            quantity = f"{self.name}: observed order to h = {h:.4g}"
            verified.equal(quantity, self.order, self.expected, atol=self.slack)
