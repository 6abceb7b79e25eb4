"""Three unknowns per node: the fluid pushes along the normal, the skin's tension acts in every direction."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Mask
from vdm.deformed import DeformedSurface, best_rotation
from vdm.formulations.base import DisplacementFormulation, Factor, Factorise, SparseFactor
from vdm.formulations.border import Columns, DenseColumns, TurningColumns
from vdm.material import ParameterError, Parameters, per_item
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh


class VectorFormulation(DisplacementFormulation):
    """Stationary point of

    `1/2 k sum a_i (u_i.n_i)^2 + 1/2 T min_omega sum w_ij |u_i - u_j - omega x (x_i - x_j)|^2
    + 1/2 E_s sum w_ij ((u_i - u_j).e_ij)^2 - sum (dP + rho g delta_i) g_i.u_i - sum F_i.u_i`

    under `sum g_i.u_i = 0`, with cotangent weights w_ij (negative ones set to zero). `Parameters.rotation`:

    - "none": omega = 0, every rotation costs energy;
    - "global": one omega for the body, three border unknowns beside dP.

    With k = E_s = 0 the three components share one scalar (N, N) factor.

    Raises
    ------
    ParameterError
        T missing, a parameter of the wrong length, or all of them zero.
    """

    name = "vector"
    remedy = DisplacementFormulation.remedy + ", or make foundation positive somewhere"

    @classmethod
    def free_motions(cls, surface: SurfaceMesh, parameters: Parameters, nodes: Mask) -> Array:
        """The rigid motions; a tension without free rotations leaves only the translations free.

        None with a foundation, which may or may not stop them: the factor decides.
        """
        motions = super().free_motions(surface, parameters, nodes)
        if parameters.ground is not None:
            return motions
        if parameters.foundation is not None and np.any(np.asarray(parameters.foundation)):
            return motions[:, :, :0]
        if parameters.rotation == "none" and np.any(np.asarray(parameters.surface_tension, dtype=np.float64)):
            return motions[:, :, :3]
        return motions

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        super().__init__(surface, parameters)
        n_edges = len(surface.edges)
        tension = per_item(parameters.surface_tension, "surface_tension", n_edges, self.name)
        foundation = per_item(parameters.foundation, "foundation", surface.n_nodes, self.name, 0.0)
        stretch = per_item(parameters.stretch_stiffness, "stretch_stiffness", n_edges, self.name, 0.0)
        if not (tension.any() or stretch.any()):
            raise ParameterError("surface_tension and stretch_stiffness are both zero; make one positive")
        weights = tension * surface.cotangent_weights
        self.stretch = stretch * surface.cotangent_weights if stretch.any() else None
        self.foundation = foundation * surface.vector_areas if foundation.any() else None
        self.tension = surface.laplacian(weights)
        # (3N, 3N) part that couples the components, None where one scalar factor serves all three
        self.coupling: sparse.csr_array | None = None
        if self.foundation is not None or self.stretch is not None or parameters.ground is not None:
            self.coupling = sparse.csr_array((3 * surface.n_nodes, 3 * surface.n_nodes))
            if self.foundation is not None:
                diagonal = np.einsum("n,na,nb->nab", self.foundation, *2 * (surface.normals,))
                self.coupling = block_diagonal(diagonal)
            if self.stretch is not None:
                blocks = np.einsum("e,ea,eb->eab", self.stretch, *2 * (edge_directions(surface),))
                self.coupling = self.coupling + block_laplacian(surface, blocks)
            if parameters.ground is not None:
                self.coupling = self.coupling + parameters.ground
        self.columns: Columns
        self.columns, self.corner = DenseColumns(surface.area_vectors[:, :, None]), np.zeros((1, 1))
        if parameters.rotation == "global":
            self.columns, self.corner = self._with_global_rotation()
        self.rows = self.columns

    def _with_global_rotation(self) -> tuple[Columns, Array]:
        """Border of (dP, omega); stationarity in omega reads `sum_e w d x (u_i - u_j) = T J omega`."""
        surface = self.surface
        centred = surface.points - surface.points.mean(axis=0)
        # column k is the tension force of the rotation e_k: L (e_k x X) = e_k x (L X)
        columns = TurningColumns(surface.area_vectors, np.asarray(self.tension @ centred))
        corner = np.zeros((4, 4))
        second = centred.T @ columns.pull  # the sum of w d d^T over the edges
        corner[1:, 1:] = second - np.trace(second) * np.eye(3)  # less the sum of `edge_inertia`
        return columns, corner

    def apply(self, x: Array) -> Array:
        force = np.asarray(self.tension @ x)
        if self.coupling is not None:
            force = force + (self.coupling @ x.reshape(-1)).reshape(-1, 3)
        return force

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        if self.coupling is None:
            return SharedFactor(factorise(self.tension[free][:, free]))
        dofs = np.repeat(free, 3)
        return factorise(self.stiffness()[dofs][:, dofs])

    def response(self, factor: Factor, columns: Columns) -> Columns:
        if self.coupling is not None or not isinstance(columns, TurningColumns):
            return super().response(factor, columns)
        # rotations commute with the shared factor: K^-1 (e_k x p) = e_k x K^-1 p
        return TurningColumns(factor.solve(columns.first), factor.solve(columns.pull))

    def stiffness(self) -> sparse.csr_array:
        matrix = sparse.csr_array(sparse.kron(self.tension, sparse.eye_array(3), format="csr"))
        return matrix if self.coupling is None else sparse.csr_array(matrix + self.coupling)

    def diagonal(self) -> Array:
        diagonal = np.repeat(self.tension.diagonal(), 3)
        return diagonal if self.coupling is None else diagonal + self.coupling.diagonal()

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:
        """Tension about the best-fit finite rotation, stretch by changes of edge length, foundation as at rest."""
        return self._deformed(x, state)[0]

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:
        return self._deformed(x, state)[1]

    def _deformed(self, x: Array, state: DeformedSurface) -> tuple[Array, float]:
        rest = state.body.rest
        turned = rest
        if self.parameters.rotation == "global":
            turned = rest @ best_rotation((self.tension @ rest).T @ state.positions)
        change = state.positions - turned
        force = np.asarray(self.tension @ change)
        energy = 0.5 * float(np.vdot(change, force) + np.vdot(x, self.ground_force(x)))
        force = force + self.ground_force(x)
        if self.foundation is not None:
            along = np.einsum("ic,ic->i", x, self.surface.normals)
            force = force + (self.foundation * along)[:, None] * self.surface.normals
            energy += 0.5 * float(self.foundation @ along**2)
        if self.stretch is not None:
            i, j = self.surface.edges.T
            rest_length = np.linalg.norm(rest[i] - rest[j], axis=1)
            vectors = state.positions[i] - state.positions[j]
            length = np.linalg.norm(vectors, axis=1)
            force = force + self._incidence.T @ (
                (self.stretch * (1.0 - rest_length / length))[:, None] * vectors
            )
            energy += 0.5 * float(self.stretch @ (length - rest_length) ** 2)
        return force, energy

    @cached_property
    def _incidence(self) -> sparse.csr_array:
        return _incidence(self.surface)


class SharedFactor:
    """One scalar factor for three components: right-hand sides (3 n,) or (3 n, m), three per node."""

    def __init__(self, factor: SparseFactor) -> None:
        self.factor = factor

    def solve(self, right_hand_side: Array) -> Array:
        """The solution, same shape, all components in one pass through the factor."""
        return self.factor.solve(right_hand_side.reshape(self.factor.size, -1)).reshape(right_hand_side.shape)


def edge_directions(surface: SurfaceMesh) -> Array:
    """(E, 3) unit vectors along the edges."""
    i, j = surface.edges.T
    vectors = surface.points[i] - surface.points[j]
    directions: Array = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return directions


def block_diagonal(blocks: Array) -> sparse.csr_array:
    """(3N, 3N) of (N, 3, 3) blocks."""
    n = len(blocks)
    matrix = sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
    return sparse.csr_array(matrix)


def block_laplacian(surface: SurfaceMesh, blocks: Array) -> sparse.csr_array:
    """(3N, 3N) matrix of sum_e (u_i - u_j)^T B_e (u_i - u_j), blocks (E, 3, 3)."""
    incidence = sparse.kron(_incidence(surface), sparse.eye_array(3), format="csr")
    return sparse.csr_array(incidence.T @ block_diagonal(blocks) @ incidence)


def _incidence(surface: SurfaceMesh) -> sparse.csr_array:
    """(E, N) with +1 at the first and -1 at the second node of each edge."""
    n_edges = len(surface.edges)
    values = np.tile([1.0, -1.0], n_edges)
    indices, indptr = surface.edges.ravel(), np.arange(0, 2 * n_edges + 1, 2)
    return sparse.csr_array((values, indices, indptr), shape=(n_edges, surface.n_nodes))
