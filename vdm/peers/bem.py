"""Boundary elements: elastic forces of a homogeneous body from its surface alone, without fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.linalg import blas, lapack

from solver_common.arrays import Array, Index, Mask
from vdm.boundary.rims import Rims
from vdm.deformed import DeformedSurface
from vdm.formulations.base import DisplacementFormulation, Factor, Factorise
from vdm.formulations.border import DenseColumns
from vdm.material import ParameterError, Parameters
from vdm.solution import SolverError, Status
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh

# largest number of nodes N for a dense matrix of (3N)^2 numbers
MAX_NODES = 2000
# largest number of unknowns for which the inverse is computed: 0.2 s of 3 s at 1,000 nodes
INVERTED = 3000
# ratio of the smallest to the largest pivot, below which a matrix counts as singular
PIVOT_TOLERANCE = 1e-8
DENSE = Status(
    "dense", "boundary elements have a dense factor, in double precision only", "use the linear solver"
)
INDEFINITE = Status(
    "singular",
    "the stiffness of boundary elements is not positive definite",
    "hold at least three nodes that are not on one line, and remesh slivers and folds",
)


class BoundaryFormulation(DisplacementFormulation):
    """Stationary point of `1/2 u.S u - sum (dP + rho g delta_i) g_i.u_i - sum F_i.u_i` under `sum g_i.u_i = 0`.

    S is the body's surface stiffness by symmetric Galerkin boundary elements: `u.S u` is the work of the tractions
    of a solid with shear modulus mu under u (`vdm.boundary.operators`). At Poisson's ratio 1/2 the solid is VDM's
    fluid: its volume is constant, and dP is its pressure, the null vector of the single layer. Smaller ratios have
    no such constraint; dP is then the mean pressure `-kappa (sum g_i.u_i) / V`. A fluid-filled cavity has a
    constant volume and a pressure too.

    The matrix is dense, with (3N)^2 numbers and a set-up of order N^3, on up to `MAX_NODES` nodes.

    At large displacements this form is one of the parts of `vdm.parts.body`. S turns with the rotation Q that best
    fits the part's surface: `E = 1/2 w.S w`, w = (positions) Q^T - (rest). Q minimises `sum a_i |x_i - X_i Q|^2`,
    with areas a_i and arms X_i at rest. Q depends on the positions, so the force is `Q^T S w` less `lambda x (a_i
    X_i Q)`. The second term removes the moment of the first: the internal force has neither a resultant nor a
    moment. If `swelling` is set, S includes it there.

    Parameters
    ----------
    surface : the closed surface
    parameters : material parameters
    held : (N,) mask of the held nodes. Facets at their rims are cut (`vdm.boundary.rims`), unless `tractions` is
        given. Nodes that are held later have the resolution of the mesh
    precise_as : number of nodes whose floating-point precision to use; None for the body's own
    tractions : (F,) number of the traction of each facet, of a surface that is cut at rims already

    Raises
    ------
    ParameterError
        shear_modulus missing, zero or not a scalar.
    SolverError
        more than `MAX_NODES` nodes.
    """

    name = "bem"
    swelling: Swelling | None = None
    _rims: Rims

    def __init__(
        self,
        surface: SurfaceMesh,
        parameters: Parameters,
        held: Mask | None = None,
        precise_as: int | None = None,
        *,
        tractions: Index | None = None,
    ) -> None:
        super().__init__(surface, parameters)
        modulus = parameters.shear_modulus
        if modulus is None or np.ndim(modulus) != 0 or not modulus > 0.0:
            raise ParameterError(f"the {self.name} formulation needs shear_modulus, one positive number")
        self.shear_modulus = float(modulus)
        self.poisson_ratio = 0.5 if parameters.is_filled else parameters.poisson_ratio
        self._precise_as, self._tractions = precise_as, tractions
        try:
            self._assemble(np.zeros(surface.n_nodes, np.bool_) if held is None else held)
        except linalg.LinAlgError as error:
            raise SolverError(INDEFINITE) from error
        pressed = surface.area_vectors[:, :, None]
        filled = surface.cavity_vectors if parameters.fluid_in_cavities else pressed[:, :, :0]
        self.corner = np.zeros((1 + filled.shape[2],) * 2)
        columns = rows = pressed
        if not self.is_incompressible:
            columns, rows = np.zeros_like(pressed), pressed * (self.bulk_modulus / surface.volume)
            self.corner[0, 0] = 1.0
        self.columns, self.rows = (
            DenseColumns(np.concatenate([part, filled], 2)) for part in (columns, rows)
        )

    @classmethod
    def supported(cls, surface: SurfaceMesh, parameters: Parameters, held: Mask) -> BoundaryFormulation:
        return cls(surface, parameters, held)

    @classmethod
    def compile(cls, surface: SurfaceMesh, parameters: Parameters) -> None:  # noqa: ARG003
        from vdm.boundary.operators import compile_for

        compile_for(surface.n_nodes)

    def _assemble(self, held: Mask) -> None:
        self._held = held
        self._rims = Rims.of(self.surface, held & (self._tractions is None))

    @cached_property
    def matrix(self) -> Array:
        """(3N, 3N) S, assembled at first use; a body in several parts never uses it."""
        if self.surface.n_nodes > MAX_NODES:
            raise SolverError(too_large(self.surface.n_nodes))
        try:
            return self._refined(self._held)
        except linalg.LinAlgError as error:
            raise SolverError(INDEFINITE) from error

    def _refined(self, held: Mask) -> Array:
        """(3N, 3N) S of the surface with facets cut along the rims of the held nodes, condensed to the N nodes."""
        near = np.concatenate([held, np.zeros(self.resolved.n_nodes - len(held), np.bool_)])
        return self._dense(self._rims, near)

    def _dense(self, rims: Rims, held: Mask) -> Array:
        """(3N, 3N) S of a surface with N nodes that is cut along its rims.

        Facets share tractions by their given numbers. Without numbers they do so in single precision only: in pairs
        away from the `held` nodes (N + k,) of the cut surface.
        """
        # numba takes a third of a second to import
        from vdm.boundary.operators import Facets, precision, surface_stiffness
        from vdm.boundary.tractions import shared

        cut, dtype = rims.surface, precision(self._precise_as or rims.body.n_nodes)
        tractions = self._tractions
        if tractions is None and dtype is np.float32:
            tractions = shared(cut, held)
        matrix = surface_stiffness(
            Facets.of(cut.points, cut.triangles, tractions), self.poisson_ratio, dtype, rims
        )
        matrix *= self.shear_modulus
        return matrix

    @property
    def n_coarse(self) -> int:
        """Number of nodes of the boundary-element mesh."""
        return len(self.matrix) // 3

    @property
    def is_incompressible(self) -> bool:
        """Whether the volume is constant, with the pressure as an unknown."""
        return self.poisson_ratio == 0.5

    @property
    def bulk_modulus(self) -> float:
        """kappa [Pa] of a compressible body."""
        nu = self.poisson_ratio
        return 2.0 * self.shear_modulus * (1.0 + nu) / (3.0 * (1.0 - 2.0 * nu))

    def record(self) -> dict[str, float | str]:
        return {**super().record(), "poisson_ratio": self.poisson_ratio, "scheme": "dense"}

    def apply(self, x: Array) -> Array:
        return self.elastic_force(x) + self.ground_force(x)

    def elastic_force(self, x: Array) -> Array:
        """S u (N, 3) [N]; reads half of the matrix."""
        return np.asarray(blas.dsymv(1.0, self.matrix.T, x.reshape(-1), lower=1)).reshape(-1, 3)

    def elastic_forces(self, x: Array) -> Array:
        """S u [N] for k displacements (N, 3, k); reads the matrix once."""
        force: Array = (self.matrix @ x.reshape(len(self.matrix), -1)).reshape(x.shape)
        return force

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        if factorise is not Cholesky:
            raise SolverError(DENSE)
        dofs = np.repeat(free, 3)
        return DenseFactor(self._grounded(self.matrix[np.ix_(dofs, dofs)], free))

    def projected(self, spread: sparse.csr_array) -> Array:
        """(m, m) Galerkin projection P^T S P on displacements P (3N, m)."""
        return np.asarray(spread.T @ (spread.T @ self.matrix).T)

    def stiffness(self) -> sparse.csr_array:
        return sparse.csr_array(self._grounded(self.matrix.copy(), np.ones(self.surface.n_nodes, np.bool_)))

    def diagonal(self) -> Array:
        ground = self.parameters.ground
        own = np.diagonal(self.matrix)
        return own if ground is None else own + ground.diagonal()

    def _grounded(self, block: Array, nodes: Mask) -> Array:
        """A block of S over some nodes, with their springs to the ground added."""
        if self.parameters.ground is not None:
            dofs = np.repeat(nodes, 3)
            springs = self.parameters.ground[dofs][:, dofs].tocoo()
            block[springs.coords] += springs.data  # entries are unique: a duplicate would be lost
        return block

    @property
    def resolved(self) -> SurfaceMesh:
        return self._rims.surface

    def carried(self, force: Array) -> Array:
        if len(self._rims.follows):
            _ = self.matrix  # also sets the rims' `follows`
        return self._rims.carried(force)

    @property
    def pressed(self) -> Array:
        return self.surface.area_vectors

    def pressure_force(self, pressure: Array) -> Array:
        """Nodal forces (N, 3) [N] of the weight, given as the hydrostatic pressure (N,) [Pa] that would carry it.

        The stress -p I of a linear p = b . x balances a body force b. In a compressible body its strain
        `-p I / (3 kappa)` has the displacement `-((b . x) x - b |x|^2 / 2) / (3 kappa)`. The rest of the solution
        has no body force, and its nodal forces are those of p and of that displacement.
        """
        arms = self.surface.points - self.surface.points.mean(axis=0)
        fitted = np.linalg.lstsq(np.column_stack([arms, np.ones(len(arms))]), pressure, rcond=None)[0]
        slope, mean = fitted[:3], fitted[3]
        force: Array = self.surface.area_vectors * pressure[:, None] + self.pressed_at_rims() @ slope
        if self.is_incompressible:
            return force
        moved = self.squeezed() @ slope - mean * arms / (3.0 * self.bulk_modulus)
        return force + self.elastic_force(moved)

    def pressed_at_rims(self) -> Array:
        """(N, 3, 3) forces that new nodes at rims add under the pressures x, y, z [N/(Pa/m)]."""
        body, cut = self.surface, self.resolved
        if cut is body:
            return np.zeros((body.n_nodes, 3, 3))
        middle = body.points.mean(axis=0)
        of_cut, of_body = (
            mesh.area_vectors[:, :, None] * (mesh.points - middle)[:, None] for mesh in (cut, body)
        )
        return self.carried(of_cut) - of_body

    def squeezed(self) -> Array:
        """(N, 3, 3) displacements under unit gradients of pressure, zero at the nodes' mean [m/(Pa/m)]."""
        arms = self.surface.points - self.surface.points.mean(axis=0)
        half = 0.5 * np.square(arms).sum(axis=1)[:, None, None] * np.eye(3)
        found: Array = (half - arms[:, :, None] * arms[:, None, :]) / (3.0 * self.bulk_modulus)
        return found

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:
        turn, unturned = self.unturned(state)
        force = self.swollen_force(unturned)
        return turned_back(force, turn[None], state, [slice(None)]) + self.ground_force(x)

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:
        unturned = self.unturned(state)[1]
        force = self.swollen_force(unturned)
        return 0.5 * float(np.vdot(unturned, force) + np.vdot(x, self.ground_force(x)))

    def swollen_force(self, x: Array) -> Array:
        """(N, 3) force S u [N], with the swelling if it is set, of a displacement in the body's rotated frame."""
        force = self.elastic_force(x)
        return force if self.swelling is None else force + self.swelling.forces(x)

    def swollen_forces(self, x: Array) -> Array:
        """`swollen_force` for k displacements (N, 3, k) at once."""
        force = self.elastic_forces(x)
        return force if self.swelling is None else force + self.swelling.forces(x)

    def swollen_block(self, rows: Index, columns: Index) -> Array:
        """A block of S, with the swelling if it is set, between degrees of freedom `rows` and `columns`."""
        block: Array = self.matrix[np.ix_(rows, columns)]
        if self.swelling is not None:
            block += self.swelling.block(rows, columns)
        return block

    def unturned(self, state: DeformedSurface) -> tuple[Array, Array]:
        """The best-fit rotation Q (3, 3) of the nodes, and their displacement (N, 3) [m] in its frame."""
        turn = state.rotation
        return turn, state.positions @ turn.T - state.body.rest


@dataclass(frozen=True)
class Swelling:
    """Replaces the volume change in S by the exact one: `S_0 = S + U C U^T` is zero for uniform swelling X.

    S measures the volume change by the flux `g.w` of a displacement w. If parts of the body rotate, the flux
    differs from the change of the polyhedron's volume V by a term of second order. So V replaces it. With `g.X = 3
    V`:

    - nu = 1/2: S is infinite for a nonzero flux. `S_0 = P^T S P`, `P = I - X g^T / (3 V)`, `U = [g / 3V, S X]`,
      `C = [[X.S X, -1], [-1, 0]]`. Nothing changes if g.w is zero. A pressure keeps V constant.
    - smaller nu: `S_0 = S - S X X^T S / (X.S X)` is positive semi-definite, and `S = S_0 + b b^T / a` with
      `b = 3 V S X / (X.S X)`, `a = (3 V)^2 / (X.S X)`. X causes a uniform pressure, so b is g, up to errors of
      quadrature and of coarse meshes: `b = g + v`. The energy is `1/2 w.S_0 w + (V - V_0 + v.w)^2 / (2 a)`.

    Attributes
    ----------
    vectors : (3N, 2) or (3N, 1) U
    core : (2, 2) or (1, 1) C
    beyond : (N, 3) v [m^2], zero at nu = 1/2
    give : a, volume over pressure [m^3/Pa], zero at nu = 1/2
    """

    vectors: Array
    core: Array
    beyond: Array
    give: float

    @classmethod
    def of(cls, form: BoundaryFormulation) -> Swelling:
        """The swelling of a body at rest."""
        arms = form.surface.points - form.surface.points.mean(axis=0)
        pulled, g = form.elastic_force(arms), form.surface.area_vectors
        work, flux = float(np.vdot(arms, pulled)), float(np.vdot(g, arms))
        if form.is_incompressible:
            vectors = np.stack([g / flux, pulled], axis=2).reshape(-1, 2)
            return cls(vectors, np.array([[work, -1.0], [-1.0, 0.0]]), np.zeros_like(g), 0.0)
        beyond = (flux / work) * pulled - g
        return cls(pulled.reshape(-1, 1), np.array([[-1.0 / work]]), beyond, flux**2 / work)

    def forces(self, x: Array) -> Array:
        """Forces U C U^T x [N] of displacements x (N, 3) or (N, 3, k), in the same shape."""
        flat = x.reshape(len(self.vectors), -1)
        return np.asarray(self.vectors @ (self.core @ (self.vectors.T @ flat))).reshape(x.shape)

    def block(self, rows: Index, columns: Index) -> Array:
        """A block of U C U^T between degrees of freedom `rows` and `columns`."""
        return np.asarray((self.vectors[rows] @ self.core) @ self.vectors[columns].T)

    def pressure(self, x: Array) -> float:
        """3 V times the difference of the pressures with S and with S_0, at a displacement (N, 3) [Pa m^3]."""
        return 0.0 if self.give else float(self.vectors[:, 1] @ x.reshape(-1))


class SwollenFactor:
    """Factor of a block of S with its swelling, from the factor of that block of S (Woodbury)."""

    def __init__(self, factor: Factor, swelling: Swelling, unknowns: Index) -> None:
        self._factor, self._vectors = factor, swelling.vectors[unknowns]
        self._answers = np.asarray(factor.solve(np.asfortranarray(self._vectors)))
        self._small = np.linalg.inv(swelling.core) + self._vectors.T @ self._answers

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides."""
        found = np.asarray(self._factor.solve(right_hand_side))
        return found - self._answers @ np.linalg.solve(self._small, self._vectors.T @ found)


def turned_back(force: Array, turns: Array, state: DeformedSurface, each: Sequence[slice]) -> Array:
    """Elastic forces (N, 3) in the world frame, from those in the rotated frames of several bodies.

    Body b has the nodes each[b] and the best-fit rotation turns[b]. The energy also depends on Q:
    `dQ = Q [omega]x` with `(tr P - P) omega = -sum levers x dx`. `P = sum levers (x) positions` is symmetric.
    The energy changes by `omega . sum positions x force`.
    """
    own = np.concatenate([force[span] @ q for span, q in zip(each, turns, strict=True)])
    levers = state.body.levers
    stretch = turns.transpose(0, 2, 1) @ moments(levers, state.positions, each)
    products = moments(state.positions, own, each)
    inertia = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch
    skew = products - products.transpose(0, 2, 1)
    twist = np.stack([skew[:, 1, 2], skew[:, 2, 0], skew[:, 0, 1]], axis=1)[:, :, None]
    pulls = np.linalg.solve(inertia, twist)[:, :, 0].tolist()
    for (x, y, z), q, span in zip(
        pulls, turns, each, strict=True
    ):  # subtract the cross product with each lever
        own[span] -= levers[span] @ (q @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]))
    return own


def moments(arms: Array, vectors: Array, each: Sequence[slice]) -> Array:
    """(m, 3, 3) sums of arms^T vectors over the nodes each[b] of body b; arms and vectors are (N, 3)."""
    return np.stack([arms[span].T @ vectors[span] for span in each])


def too_large(n_nodes: int) -> Status:
    """The status of a surface with too many nodes for a dense matrix."""
    return Status(
        "too-large",
        f"{n_nodes:,} nodes are more than the {MAX_NODES:,} of the dense matrix of boundary elements",
        f"use a mesh of at most {MAX_NODES:,} nodes, the sparse formulation, or finite elements",
    )


class DenseFactor:
    """Cholesky factor of a symmetric positive definite dense matrix; its inverse for up to `INVERTED` unknowns.

    A solve reads half of the inverse once, or half of the factor twice in turn. The inverse takes twice as long as
    the factor, so for `few` solves it is not computed.

    Raises
    ------
    SolverError
        the matrix is not positive definite.
    """

    def __init__(self, matrix: Array, *, few: bool = False) -> None:
        try:
            # the transpose, equal by symmetry, has the memory order in which LAPACK works in place
            self._factor = linalg.cho_factor(matrix.T, lower=True, overwrite_a=True, check_finite=False)[0]
        except linalg.LinAlgError as error:
            raise SolverError(INDEFINITE) from error
        diagonal = np.abs(np.diagonal(self._factor))
        if diagonal.min() < PIVOT_TOLERANCE * diagonal.max():
            raise SolverError(INDEFINITE)
        self._inverse: Array | None = None
        if len(matrix) <= INVERTED and not few:
            self._inverse = lapack.dpotri(self._factor, lower=1, overwrite_c=1)[0]

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides."""
        if right_hand_side.ndim == 2:
            if self._inverse is not None:
                return np.asarray(blas.dsymm(1.0, self._inverse, right_hand_side, lower=1))
            return np.asarray(lapack.dpotrs(self._factor, right_hand_side, lower=1)[0])
        if self._inverse is not None:
            return np.asarray(blas.dsymv(1.0, self._inverse, right_hand_side, lower=1))
        # LAPACK's own solve treats one right-hand side as a matrix, at half the speed
        half = blas.dtrsv(self._factor, right_hand_side, lower=1)
        return np.asarray(blas.dtrsv(self._factor, half, lower=1, trans=1, overwrite_x=1))
