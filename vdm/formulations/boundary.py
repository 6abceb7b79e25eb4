"""The surface that knows its inside: elastic forces by boundary integrals of the incompressible body, no fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from vdm.deformed import DeformedSurface
from vdm.formulations.base import DisplacementFormulation, Factor, Factorise, Mask, rigid_motions
from vdm.formulations.border import DenseColumns
from vdm.formulations.boundary_integrals import layer_potentials, mass_matrix
from vdm.formulations.skin import INDEFINITE, PIVOT_TOLERANCE, Skin
from vdm.material import COARSE_NODES, COARSE_NODES_RANGE, ParameterError, Parameters
from vdm.solution import SolverError, Status
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh

Array = NDArray[np.float64]

# surfaces of up to as many nodes are taken as they are: dense matrices of (3N)^2 numbers
MAX_NODES = COARSE_NODES_RANGE[1]
DENSE = Status(
    "dense", "the boundary formulation has a dense factor, in double precision only", "use the linear solver"
)


class BoundaryFormulation(DisplacementFormulation):
    """Stationary point of `1/2 u.S u - sum (dP + rho g delta_i) g_i.u_i - sum F_i.u_i` under `sum g_i.u_i = 0`.

    S is the body's surface stiffness: the work of the tractions that an incompressible solid of shear modulus mu
    needs for u, from the layer potentials, `S = mass V^-1 (I/2 - D)`. Two things that hold for the solid and only
    nearly for the discrete operator are imposed: S is made symmetric, and rigid motions cost nothing, so that
    reactions balance the load. The traction of V^-1 is taken without its mean pressure: that pressure is dP.

    Dense, (3N)^2 numbers, set-up of order N^3, up to `MAX_NODES` nodes; more are the skin of a coarser body (see
    `vdm.formulations.skin`), and so are fewer where `Parameters.coarse_nodes` says so.

    At large displacements S turns with the rotation Q that best fits the surface:
    `E = 1/2 w.S w`, w = (positions) Q^T - (rest), Q from `sum a_i |x_i - X_i Q|^2`, areas a_i and arms X_i at rest.
    As Q turns with the positions, the force is `Q^T S w` less `lambda x (a_i X_i Q)`: forces that take off the
    moment of the first term, so that the internal force has neither a resultant nor a moment.

    Raises
    ------
    ParameterError
        shear_modulus missing, zero or not a scalar.
    """

    name = "boundary"

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        super().__init__(surface, parameters)
        modulus = parameters.shear_modulus
        if modulus is None or np.ndim(modulus) != 0 or not modulus > 0.0:
            raise ParameterError("the boundary formulation needs shear_modulus, one positive number")
        self.shear_modulus = float(modulus)
        self.body: Dense | Skin
        if surface.n_nodes <= (parameters.coarse_nodes or MAX_NODES):
            self.body = Dense(surface_stiffness(surface, surface.area_vectors))
        else:
            self.body = Skin(surface, parameters.coarse_nodes or COARSE_NODES, surface_stiffness)
        self.has_matrix = isinstance(self.body, Dense)
        self.columns = DenseColumns(surface.area_vectors[:, :, None])
        self.rows = self.columns
        self.corner = np.zeros((1, 1))

    def record(self) -> dict[str, float | str]:
        record = super().record()
        if not isinstance(self.body, Skin):
            return {**record, "scheme": "dense"}
        nodes = self.body.n_nodes
        return {**record, "scheme": f"skin on {nodes} nodes", "coarse_nodes": float(nodes)}

    def apply(self, x: Array) -> Array:
        return self.shear_modulus * self.body.apply(x)

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        if factorise is not Cholesky:
            raise SolverError(DENSE)
        return self.body.factor(free, self.shear_modulus)

    def stiffness(self) -> sparse.csr_array:
        if isinstance(self.body, Skin):
            raise SolverError(
                Status(
                    "too-large",
                    "the boundary formulation has no matrix where it is a skin on a coarse body",
                    f"use the linear or the nonlinear solver, or a mesh of at most {MAX_NODES:,} nodes",
                )
            )
        return sparse.csr_array(self.shear_modulus * self.body.matrix)

    def diagonal(self) -> Array:
        return self.shear_modulus * self.body.diagonal()

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:  # noqa: ARG002 - x is in state
        turn, unturned = self._unturned(state)
        force = self.apply(unturned) @ turn
        # dQ = Q [omega]x with (tr P - P) omega = -sum levers x dx, P = sum levers (x) positions, is symmetric;
        # the energy changes by omega . sum positions x force
        levers = state.body.levers @ turn
        stretch = levers.T @ state.positions
        inertia = np.trace(stretch) * np.eye(3) - stretch
        pull = np.linalg.solve(inertia, _axial(state.positions.T @ force))
        balanced: Array = force - levers @ _turning(pull)
        return balanced

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:  # noqa: ARG002 - x is in state
        unturned = self._unturned(state)[1]
        return 0.5 * float(np.vdot(unturned, self.apply(unturned)))

    def _unturned(self, state: DeformedSurface) -> tuple[Array, Array]:
        """The best-fit rotation Q of the nodes and the displacement left after it is undone."""
        turn = state.rotation
        return turn, state.positions @ turn.T - state.body.rest


def _axial(products: Array) -> Array:
    """sum p_i x f_i of the sums (3, 3) of p_i f_i^T."""
    skew = products - products.T
    return np.array([skew[1, 2], skew[2, 0], skew[0, 1]])


def _turning(axis: Array) -> Array:
    """(3, 3) W with v W = axis x v for rows v."""
    x, y, z = axis
    return np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])


class Dense:
    """A symmetric matrix (3N, 3N)."""

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self.n_nodes = len(matrix) // 3

    def apply(self, x: Array) -> Array:
        """(N, 3) elastic force of displacements (N, 3)."""
        force: Array = (self.matrix @ x.reshape(-1)).reshape(-1, 3)
        return force

    def diagonal(self) -> Array:
        """(3N,) of the matrix."""
        return np.diagonal(self.matrix)

    def factor(self, free: Mask, scale: float) -> DenseFactor:
        """The factor of its multiple over the free nodes."""
        dofs = np.repeat(free, 3)
        return DenseFactor(scale * self.matrix[np.ix_(dofs, dofs)])


class DenseFactor:
    """Cholesky factor of a symmetric positive definite dense matrix.

    Raises
    ------
    SolverError
        a matrix that is not positive definite.
    """

    def __init__(self, matrix: Array) -> None:
        try:
            self._factor = linalg.cho_factor(matrix, lower=True, check_finite=False)
        except linalg.LinAlgError as error:
            raise SolverError(INDEFINITE) from error
        diagonal = np.abs(np.diagonal(self._factor[0]))
        if diagonal.min() < PIVOT_TOLERANCE * diagonal.max():
            raise SolverError(INDEFINITE)

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides."""
        return np.asarray(linalg.cho_solve(self._factor, right_hand_side, check_finite=False))


def surface_stiffness(surface: SurfaceMesh, volume_gradient: Array) -> Array:
    """(3N, 3N) symmetric stiffness [m] for mu = 1, rigid motions in its null space.

    A change of volume, of the gradient (N, 3), is left to the constraint: here it only must not be free.
    """
    single, jump = layer_potentials(surface)
    normals = surface.normals.reshape(-1)
    size = len(normals)
    # V t + n lambda = (I/2 - D) u with g.t = 0: V is singular along n, and the border takes that pressure out
    bordered = np.zeros((size + 1, size + 1))
    bordered[:size, :size] = single
    scale = float(np.abs(single).sum(axis=1).max())
    bordered[:size, size] = scale * normals
    bordered[size, :size] = scale * surface.area_vectors.reshape(-1) / surface.area
    right = np.concatenate([jump, np.zeros((1, size))])
    tractions = linalg.solve(bordered, right, overwrite_a=True, overwrite_b=True, check_finite=False)[:size]
    mass = mass_matrix(surface)
    stiffness = np.asarray(mass @ tractions.reshape(surface.n_nodes, -1)).reshape(size, size)
    stiffness = 0.5 * (stiffness + stiffness.T)
    rigid = rigid_basis(surface)
    stiffness -= rigid @ (rigid.T @ stiffness)
    stiffness -= (stiffness @ rigid) @ rigid.T
    # a change of volume, which the constraint rules out, must not be free: it would make the block indefinite
    gradient = volume_gradient.reshape(-1)
    gradient = gradient - rigid @ (rigid.T @ gradient)
    gradient /= np.linalg.norm(gradient)
    # the stiffest node decides how much: at large displacements the volume changes in second order and feels it, so
    # it must not depend on the axes of space
    nodes = np.arange(surface.n_nodes)
    own = stiffness.reshape(surface.n_nodes, 3, surface.n_nodes, 3)[nodes, :, nodes]
    stiffness += np.abs(np.linalg.eigvalsh(own)).max() * np.outer(gradient, gradient)
    return 0.5 * (stiffness + stiffness.T)


def rigid_basis(surface: SurfaceMesh) -> Array:
    """(3N, 6) orthonormal basis of the infinitesimal rigid motions."""
    basis: Array = np.linalg.qr(
        rigid_motions(surface, np.ones(surface.n_nodes, dtype=np.bool_)).reshape(-1, 6)
    )[0]
    return basis
