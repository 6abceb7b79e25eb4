"""The surface that knows its inside: elastic forces of the homogeneous body by boundary elements, without a fit."""

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

# of a dense matrix of (3N)^2 numbers
MAX_NODES = 2000
# unknowns up to which the inverse is worth its making: 0.2 s of 3 at 1,000 nodes
INVERTED = 3000
# smallest over largest pivot of a factor that is told from a singular one
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

    S is the body's surface stiffness by symmetric Galerkin boundary elements: the work of the tractions that a
    solid of shear modulus mu needs for u (see `vdm.boundary.operators`). Poisson's ratio 1/2 is VDM's fluid: it
    keeps the volume, and dP is its pressure, the null vector of the single layer. A solid of a smaller ratio has
    no such constraint; dP is then its mean pressure, `-kappa (sum g_i.u_i) / V`. A cavity that a fluid fills has a
    pressure too, and keeps its volume.

    Facets at the rim of the held nodes are cut inside (`vdm.boundary.rims`), unless the numbers of their tractions
    (F,) are given: then they are cut already. Other nodes may be held later, at the mesh's own resolution. It is as
    precise as a body of `precise_as` nodes, else of its own.

    Dense, (3N)^2 numbers and a set-up of order N^3, on up to `MAX_NODES` nodes.

    At large displacements it is one of the parts of `vdm.parts.body`. S turns with the rotation Q that best fits
    the part's surface: `E = 1/2 w.S w`, w = (positions) Q^T - (rest), Q from `sum a_i |x_i - X_i Q|^2`, areas a_i
    and arms X_i at rest. As Q turns with the positions, the force is `Q^T S w` less `lambda x (a_i X_i Q)`: forces
    that take off the moment of the first term, so that the internal force has neither a resultant nor a moment. S
    has its `swelling` there, where that is set.

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
        """(3N, 3N) S, made when it is first asked for: of a body in parts nothing does."""
        if self.surface.n_nodes > MAX_NODES:
            raise SolverError(too_large(self.surface.n_nodes))
        try:
            return self._refined(self._held)
        except linalg.LinAlgError as error:
            raise SolverError(INDEFINITE) from error

    def _refined(self, held: Mask) -> Array:
        """(3N, 3N) S of the surface, cut along the rims of what is held."""
        near = np.concatenate([held, np.zeros(self.resolved.n_nodes - len(held), np.bool_)])
        return self._dense(self._rims, near)

    def _dense(self, rims: Rims, held: Mask) -> Array:
        """(3N, 3N) S of a surface of N nodes, cut along its rims.

        Facets share tractions as they were given, else in single precision, but at the rim of these held nodes of
        the cut surface.
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
        """Nodes of the body that the integrals are of."""
        return len(self.matrix) // 3

    @property
    def is_incompressible(self) -> bool:
        """Whether the volume is kept, by a pressure that is an unknown."""
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
        """S u, (N, 3), which reads half of the matrix."""
        return np.asarray(blas.dsymv(1.0, self.matrix.T, x.reshape(-1), lower=1)).reshape(-1, 3)

    def elastic_forces(self, x: Array) -> Array:
        """S u of k displacements (N, 3, k) at once, which reads the matrix once."""
        force: Array = (self.matrix @ x.reshape(len(self.matrix), -1)).reshape(x.shape)
        return force

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:
        if factorise is not Cholesky:
            raise SolverError(DENSE)
        dofs = np.repeat(free, 3)
        return DenseFactor(self._grounded(self.matrix[np.ix_(dofs, dofs)], free))

    def projected(self, spread: sparse.csr_array) -> Array:
        """(m, m) P^T S P of displacements P (3N, m)."""
        return np.asarray(spread.T @ (spread.T @ self.matrix).T)

    def stiffness(self) -> sparse.csr_array:
        return sparse.csr_array(self._grounded(self.matrix.copy(), np.ones(self.surface.n_nodes, np.bool_)))

    def diagonal(self) -> Array:
        ground = self.parameters.ground
        own = np.diagonal(self.matrix)
        return own if ground is None else own + ground.diagonal()

    def _grounded(self, block: Array, nodes: Mask) -> Array:
        """A block of S over some nodes, with their springs added to it."""
        if self.parameters.ground is not None:
            dofs = np.repeat(nodes, 3)
            springs = self.parameters.ground[dofs][:, dofs].tocoo()
            block[springs.coords] += springs.data  # one entry a place: a sum of two would be lost
        return block

    @property
    def resolved(self) -> SurfaceMesh:
        return self._rims.surface

    def carried(self, force: Array) -> Array:
        if len(self._rims.follows):
            _ = self.matrix  # what follows at the rims is known with it
        return self._rims.carried(force)

    @property
    def pressed(self) -> Array:
        return self.surface.area_vectors

    def pressure_force(self, pressure: Array) -> Array:
        """Force (N, 3) of weight, given as the hydrostatic pressure (N,) that would carry it.

        The stress -p I of a linear p = b . x balances a force b per volume. In a compressible body it belongs to
        the displacement `-((b . x) x - b |x|^2 / 2) / (3 kappa)`, a strain -p I / (3 kappa): what is left to find
        is a field without a force inside, whose nodal forces are those of p and those of that displacement.
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
        """(N, 3, 3) what the new nodes of rims add to the forces of the pressures x, y, z [N/(Pa/m)]."""
        body, cut = self.surface, self.resolved
        if cut is body:
            return np.zeros((body.n_nodes, 3, 3))
        middle = body.points.mean(axis=0)
        of_cut, of_body = (
            mesh.area_vectors[:, :, None] * (mesh.points - middle)[:, None] for mesh in (cut, body)
        )
        return self.carried(of_cut) - of_body

    def squeezed(self) -> Array:
        """(N, 3, 3) displacements of the pressures x, y, z about the nodes' mean, over these [m/(Pa/m)]."""
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
        """Force (N, 3) of a displacement in the body's frame at large displacements: S u and its swelling."""
        force = self.elastic_force(x)
        return force if self.swelling is None else force + self.swelling.forces(x)

    def swollen_forces(self, x: Array) -> Array:
        """The same of k displacements (N, 3, k) at once."""
        force = self.elastic_forces(x)
        return force if self.swelling is None else force + self.swelling.forces(x)

    def swollen_block(self, rows: Index, columns: Index) -> Array:
        """The block of S and its swelling of some unknowns."""
        block: Array = self.matrix[np.ix_(rows, columns)]
        if self.swelling is not None:
            block += self.swelling.block(rows, columns)
        return block

    def unturned(self, state: DeformedSurface) -> tuple[Array, Array]:
        """The best-fit rotation Q of the nodes and the displacement left after it is undone."""
        turn = state.rotation
        return turn, state.positions @ turn.T - state.body.rest


@dataclass(frozen=True)
class Swelling:
    """What makes a uniform swelling X of a body cost nothing, `S_0 = S + U C U^T`, and what it costs by volume.

    Small strain knows the flux `g.w` of a displacement w, the polyhedron its volume V: where something turns within
    the body they differ, by a term of second order. What S says of a flux is said of the volume instead. With
    `g.X = 3 V`:

    - nu = 1/2: what S says of it hangs on its null vector. `S_0 = P^T S P`, `P = I - X g^T / (3 V)`,
      `U = [g / 3V, S X]`, `C = [[X.S X, -1], [-1, 0]]`. Where g.w is zero nothing changes. V is kept.
    - less: `S_0 = S - S X X^T S / (X.S X)`, not negative, and `S = S_0 + b b^T / a` with `b = 3 V S X / (X.S X)`,
      `a = (3 V)^2 / (X.S X)`. X makes a uniform pressure, so that b is g, but for quadrature and what a coarse body
      does not resolve: `b = g + v`. The energy is `1/2 w.S_0 w + (V - V_0 + v.w)^2 / (2 a)`.

    Attributes
    ----------
    vectors : (3N, 2) or (3N, 1) U
    core : (2, 2) or (1, 1) C
    beyond : (N, 3) v [m^2], zero at nu = 1/2
    give : a, volume per pressure [m^3/Pa], zero at nu = 1/2
    """

    vectors: Array
    core: Array
    beyond: Array
    give: float

    @classmethod
    def of(cls, form: BoundaryFormulation) -> Swelling:
        """That of a body."""
        arms = form.surface.points - form.surface.points.mean(axis=0)
        pulled, g = form.elastic_force(arms), form.surface.area_vectors
        work, flux = float(np.vdot(arms, pulled)), float(np.vdot(g, arms))
        if form.is_incompressible:
            vectors = np.stack([g / flux, pulled], axis=2).reshape(-1, 2)
            return cls(vectors, np.array([[work, -1.0], [-1.0, 0.0]]), np.zeros_like(g), 0.0)
        beyond = (flux / work) * pulled - g
        return cls(pulled.reshape(-1, 1), np.array([[-1.0 / work]]), beyond, flux**2 / work)

    def forces(self, x: Array) -> Array:
        """Of displacements (N, 3) or (N, 3, k), of their shape."""
        flat = x.reshape(len(self.vectors), -1)
        return np.asarray(self.vectors @ (self.core @ (self.vectors.T @ flat))).reshape(x.shape)

    def block(self, rows: Index, columns: Index) -> Array:
        """Of some unknowns."""
        return np.asarray((self.vectors[rows] @ self.core) @ self.vectors[columns].T)

    def pressure(self, x: Array) -> float:
        """3 V times what a pressure beside S is above one beside `S_0`, in a displacement (N, 3) [Pa m^3]."""
        return 0.0 if self.give else float(self.vectors[:, 1] @ x.reshape(-1))


class SwollenFactor:
    """Factor of a block of S with its swelling, by that of S (Woodbury)."""

    def __init__(self, factor: Factor, swelling: Swelling, unknowns: Index) -> None:
        self._factor, self._vectors = factor, swelling.vectors[unknowns]
        self._answers = np.asarray(factor.solve(np.asfortranarray(self._vectors)))
        self._small = np.linalg.inv(swelling.core) + self._vectors.T @ self._answers

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n,) or (n, m) right-hand sides."""
        found = np.asarray(self._factor.solve(right_hand_side))
        return found - self._answers @ np.linalg.solve(self._small, self._vectors.T @ found)


def turned_back(force: Array, turns: Array, state: DeformedSurface, each: Sequence[slice]) -> Array:
    """Elastic forces (N, 3) in the world of bodies that lie one after another, of those in their frames.

    Body b has the nodes each[b] and the best-fit rotation turns[b]. The energy changes with it too:
    dQ = Q [omega]x with `(tr P - P) omega = -sum levers x dx`, `P = sum levers (x) positions`, is symmetric, and it
    changes by `omega . sum positions x force`.
    """
    own, levers = (
        np.concatenate([force[span] @ q for span, q in zip(each, turns, strict=True)]),
        state.body.levers,
    )
    stretch = turns.transpose(0, 2, 1) @ moments(levers, state.positions, each)
    products = moments(state.positions, own, each)
    inertia = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - stretch
    skew = products - products.transpose(0, 2, 1)
    twist = np.stack([skew[:, 1, 2], skew[:, 2, 0], skew[:, 0, 1]], axis=1)[:, :, None]
    pulls = np.linalg.solve(inertia, twist)[:, :, 0].tolist()
    for (x, y, z), q, span in zip(pulls, turns, each, strict=True):  # less its vector product with each lever
        own[span] -= levers[span] @ (q @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]))
    return own


def moments(arms: Array, vectors: Array, each: Sequence[slice]) -> Array:
    """(m, 3, 3) sums of arm^T vector over the nodes each[b] of bodies that lie one after another, (N, 3)."""
    return np.stack([arms[span].T @ vectors[span] for span in each])


def too_large(n_nodes: int) -> Status:
    """What is said of a surface that a dense matrix is no way for."""
    return Status(
        "too-large",
        f"{n_nodes:,} nodes are more than the {MAX_NODES:,} of the dense matrix of boundary elements",
        f"use a mesh of at most {MAX_NODES:,} nodes, the sparse formulation, or finite elements",
    )


class DenseFactor:
    """Cholesky factor of a symmetric positive definite dense matrix; of up to `INVERTED` unknowns its inverse.

    A frame reads half of an inverse once and half of a factor twice, one after the other. An inverse takes twice as
    long to make as a factor: `few` solutions are not worth it.

    Raises
    ------
    SolverError
        a matrix that is not positive definite.
    """

    def __init__(self, matrix: Array, *, few: bool = False) -> None:
        try:
            # a symmetric matrix is its own transpose, which is in the order that LAPACK works in place with
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
        # LAPACK's own takes a single right-hand side for a matrix: half as fast
        half = blas.dtrsv(self._factor, right_hand_side, lower=1)
        return np.asarray(blas.dtrsv(self._factor, half, lower=1, trans=1, overwrite_x=1))
