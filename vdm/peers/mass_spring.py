"""A volume-conserving mass-spring surface: springs over the skin and through the body, one fluid pressure."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Index, Mask
from vdm.deformed import DeformedSurface
from vdm.formulations.base import DisplacementFormulation, Factor, Factorise
from vdm.formulations.border import DenseColumns
from vdm.material import ParameterError, Parameters
from vdm.solution import SolverError, Status
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh

# sum c_r L_r / (mu V): 15 for a dense network that follows the strain. This coarse one yields more; 33 and the
# skin's share fit an incompressible ball under a finger's patch
RIGIDITY = 33.0
SKIN_SHARE = 0.3
# struts of a node: one along the inward normal and this many around it at the angle of `_TILT`
_TILTED = 3
_TILT = np.pi / 4.0
# a strut ends at the nearest facing node within this angle of its direction
_CONE = np.cos(np.radians(20.0))
# struts cross the body, so that the factor is dense: 0.9 GB and minutes at this many nodes, growing as their
# square and cube
MAX_NODES = 5000
_CHUNK = 256  # nodes per pass: bounds the temporary arrays


class MassSpringFormulation(DisplacementFormulation):
    """Stationary point of `1/2 sum k_r ((u_i - u_j).e_r)^2 - sum (dP + rho g delta_i) g_i.u_i - sum F_i.u_i`
    under `sum g_i.u_i = 0`, r over the springs.

    Springs are rods of stiffness k_r = c_r / L_r: the edges of the surface, and four struts from every node to
    the far side, because a flat skin alone has no stiffness. Rods in all directions with Young's modulus E_r,
    which fill the share phi of a body, give the shear modulus phi E_r / 15 (Cox, Br. J. Appl. Phys. 3 (1952) 72,
    for a network that follows the strain). Few rods yield more: `sum c_r L_r = 33 mu V`, fitted once to an
    incompressible ball. 0.3 of the sum is in the skin, divided among the edges by the area of their facets (van
    Gelder, J. Graphics Tools 3 (1998) 21). The rest is in the struts, divided by the nodes' areas.

    At large displacements the springs turn and stretch with the surface.

    Raises
    ------
    ParameterError
        shear_modulus missing, zero or not a scalar.
    SolverError
        more than `MAX_NODES` nodes.
    """

    name = "mass-spring"

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        super().__init__(surface, parameters)
        modulus = parameters.shear_modulus
        if modulus is None or np.ndim(modulus) != 0 or not modulus > 0.0:
            raise ParameterError("the mass-spring formulation needs shear_modulus, one positive number")
        if surface.n_nodes > MAX_NODES:
            raise SolverError(
                Status(
                    "too-large",
                    f"struts through a body make the factor dense: {surface.n_nodes:,} nodes are too many",
                    f"use a mesh of at most {MAX_NODES:,} nodes, or the vector form or boundary elements",
                )
            )
        self.springs, self.spring_constants = make_springs(surface, float(modulus))
        first, second = self.springs.T
        vectors = surface.points[first] - surface.points[second]
        self.rest_lengths: Array = np.linalg.norm(vectors, axis=1)
        elongation = _elongation(self.springs, vectors / self.rest_lengths[:, None], surface.n_nodes)
        self.matrix = sparse.csr_array(elongation.T @ sparse.diags_array(self.spring_constants) @ elongation)
        if parameters.ground is not None:
            self.matrix = self.matrix + parameters.ground
        self.columns = DenseColumns(surface.area_vectors[:, :, None])
        self.rows = self.columns
        self.corner = np.zeros((1, 1))

    def apply(self, x: Array) -> Array:
        return np.asarray(self.matrix @ x.reshape(-1)).reshape(-1, 3)

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        dofs = np.repeat(free, 3)
        return factorise(self.matrix[dofs][:, dofs])

    def stiffness(self) -> sparse.csr_array:
        return self.matrix

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:
        directions, growth = self._stretched(state)
        turned = _elongation(self.springs, directions, self.surface.n_nodes)
        force = np.asarray(turned.T @ (self.spring_constants * growth)).reshape(-1, 3)
        return force + self.ground_force(x)

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:
        stretch = self.spring_constants @ self._stretched(state)[1] ** 2
        return 0.5 * float(stretch + np.vdot(x, self.ground_force(x)))

    def _stretched(self, state: DeformedSurface) -> tuple[Array, Array]:
        """(R, 3) current directions of the springs, and (R,) their elongations [m]."""
        first, second = self.springs.T
        vectors = state.positions[first] - state.positions[second]
        lengths = np.linalg.norm(vectors, axis=1)
        return vectors / lengths[:, None], lengths - self.rest_lengths


def make_springs(surface: SurfaceMesh, shear_modulus: float) -> tuple[Index, Array]:
    """The springs of a body: (R, 2) nodes at their ends and (R,) stiffness [N/m], see `MassSpringFormulation`.

    Parameters
    ----------
    surface : the surface at rest
    shear_modulus : mu [Pa]
    """
    rigidity = RIGIDITY * shear_modulus * surface.volume  # sum of c_r L_r [N m]
    of_edge = np.bincount(surface.facet_edges.ravel(), np.repeat(surface.facet_areas, 3), len(surface.edges))
    ends, of_strut = through_springs(surface)
    springs = np.concatenate([surface.edges, ends])
    lengths = np.linalg.norm(surface.points[springs[:, 0]] - surface.points[springs[:, 1]], axis=1)
    # c L is proportional to the area of an edge's two facets, c of a strut to the area of its node
    skin = SKIN_SHARE * of_edge / of_edge.sum()
    inside = of_strut * lengths[len(of_edge) :]
    inside *= (1.0 - SKIN_SHARE) / inside.sum()
    return springs, rigidity * np.concatenate([skin, inside]) / lengths**2


def through_springs(surface: SurfaceMesh) -> tuple[Index, Array]:
    """(R, 2) struts from every node to the far side, each pair once, and (R,) the areas that they represent.

    A strut starts along the inward normal or tilted from it. It ends at the nearest node that faces away and lies
    within 20 degrees of that direction; without one, at the node nearest to that direction.
    """
    nodes = np.arange(surface.n_nodes)
    directions = _strut_directions(surface)
    starts, ends = [], []
    for first in range(0, surface.n_nodes, _CHUNK):
        some = nodes[first : first + _CHUNK]
        vectors = (surface.points[None, :, :] - surface.points[some][:, None, :]) / surface.equivalent_radius
        lengths = _rounded(np.linalg.norm(vectors, axis=2))
        lengths[np.arange(len(some)), some] = np.inf
        for direction in directions:
            d = direction[some]
            along = _rounded(np.einsum("ijc,ic->ij", vectors, d) / lengths)
            along[_rounded(d @ surface.normals.T) <= 0.0] = -1.0
            reach = np.where(along >= _CONE, lengths, np.inf)
            found = np.where(np.isfinite(reach).any(axis=1), reach.argmin(axis=1), along.argmax(axis=1))
            starts.append(some)
            ends.append(found)
    start, end = np.concatenate(starts), np.concatenate(ends)
    keys = np.minimum(start, end) * surface.n_nodes + np.maximum(start, end)
    unique, inverse = np.unique(keys, return_inverse=True)
    areas = np.asarray(np.bincount(inverse, surface.nodal_areas[start] / len(directions)), dtype=np.float64)
    pairs: Index = np.stack([unique // surface.n_nodes, unique % surface.n_nodes], axis=1).astype(np.int64)
    return pairs, areas


def _strut_directions(surface: SurfaceMesh) -> Array:
    """(1 + _TILTED, N, 3) unit vectors into the body."""
    normals, tangent = surface.normals, _along_longest_edges(surface)
    other = np.cross(normals, tangent)
    directions = [-normals]
    for turn in 2.0 * np.pi * np.arange(_TILTED) / _TILTED:
        sideways = np.cos(turn) * tangent + np.sin(turn) * other
        directions.append(np.sin(_TILT) * sideways - np.cos(_TILT) * normals)
    return np.array(directions)


def _along_longest_edges(surface: SurfaceMesh) -> Array:
    """(N, 3) unit tangents: the longest projection of each node's edges on its tangent plane.

    The direction belongs to the body and differs between nodes. Directions from the axes of space would brace the
    body unevenly, and the answer would depend on its pose.
    """
    ends = np.concatenate([surface.edges, surface.edges[:, ::-1]])
    vectors = surface.points[ends[:, 1]] - surface.points[ends[:, 0]]
    normals = surface.normals[ends[:, 0]]
    vectors -= np.einsum("ec,ec->e", vectors, normals)[:, None] * normals
    lengths = np.linalg.norm(vectors, axis=1)
    order = np.lexsort((-_rounded(lengths / surface.equivalent_radius), ends[:, 0]))
    longest = order[np.searchsorted(ends[order, 0], np.arange(surface.n_nodes))]
    tangents: Array = vectors[longest] / lengths[longest, None]
    return tangents


def _rounded(values: Array) -> Array:
    """Numbers of order one without their last digits: a tie on a regular mesh stays a tie in every pose."""
    rounded: Array = np.round(values, 9)
    return rounded


def _elongation(springs: Index, directions: Array, n_nodes: int) -> sparse.csr_array:
    """(R, 3N): elongation of each spring [m] for small displacements of the nodes."""
    count = len(springs)
    columns = (3 * springs[:, :, None] + np.arange(3)).reshape(count, 6)
    values = np.concatenate([directions, -directions], axis=1)
    indptr = np.arange(0, 6 * count + 1, 6)
    return sparse.csr_array((values.ravel(), columns.ravel(), indptr), shape=(count, 3 * n_nodes))
