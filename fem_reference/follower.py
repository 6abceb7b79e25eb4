"""Pressure on the deformed surface: consistent nodal forces and their exact, unsymmetric derivative.

Method: the normal per area of the deformed quadratic facet is the cross product of its edges. Order: exact for a
pressure that is uniform on a facet. Source: Bonet and Wood, 2nd ed., section 8.5.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fem_reference.assembly import Pattern
from fem_reference.mesh import TetMesh, triangle_p2
from solver_common.arrays import Array, Mask
from solver_common.quadrature import facet_quadrature

_SYMMETRIC = 1e-9  # rounding of a symmetric stiffness, relative to its largest entry


class FollowerPressure:
    """Forces -p N n da on the deformed quadratic facets.

    n da = x_,r x x_,s dr ds with the deformed edges' directions r and s (Bonet and Wood, 2nd ed., section 8.5.2).
    The quadrature is exact for a pressure that is uniform on a facet.
    """

    def __init__(self, mesh: TetMesh, pattern: Pattern) -> None:
        self._mesh = mesh
        self._pattern = pattern
        points, weights = facet_quadrature()
        self._shape = triangle_p2(points)
        self._by_r, self._by_s = facet_derivatives(points)
        self._weights = 0.5 * weights  # dr ds fills half a unit square

    def forces(self, positions: Array, facet_pressure: Array) -> Array:
        """(n_nodes, 3) forces for (n_nodes, 3) positions of the nodes and (F, Q) pressures."""
        nodes, weighted = self._loaded(facet_pressure)
        corners = positions[nodes]
        normal = np.cross(self._by_r @ corners, self._by_s @ corners)
        return self._mesh.summed(nodes, self._shape.T @ (-weighted[..., None] * normal))

    def stiffness(self, positions: Array, facet_pressure: Array) -> tuple[NDArray[np.int64], Array]:
        """Negative derivative of `forces`: (k,) entries of the pattern and their (k, 3, 3) blocks."""
        nodes, weighted = self._loaded(facet_pressure)
        corners = positions[nodes]
        tangent_r, tangent_s = self._by_r @ corners, self._by_s @ corners
        # e_k x v has the components eps_ikm v_m; v = p (N_b,r x_,s - N_b,s x_,r)
        inner = (
            self._by_r[None, :, :, None] * tangent_s[:, :, None]
            - self._by_s[None, :, :, None] * tangent_r[:, :, None]
        )
        v = np.einsum("fq,qa,fqbm->fabm", weighted, self._shape, inner, optimize=True).reshape(-1, 3)
        blocks = np.zeros((len(v), 3, 3))
        for i, k, m, sign in (
            (0, 1, 2, 1),
            (1, 2, 0, 1),
            (2, 0, 1, 1),
            (0, 2, 1, -1),
            (1, 0, 2, -1),
            (2, 1, 0, -1),
        ):
            blocks[:, i, k] = sign * v[:, m]
        places, inverse = np.unique(self._pattern.places(nodes), return_inverse=True)
        gather = csr_array((np.ones(len(v)), (inverse, np.arange(len(v)))), shape=(len(places), len(v)))
        return places, np.asarray(gather @ blocks.reshape(-1, 9)).reshape(-1, 3, 3)

    def has_energy(self, positions: Array, facet_pressure: Array, free: Mask) -> bool:
        """Whether the stiffness is symmetric in the free components (n_nodes, 3), as in a closed cavity."""
        if not facet_pressure.any():
            return True
        places, blocks = self.stiffness(positions, facet_pressure)
        pattern = self._pattern
        mirrored = blocks[np.searchsorted(places, pattern.mirror[places])]
        rows = np.searchsorted(pattern.indptr, places, side="right") - 1
        both = free[rows][:, :, None] & free[pattern.indices[places]][:, None, :]
        skew = np.abs(blocks - np.swapaxes(mirrored, 1, 2)).max(initial=0.0, where=both)
        return bool(skew <= _SYMMETRIC * np.abs(blocks).max(initial=0.0))

    def _loaded(self, facet_pressure: Array) -> tuple[NDArray[np.int64], Array]:
        loaded = np.flatnonzero(facet_pressure.any(axis=1))
        return self._mesh.facet_nodes[loaded], facet_pressure[loaded] * self._weights


def facet_derivatives(barycentric: Array) -> tuple[Array, Array]:
    """(Q, 6) derivatives of `triangle_p2` along the edges from vertex 0 to 1 (r) and from 0 to 2 (s)."""
    b = barycentric
    zero = np.zeros(len(b))
    vertex = 4.0 * b - 1.0
    by_r = [-vertex[:, 0], vertex[:, 1], zero, 4.0 * (b[:, 0] - b[:, 1]), 4.0 * b[:, 2], -4.0 * b[:, 2]]
    by_s = [-vertex[:, 0], zero, vertex[:, 2], -4.0 * b[:, 1], 4.0 * b[:, 1], 4.0 * (b[:, 0] - b[:, 2])]
    return np.column_stack(by_r), np.column_stack(by_s)
