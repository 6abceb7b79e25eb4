"""The most compressed point of a deformed surface, and the stretches below which a free surface is unstable.

An incompressible neo-Hookean half space has the stretches l1 <= l2 in its surface. The stability of that surface
depends on l1 sqrt(l2) alone, which is l1 in plane strain. Below `CREASE` a crease costs no energy (Hong, Zhao and
Suo 2009, doi 10.1063/1.3211917). Below `BIOT` a flat surface is unstable even to small waves (Biot 1963, Applied
Scientific Research A 12, 168).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fem_reference.follower import facet_derivatives
from fem_reference.mesh import TetMesh, triangle_p2
from solver_common.arrays import Array
from solver_common.quadrature import facet_quadrature

CREASE = 0.65
BIOT = 0.544


@dataclass(frozen=True)
class SurfaceStretch:
    """The point of a surface that is compressed most.

    Attributes
    ----------
    least, other : principal stretches in the surface, the smaller first
    place : (3,) undeformed coordinates [m]
    facet : number of its facet
    """

    least: float
    other: float
    place: Array
    facet: int

    @property
    def plane(self) -> float:
        """The plane-strain stretch l1 sqrt(l2) at which a half space is equally near to creasing."""
        return float(self.least * np.sqrt(self.other))


def most_compressed(mesh: TetMesh, displacement: Array) -> SurfaceStretch:
    """The point of least l1 sqrt(l2), of the quadrature points of all facets.

    Parameters
    ----------
    mesh : of quadratic elements
    displacement : (n_nodes, 3) of its nodes [m]
    """
    barycentric = facet_quadrature()[0]
    nodes, rest = mesh.facet_nodes, mesh.node_points
    metric = _metric(barycentric, rest[nodes])
    deformed = _metric(barycentric, (rest + displacement)[nodes])
    # squared stretches are the eigenvalues of the deformed metric relative to the undeformed one
    inverse = np.linalg.inv(np.linalg.cholesky(metric))
    squares = np.linalg.eigvalsh(inverse @ deformed @ np.swapaxes(inverse, -1, -2))
    stretches = np.sqrt(np.maximum(squares, 0.0))
    plane = stretches[..., 0] * np.sqrt(stretches[..., 1])
    facet, point = np.unravel_index(plane.argmin(), plane.shape)
    least, other = stretches[facet, point]
    place = triangle_p2(barycentric[[point]])[0] @ rest[nodes[facet]]
    return SurfaceStretch(float(least), float(other), place, int(facet))


def _metric(barycentric: Array, corners: Array) -> Array:
    """(F, Q, 2, 2) products of the tangents of quadratic facets with (F, 6, 3) nodes."""
    by_r, by_s = facet_derivatives(barycentric)
    tangents = np.stack([by_r @ corners, by_s @ corners], axis=-2)
    return np.asarray(tangents @ np.swapaxes(tangents, -1, -2))
