"""Linear elasticity condensed to the surface: each frame is exact and costs one dense product.

The linear problem is solved once for each direction in which pressure can push a node of the contact region:
three at a vertex, two at an edge's middle between two facets, one where facets are flat. It is solved once more
for each motion of the held nodes. Surface displacement, reactions, mean pressure and work are linear in those
forces and motions. They are the rows of one dense matrix.

Method: static condensation to the contact and the held nodes. Order: exact, to the residual of the solves.
Source: Guyan 1965, doi 10.2514/3.2874; Bro-Nielsen and Cotin 1996, doi 10.1111/1467-8659.1530057.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from fem_reference.assembly import gravity_weights
from fem_reference.linear import Fields, LinearProblem, Load
from fem_reference.linear_algebra import BATCH
from fem_reference.loads import check_loads, gather_to_vertices, prescribed_nodes
from fem_reference.memory import allowed_memory
from fem_reference.solution import CONVERGED, Solution, Status, check_outputs
from solver_common.arrays import Array
from solver_common.jit import clock
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

CONDITION = "condition_estimate"
# facets whose normals differ by less than this push in one direction: far below the promised accuracy
_FLAT = 1e-12
# a remainder beyond this share of a motion is outside the span of the prepared motions
_SPANNED = 1e-11


class CondensedProblem:
    """The response of a `LinearProblem` to contact pressure, weight and motions of held nodes, as one dense matrix.

    It equals the linear solve to the accuracy of that problem's solver.

    Parameters
    ----------
    problem : the linear problem; make it with solver="direct" or many `expected_loads`
    contact : (N,) surface nodes; a facet can be loaded if its three vertices are among them. May be empty without
        contact: the answer is then zero without weight and motions
    motions : (M, N, 3) displacements of held nodes, in any combination; without them these nodes rest [m]
    memory_limit : bytes the matrix may take; None for what the machine has left

    Attributes
    ----------
    nodes : (L,) nodes that take force, vertices and edge middles of the contact facets
    pushed : (C,) the place in `nodes` of each unit force, at most three of a node
    directions : (C, 3) unit vectors of these forces, perpendicular at a node
    matrix : (rows, C or C + 3, + M) response to unit forces [1/N], to unit accelerations where the body has a
        density, and to the motions. Rows: displacement of the surface nodes, displacement along the unit forces,
        reactions at held nodes, mean pressure, work of unit accelerations, and work of the reactions along the
        motions
    seconds_setup : time of the set-up, that of `problem` included [s]
    residual : largest relative residual of the solves

    Raises
    ------
    SolverError
        For a mask of a wrong shape or, without motions, of nodes that span no facet; for motions of a wrong shape
        or that are not finite; and for a matrix that does not fit into memory.
    """

    def __init__(
        self,
        problem: LinearProblem,
        contact: ArrayLike,
        memory_limit: float | None = None,
        motions: ArrayLike | None = None,
    ) -> None:
        start = clock()
        mesh = problem.mesh
        self.problem = problem
        mask = np.asarray(contact, dtype=bool)
        count = len(mesh.surface_nodes)
        if mask.shape != (count,):
            raise _bad_contact(f"contact has shape {mask.shape}", f"give shape ({count},)")
        self._facets = np.flatnonzero(mask[mesh.triangles].all(axis=1))
        self._motions = self._checked_motions(motions)
        if mask.any() and not len(self._facets) and not len(self._motions):
            raise _bad_contact("contact has no whole facet", "choose more nodes")
        self.nodes = np.unique(mesh.facet_nodes[self._facets])
        self._held = np.flatnonzero(problem.supported[mesh.surface_nodes])
        self._heavy = problem.density > 0.0
        self._unit_weight = problem.density * gravity_weights(mesh)
        self.pushed, self.directions = self._push_directions()
        columns = len(self.pushed) + 3 * self._heavy + len(self._motions)
        sizes = np.array([3 * count, len(self.pushed), 3 * len(self._held), 1, 3, len(self._motions)])
        self._rows = np.cumsum(sizes)[:-1]
        springs = problem.system.springs
        sprung = 3 * len(springs.nodes) + columns if springs else 0  # rows for the energy of the springs
        needed = 8.0 * float(sizes.sum() + sprung) * columns
        allowed = allowed_memory(memory_limit)
        if needed > allowed:
            raise solver_error(
                "memory",
                f"the compliance matrix needs {needed / 1e6:.0f} MB but {allowed / 1e6:.0f} MB are available",
                "choose fewer contact nodes or a larger mesh_size",
            )
        self._moved_nodes = prescribed_nodes(mesh, [_motion(problem, motion) for motion in self._motions])
        self.matrix = np.empty((int(sizes.sum()), columns))
        self.residual = 0.0
        moved = np.empty((columns, len(springs.nodes) if springs else 0, 3))
        for first in range(0, columns, BATCH):
            chosen = np.arange(first, min(first + BATCH, columns))
            fields = self._respond(chosen)
            self.matrix[:, chosen] = self._observe(fields).T
            self.residual = max(self.residual, float(fields.residual.max()))
            if springs:
                moved[chosen] = fields.displacement[:, springs.nodes]
        unit = problem.shear_modulus * mesh.mean_edge  # of force over length
        self._spring_works = springs.works(moved) * unit if springs else None
        self._to_forces = self._facet_forces()
        self.seconds_precompute = clock() - start
        self.seconds_setup = problem.seconds_setup + self.seconds_precompute

    @property
    def bytes(self) -> int:
        """Size of the dense matrix [B]."""
        return self.matrix.nbytes

    def solve(self, loads: Sequence[Load], outputs: frozenset[str] = frozenset()) -> Solution:
        """One frame per load, each a dense product.

        `outputs` may contain "condition_estimate", that of the problem that gave the columns.

        Raises
        ------
        SolverError
            For a load that `LinearProblem` would refuse, pressure outside the contact region, held nodes that
            move outside the span of `motions`, and an unknown output.
        """
        check_outputs(outputs, [CONDITION])
        mesh = self.problem.mesh
        check_loads(mesh, loads)
        frames = np.empty((len(loads), len(self.matrix)))
        work = np.empty(len(loads))
        energy = np.empty(len(loads))
        seconds = np.empty(len(loads))
        if loads:  # not timed: the first product takes several times as long as later ones
            np.matmul(self.matrix, np.concatenate(self._amplitudes(0, loads[0])), out=frames[0])
        for step, load in enumerate(loads):
            start = clock()
            forces, weight, motion = self._amplitudes(step, load)
            amplitudes = np.concatenate([forces, weight, motion])
            frames[step] = self.matrix @ amplitudes
            observed = np.split(frames[step], self._rows)
            work[step] = forces @ observed[1] + weight @ observed[4][: len(weight)]
            energy[step] = 0.5 * (work[step] + motion @ observed[5])
            if self._spring_works is not None:
                energy[step] += 0.5 * amplitudes @ self._spring_works @ amplitudes
            seconds[step] = clock() - start
        displacement, _, held, pressure, _, _ = np.split(frames, self._rows, axis=1)
        reaction = np.zeros((len(loads), len(mesh.surface_nodes), 3))
        reaction[:, self._held] = held.reshape(len(loads), -1, 3)
        return Solution(
            displacement=displacement.reshape(len(loads), -1, 3),
            fluid_pressure=pressure[:, 0].copy(),
            reaction_force=reaction,
            energy=energy,
            iterations=np.zeros(len(loads), dtype=np.int64),
            status=(self._status(),) * len(loads),
            seconds_setup=self.seconds_setup,
            seconds_per_step=seconds,
            parameters={
                "youngs_modulus": self.problem.youngs_modulus,
                "poisson_ratio": self.problem.poisson_ratio,
                "density": self.problem.density,
                "solver": self.problem.solver.name,
                "factorisation": self.problem.solver.library,
                "contact_nodes": float(len(self.nodes)),
                "columns": float(self.matrix.shape[1]),
                "matrix_bytes": float(self.bytes),
                "seconds_precompute": self.seconds_precompute,
                "relative_residual": self.residual,
            },
            scalars={
                "compliance": work,
                "relative_residual": np.full(len(loads), self.residual),
                **({CONDITION: np.full(len(loads), self.problem.condition)} if outputs else {}),
            },
        )

    def _amplitudes(self, step: int, load: Load) -> tuple[Array, Array, Array]:
        """Forces along `directions`, accelerations and shares of the motions of one load."""
        pressure = np.asarray(load.facet_pressure, dtype=np.float64)
        inside = pressure[self._facets]
        if np.count_nonzero(pressure) > np.count_nonzero(inside):
            raise _bad_load(
                f"load step {step + 1} has pressure outside the contact region", "enlarge contact"
            )
        if load.forces is not None and np.any(load.forces):
            raise _bad_load(
                f"load step {step + 1} has given forces", "use LinearProblem: frames are pushed by pressure"
            )
        forces = np.asarray(self._to_forces @ inside.ravel())
        gravity = np.asarray(load.gravity, dtype=np.float64) if self._heavy else np.zeros(0)
        return forces, gravity, self._motion_shares(step, load)

    def _motion_shares(self, step: int, load: Load) -> Array:
        """(M,) shares of the motions that give a load's displacement of the held components."""
        given = np.asarray(load.prescribed, dtype=np.float64)[self._held_components]
        shares = np.asarray(self._to_shares @ given)
        left = given - self._moved.T @ shares
        if np.abs(left).max(initial=0.0) > _SPANNED * np.abs(given).max(initial=0.0):
            raise _bad_load(
                f"load step {step + 1} moves held nodes in a way that is not among motions",
                "add it to motions or use LinearProblem for it",
            )
        return shares

    def _checked_motions(self, motions: ArrayLike | None) -> Array:
        """(M, N, 3) motions; also prepares the fit of a load's shares of them."""
        surface = self.problem.mesh.surface_nodes
        values = np.zeros((0, len(surface), 3)) if motions is None else np.asarray(motions, dtype=np.float64)
        if values.ndim != 3 or values.shape[1:] != (len(surface), 3):
            raise _bad_contact(f"motions has shape {values.shape}", f"give shape (M, {len(surface)}, 3)")
        if not np.isfinite(values).all():
            raise _bad_contact("motions has values that are not finite", "give metres")
        self._held_components = self.problem.held[surface]
        self._moved = values[:, self._held_components]
        self._to_shares = np.linalg.pinv(self._moved.T)
        return values

    def _push_directions(self) -> tuple[NDArray[np.int64], Array]:
        """An orthonormal basis of the area vectors of each node's contact facets: see `pushed`, `directions`."""
        mesh = self.problem.mesh
        area = mesh.area_vectors[self._facets]
        place = np.searchsorted(self.nodes, mesh.facet_nodes[self._facets])
        normals = area / np.linalg.norm(area, axis=1)[:, None]
        by_node = np.argsort(place, axis=None, kind="stable")
        count = np.bincount(place.ravel())
        if not len(count):
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        slot = np.arange(place.size) - np.repeat(np.cumsum(count) - count, count)
        around = np.zeros((len(self.nodes), int(count.max()), 3))
        around[place.ravel()[by_node], slot] = normals[by_node // place.shape[1]]
        _, size, axes = np.linalg.svd(around, full_matrices=False)
        node, axis = np.nonzero(size > _FLAT * size[:, :1])
        return node, axes[node, axis]

    def _facet_forces(self) -> csr_array:
        """(C, facets * Q) forces along `directions` of unit pressures at the facets' quadrature points."""
        mesh = self.problem.mesh
        points, weights = facet_quadrature()
        shape = mesh.facet_functions(points) * weights[:, None]
        area = mesh.area_vectors[self._facets]
        values = -np.einsum("qa,fk->fqak", shape, area)
        place = np.searchsorted(self.nodes, mesh.facet_nodes[self._facets])
        rows = 3 * place[:, None, :, None] + np.arange(3)
        points_of = np.arange(area.shape[0] * len(weights)).reshape(len(area), len(weights), 1, 1)
        rows, columns = (np.broadcast_to(a, values.shape).ravel() for a in (rows, points_of))
        forces = csr_array(
            (values.ravel(), (rows, columns)), shape=(3 * len(self.nodes), len(area) * len(weights))
        )
        count = len(self.pushed)
        along = csr_array(
            (
                self.directions.ravel(),
                (3 * self.pushed[:, None] + np.arange(3)).ravel(),
                3 * np.arange(count + 1),
            ),
            shape=(count, 3 * len(self.nodes)),
        )
        return csr_array(along @ forces)

    def _respond(self, chosen: NDArray[np.int64]) -> Fields:
        """The fields for some columns of the matrix."""
        mesh = self.problem.mesh
        forces = np.zeros((len(chosen), mesh.n_nodes, 3))
        given = np.zeros_like(forces)
        own, weights = len(self.pushed), 3 * self._heavy
        for force, motion, column in zip(forces, given, chosen.tolist(), strict=True):
            if column < own:
                force[self.nodes[self.pushed[column]]] = self.directions[column]
            elif column < own + weights:
                force[:, column - own] = self._unit_weight
            else:
                motion[:] = self._moved_nodes[column - own - weights]
        return self.problem.solve_nodal(forces, given)

    def _observe(self, fields: Fields) -> Array:
        """(S, rows) the rows of the matrix that fields give."""
        mesh, steps = self.problem.mesh, len(fields.displacement)
        u = fields.displacement
        reaction = gather_to_vertices(mesh, fields.reaction)[:, self._held]
        held_force, springs = fields.reaction, self.problem.system.springs
        if springs:
            held_force = held_force - springs.forces(u) * (self.problem.shear_modulus * mesh.mean_edge)
        parts = (
            u[:, mesh.surface_nodes],
            np.einsum("sck,ck->sc", u[:, self.nodes[self.pushed]], self.directions),
            reaction,
            self.problem.mean_pressure(fields),
            np.einsum("n,snk->sk", self._unit_weight, u),
            np.einsum("snk,mnk->sm", held_force, self._moved_nodes),
        )
        return np.concatenate([part.reshape(steps, -1) for part in parts], axis=1)

    def _status(self) -> Status:
        tolerance = self.problem.solver.tolerance
        if self.residual <= tolerance:
            return CONVERGED
        return Status(
            "not-converged",
            f"a column of the compliance reached a relative residual of {self.residual:.1e},"
            f" {tolerance:.0e} is needed",
            'improve the worst tetrahedra of the mesh or make the problem with solver="direct"',
        )


def _motion(problem: LinearProblem, displacement: Array) -> Load:
    """A load that moves held nodes and does nothing else."""
    held = problem.held[problem.mesh.surface_nodes]
    return Load(np.zeros(0), np.where(held, displacement, 0.0), np.zeros(3))


_bad_contact = partial(solver_error, "bad-contact")


_bad_load = partial(solver_error, "bad-load")
