"""Newton's method along a load path for the mixed finite-strain problem, in the scaled units of `system`.

Method: consistent unsymmetric tangent, inexact linear solves, substeps that are halved on failure and doubled
where convergence is easy. Order: 2 in the iterations; a tangent that is good enough for one more step is kept,
which makes that step linear. Source: Bonet and Wood, 2nd ed., chapter 9; forcing after Eisenstat and Walker 1996,
doi 10.1137/0917003.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import bsr_array, csr_array

from fem_reference.assembly import Pattern
from fem_reference.finite_contact import PENALTY, RigidContact
from fem_reference.finite_strain_assembly import ElementAssembly
from fem_reference.follower import FollowerPressure
from fem_reference.surface_stretch import BIOT, most_compressed
from fem_reference.system import LinearSystem, hold_components
from fem_reference.tangent_solver import Factors, TangentSolver, TangentSystem
from solver_common.arrays import Array, Mask
from solver_common.jit import clock
from solver_common.progress import Progress, tell
from solver_common.quadrature import facet_quadrature
from solver_common.substeps import Substeps

_FAST = 0.1  # an iteration that reduces the residual at least to this share is not the last
_EASY = 5  # Newton iterations after which the next substep may be longer
# far from the solution Newton may raise the residual; repeated rises may lead to another branch
_MOST_RISES = 2
_ROUNDING = 4e-15  # of a displacement gradient, with a margin
# largest remainder of a load that is so small that rounding decides when to stop
_LEFT = 1e-3
# a linear solve need not be more exact than the quadratic model
_LEAST_FORCING, _MOST_FORCING = 1e-10, 1e-2
_INVERSE_ITERATIONS, _INVERSE_TOLERANCE = 8, 1e-6  # for an eigenvalue that is reported to one digit


@dataclass(frozen=True)
class ScaledLoad:
    """A load in scaled units.

    Attributes
    ----------
    pressure : (F, Q) on the deformed surface
    forces : (n_nodes, 3) dead
    given : (n_nodes, 3) displacement of held components
    depth : of the indenter, where there is one
    """

    pressure: Array
    forces: Array
    given: Array
    depth: float = 0.0

    @property
    def size(self) -> float:
        """Euclidean norm of the load."""
        return float(np.sqrt(sum(np.vdot(part, part) for part in (self.pressure, self.forces, self.given))))

    def towards(self, other: ScaledLoad, share: float) -> ScaledLoad:
        """The load at `share` of the way to another."""
        if share == 1.0:
            return other
        return ScaledLoad(
            (1.0 - share) * self.pressure + share * other.pressure,
            (1.0 - share) * self.forces + share * other.forces,
            (1.0 - share) * self.given + share * other.given,
            (1.0 - share) * self.depth + share * other.depth,
        )


@dataclass(frozen=True)
class State:
    """A state in scaled units.

    Attributes
    ----------
    displacement : (n_nodes, 3)
    pressure : (n,) q = p / a
    fluid : (k,) pressures in the cavities that a fluid fills
    """

    displacement: Array
    pressure: Array
    fluid: Array


@dataclass(frozen=True)
class Substep:
    """The outcome of one attempted substep.

    Attributes
    ----------
    load_factor : share of the load step that was attempted
    load : load at that share
    state : the converged state; after a failure the one before the attempt
    reaction : (n_nodes, 3) force of supports and springs on the body, scaled
    external : (n_nodes, 3) applied forces, scaled
    residuals : relative residual before each Newton iteration, and after the last
    code : "converged", or why not: "not-converged", "inverted", "linear-solver", "passed", "unstable" or
        "too-small"
    """

    load_factor: float
    load: ScaledLoad
    state: State
    reaction: Array
    external: Array
    residuals: tuple[float, ...]
    code: str

    @property
    def converged(self) -> bool:
        """Whether equilibrium was found."""
        return self.code == "converged"


@dataclass(frozen=True)
class _Residual:
    vector: Array
    linear: Array  # residual by the linear model of contact, whose points may pull
    relative: float
    unsettled: float  # relative, by the iteration's pressures, or how far points are from where these press
    scale: float  # of the forces in the residual
    reaction: Array
    external: Array
    least_determinant: float
    fluid_gap: Array  # (k,) change of the cavities' volumes
    fluid_push: Array  # (k, n_nodes, 3) forces of unit pressures in them, the gradients of their volumes


@dataclass(eq=False)
class Newton:
    """Equilibrium of one body under changing loads.

    Attributes
    ----------
    system : the linear system of the undeformed body, whose numbering and pressure scale are used
    pattern, coupling : the scalar pattern of its mesh, and that of its pressures
    assembly : element forces and tangents
    follower : the pressure on the deformed surface
    solver : of the linear systems
    max_newton : iterations before a substep fails, unless the last one was fast
    tolerance : of the residual, relative to the internal forces
    cavities : (F, k) facets of the walls of fluid-filled cavities
    contact : of an indenter, while there is one
    place : current load step and number of steps, for the progress report
    seconds_examined : time that `is_stable` took so far, no part of a load step [s]
    """

    system: LinearSystem
    pattern: Pattern
    coupling: Pattern
    assembly: ElementAssembly
    follower: FollowerPressure
    solver: TangentSolver
    max_newton: int
    tolerance: float
    cavities: Mask
    contact: RigidContact | None = None
    place: tuple[int, int] = (0, 1)
    seconds_examined: float = 0.0

    def __post_init__(self) -> None:
        mesh, kept = self.system.mesh, self.system.kept
        self._points = mesh.node_points / mesh.mean_edge
        self._inner = self.pattern.numbered[kept][:, kept]
        self._inner_divergence = self.coupling.numbered[:, kept]
        self._fluid_volumes = self._fluid(np.zeros_like(self._points))[0]

    @property
    def rest(self) -> Substep:
        """The undeformed body under no load."""
        mesh = self.system.mesh
        nothing = np.zeros((mesh.n_nodes, 3))
        unloaded = ScaledLoad(np.zeros((len(mesh.triangles), len(facet_quadrature()[1]))), nothing, nothing)
        state = State(nothing, np.zeros(mesh.n_pressures), np.zeros(len(self.cavities.T)))
        return Substep(0.0, unloaded, state, nothing, nothing, (0.0,), "converged")

    def follow(
        self, state: State, start: ScaledLoad, end: ScaledLoad, *, examines: bool = True
    ) -> Iterator[Substep]:
        """Go from one load to another, in substeps as long as convergence allows.

        Yields every attempt; the last one reaches load factor one or fails. An element may turn inside out at
        some load, and a later substep may head for J = 0 before it. That load is then tried at once; if it fails
        again, it is the last attempt. Failures from the start do not count: shorter substeps reach such loads.
        """
        substeps, wall, ends = Substeps(), 0.0, False
        while substeps.reached < 1.0:
            reached, target = substeps.reached, substeps.target
            attempt = self.solve(state, start.towards(end, target), target, reached)
            if examines and attempt.converged and not self.is_stable(attempt.state, attempt.load):
                attempt = replace(attempt, state=state, code="unstable")
            yield attempt
            if attempt.converged:
                substeps.found(len(attempt.residuals) - 1 <= _EASY)
                before, state = state, attempt.state
                ahead = (wall - target) / (target - reached)
                ends = ahead > 0.0 and self._turns_inside_out(before, state, ahead)
                if ends:
                    substeps.leap(wall)
            elif ends or attempt.code == "too-small" or not substeps.failed() or self._is_unstable(attempt):
                return
            elif attempt.code == "inverted" and reached > 0.0:
                wall = target

    def _turns_inside_out(self, before: State, state: State, ahead: float) -> bool:
        """Whether `ahead` more steps like that between two states would reduce the least volume ratio J to zero."""
        old, new = (self.assembly.least_volume_ratio(one.displacement)[0] for one in (before, state))
        return new <= ahead * (old - new)

    def is_stable(self, state: State, load: ScaledLoad) -> bool:
        """Whether an equilibrium is stable, by a direct factor; yes where the solver has none, or forces follow.

        Those of a pressure have an energy where its stiffness is symmetric, which takes no tangent of the body.
        """
        if not isinstance(self.solver.preconditioner, Factors):
            return True
        start, x = clock(), self._points + state.displacement
        stable = not self.follower.has_energy(
            x, load.pressure, ~self.system.held
        ) or self.solver.preconditioner.is_stable(
            self.tangent(state, load).symmetric(), self.kept_volumes(state)
        )
        self.seconds_examined += clock() - start
        return stable

    def _is_unstable(self, failed: Substep) -> bool:
        """Whether surface or tangent is unstable before a failed substep, so that shorter substeps do not help."""
        mesh = self.system.mesh
        if failed.code == "passed":  # with a shorter step the indenter may touch the surface
            return False
        crumpled = most_compressed(mesh, failed.state.displacement * mesh.mean_edge).plane < BIOT
        unsolved = failed.code == "linear-solver" and len(failed.residuals) == 1
        # the state's own tangent, except for the stiffness of a follower pressure
        return crumpled or (unsolved and not failed.load.pressure.any())

    def solve(self, state: State, load: ScaledLoad, load_factor: float, reached: float = 0.0) -> Substep:
        """Newton iterations from a state, at load factor `reached`, to equilibrium under a load."""
        u, q, c = state.displacement, state.pressure, state.fluid
        touch = np.zeros((0, 0)) if self.contact is None else self.contact.untouched
        found = self._residual(u, q, c, load, touch)
        passed = Substep(
            load_factor, load, state, found.reaction, found.external, (found.relative,), "passed"
        )
        if self._passes(u, load):
            return passed
        # forces before and after the step, and those that only move held nodes
        largest = max(found.scale, float(np.abs(load.given).max()))
        residuals = [found.unsettled]

        def outcome(at: State, code: str) -> Substep:
            return Substep(load_factor, load, at, found.reaction, found.external, tuple(residuals), code)

        tangent: TangentSystem | None = None
        while True:
            tell(Progress(*self.place, reached, load_factor, len(residuals) - 1, residuals[-1]))
            step = np.where(self.system.held, load.given - u, 0.0)
            if found.relative <= self.tolerance and not step.any():
                residuals[-1] = found.relative
                # an acting load must not vanish in rounding; a remainder of a removed load may
                lost = float(np.abs(found.vector).max()) > _LEFT * max(found.scale, largest)
                if lost and found.external.any():
                    return outcome(state, "too-small")
                return (
                    passed
                    if self._passes(u, load) or self._is_behind(u, load)
                    else outcome(State(u, q, c), "converged")
                )
            rises = sum(b > a for a, b in itertools.pairwise(residuals[1:]))
            slow = len(residuals) > self.max_newton and residuals[-1] > _FAST * residuals[-2]
            if slow or rises > _MOST_RISES or not np.isfinite(found.relative):
                return outcome(state, "not-converged")
            if tangent is None or not self._good_enough(residuals):
                tangent = None  # free it first: both take as much memory
                tangent = self.tangent(State(u, q, c), load, touch)
            update = self._update(tangent, step, found)
            if update is None:
                return outcome(state, "linear-solver")
            # An update that would turn an element inside out is halved twice, then the load step is. Measured:
            # half the way to the first J = 0 goes as far or further on coarse meshes, but slower on a fine one.
            pressed = touch
            if self.contact is not None:
                pressed = self.contact.predicted(self._points + u, load.depth, touch, update[0])
            for damping in (1.0, 0.5, 0.25):
                at = [old + damping * change for old, change in zip((u, q, c), update, strict=True)]
                at.append(np.maximum(touch + damping * (pressed - touch), 0.0))
                trial = self._residual(at[0], at[1], at[2], load, at[3])
                if trial.least_determinant > 0.0:
                    break
            else:
                return outcome(state, "inverted")
            (u, q, c, touch), found = at, trial
            residuals.append(found.unsettled)

    def _passes(self, u: Array, load: ScaledLoad) -> bool:
        """Whether the indenter has passed through the surface."""
        return self.contact is not None and self.contact.passes(self._points + u, load.depth)

    def _is_behind(self, u: Array, load: ScaledLoad) -> bool:
        """Whether the indenter is behind the surface that it met, as after too long a step."""
        return self.contact is not None and self.contact.is_pushed_on(self._points + u, load.depth)

    def touched(self, u: Array, load: ScaledLoad) -> int:
        """Number of facets under pressure of a load's indenter."""
        return 0 if self.contact is None else self.contact.touched(self._points + u, load.depth)

    def _good_enough(self, residuals: list[float]) -> bool:
        """Whether the last tangent is good enough once more: if it gains at least as much as in the last step."""
        return len(residuals) > 2 and residuals[-1] ** 2 <= 0.1 * self.tolerance * residuals[-2]

    def _update(
        self, tangent: TangentSystem, step: Array, found: _Residual
    ) -> tuple[Array, Array, Array] | None:
        """The Newton update that also moves held components by `step`; None if it cannot be computed."""
        forcing = _MOST_FORCING
        if not step.any():
            wanted = max(0.1 * found.relative, 0.1 * self.tolerance / found.relative)
            forcing = float(np.clip(wanted, _LEAST_FORCING, _MOST_FORCING))
        if self.contact is not None:
            # a residual relative to the penalty's forces is larger relative to the body's
            forcing = max(forcing / PENALTY, _LEAST_FORCING)
        x, solved = self.solver.solve(tangent, -found.linear - tangent.action(step), forcing)
        n, kept = self.system.n_displacements, self.system.kept
        fluid = np.zeros(len(found.fluid_gap))
        if len(fluid) and solved:  # border of fluid pressures, each of which keeps a cavity's volume
            rows = [self._nodal_rows(push) for push in found.fluid_push]
            answers = [self.solver.solve(tangent, row, forcing) for row in rows]
            solved = all(done for _, done in answers)
            given = np.einsum("knc,nc->k", found.fluid_push, step)
            moved = np.array([[row @ answer for answer, _ in answers] for row in rows])
            fluid = -np.linalg.solve(moved, found.fluid_gap + given + np.array([row @ x for row in rows]))
            x = x + fluid @ np.array([answer for answer, _ in answers])
        if not solved:
            return None
        du = step.copy()
        # an iterative solver leaves rounding at held components, which must move exactly
        du[kept] += np.where(self.system.held[kept], 0.0, x[:n].reshape(-1, 3))
        return du, x[n:], fluid

    def _fluid(self, u: Array) -> tuple[Array, Array]:
        """Volumes (k,) of the cavities that a fluid fills, and their gradients (k, n_nodes, 3)."""
        x, weights = self._points + u, facet_quadrature()[1]
        pushes = [self.follower.forces(x, np.outer(wall, np.ones_like(weights))) for wall in self.cavities.T]
        gradients = np.array(pushes).reshape(-1, *x.shape)
        return np.einsum("knc,nc->k", gradients, x) / 3.0, gradients

    def kept_volumes(self, state: State) -> Array:
        """(k, size) gradients of the volumes that a fluid keeps, as rows of the system."""
        pushes = self._fluid(state.displacement)[1]
        return np.array([self._nodal_rows(push) for push in pushes]).reshape(-1, self.system.size)

    def _filled(self, load: ScaledLoad, fluid: Array) -> ScaledLoad:
        """A load with the fluid's pressures on the walls of its cavities."""
        return (
            replace(load, pressure=load.pressure + (self.cavities @ fluid)[:, None]) if len(fluid) else load
        )

    def _residual(self, u: Array, q: Array, c: Array, load: ScaledLoad, touch: Array) -> _Residual:
        system = self.system
        internal = self.assembly.forces(u, system.pressure_scale * q)
        load = self._filled(load, c)
        external = load.forces + self.follower.forces(self._points + u, load.pressure)
        if self.contact is not None:
            pushed = self.contact.forces(self._points + u, load.depth)
            external = external + pushed
        unbalanced = internal.nodal - external
        pulled = np.zeros_like(u) if system.springs is None else system.springs.forces(u)
        unbalanced -= pulled
        vector = self._vector(unbalanced, internal.volume)
        if system.compliance is not None:
            vector[system.n_displacements :] -= system.compliance @ q
        # forces below the rounding of the displacement gradient count as zero
        noise = _ROUNDING * np.sqrt(u.size) * (1.0 + float(np.abs(u).max()))
        scale = max(float(np.linalg.norm(a)) for a in (internal.nodal, external))
        volumes, gradients = self._fluid(u)
        gap = volumes - self._fluid_volumes
        grown = float(np.abs(gap / self._fluid_volumes).max(initial=0.0))

        def relative(rows: Array) -> float:
            return max(float(np.linalg.norm(rows)) / max(scale, noise / self.tolerance), grown)

        linear, unsettled = vector, relative(vector)
        if self.contact is not None:
            x = self._points + u
            pulls = self.contact.predicted(x, load.depth, touch, np.zeros_like(u))
            linear = vector - self._nodal_rows(self.contact.forces(x, load.depth, pulls) - pushed)
            own = vector - self._nodal_rows(self.contact.forces(x, load.depth, touch) - pushed)
            unsettled = max(relative(own), self.contact.lacking(x, load.depth, touch))
        return _Residual(
            vector,
            linear,
            relative(vector),
            unsettled,
            scale,
            np.where(system.held, unbalanced, 0.0) + pulled,
            external,
            internal.least_determinant,
            gap,
            gradients,
        )

    def _nodal_rows(self, nodal: Array) -> Array:
        """As `_vector`, without volume changes."""
        return self._vector(nodal, np.zeros(self.system.mesh.n_pressures))

    def _vector(self, nodal: Array, volume: Array) -> Array:
        """The rows of the system from nodal forces and volume changes."""
        system = self.system
        top = np.where(system.held, 0.0, nodal)[system.kept].ravel()
        return np.concatenate([top, -system.pressure_scale * volume])

    def tangent(self, state: State, load: ScaledLoad, touch: Array | None = None) -> TangentSystem:
        """The tangent in a state, with an indenter's pressures `touch` (f, Q), by default those of the penalty."""
        system, pattern, coupling = self.system, self.pattern, self.coupling
        u, q, load = state.displacement, state.pressure, self._filled(load, state.fluid)
        blocks, volumes = self.assembly.tangent(u, system.pressure_scale * q)
        divergence = self._divergence(volumes)
        if system.springs is not None:
            system.springs.add_to(blocks, system.mesh, pattern)
        if self.contact is not None:
            self.contact.add_stiffness(blocks, self._points + u, load.depth, touch)
        is_pressed = bool(load.pressure.any())
        if is_pressed:
            places, pressed = self.follower.stiffness(self._points + u, load.pressure)
            blocks[places] += pressed
        gradient = csr_array(divergence.T)
        true = replace(system, stiffness=self._stiffness(blocks), divergence=divergence, gradient=gradient)

        def symmetric() -> LinearSystem:
            if not is_pressed:
                return true
            half = blocks.copy()
            half[places] -= 0.5 * pressed
            half[pattern.mirror[places]] += 0.5 * np.swapaxes(pressed, 1, 2)
            return replace(true, stiffness=self._stiffness(half))

        def action(step: Array) -> Array:
            if not step.any():
                return np.zeros(system.size)
            size, rows = 3 * len(u), system.mesh.n_pressures
            flat = step.ravel()
            nodal = bsr_array((blocks, pattern.indices, pattern.indptr), shape=(size, size)) @ flat
            volume = bsr_array((volumes, coupling.indices, coupling.indptr), shape=(rows, size)) @ flat
            return self._vector(nodal.reshape(-1, 3), volume)

        return TangentSystem(true, symmetric, action)

    def softest(self, reached: Substep) -> float:
        """Lowest eigenvalue of the tangent in a state, over the stiffness at rest; NaN where a solve fails.

        Among the isochoric modes it is 1 at rest and 0 at a limit point. Inverse iteration starts from the
        state's displacement; of several close eigenvalues it may find one that is not the lowest.
        """
        n, kept = self.system.n_displacements, self.system.kept
        tangent = self.tangent(reached.state, reached.load)
        x = np.where(self.system.held[kept], 0.0, reached.state.displacement[kept]).ravel()
        ratio = np.nan
        for _ in range(_INVERSE_ITERATIONS):
            pull = np.zeros(self.system.size)
            pull[:n] = self.system.stiffness @ (x / np.linalg.norm(x))
            found, solved = self.solver.solve(tangent, pull, _INVERSE_TOLERANCE)
            x = found[:n]
            if not solved:
                return np.nan
            ratio = float(x @ pull[:n]) / float(x @ (self.system.stiffness @ x))
        return ratio

    def _stiffness(self, blocks: Array) -> bsr_array:
        inner, held = self._inner, self.system.held[self.system.kept]
        size = self.system.n_displacements
        # `take` copies whole blocks, three times as fast as an index
        matrix = bsr_array(
            (np.take(blocks, inner.data, axis=0), inner.indices, inner.indptr), shape=(size, size)
        )
        hold_components(matrix, held)
        return matrix

    def _divergence(self, volumes: Array) -> csr_array:
        inner, held = self._inner_divergence, self.system.held[self.system.kept]
        data = self.system.pressure_scale * volumes[inner.data]
        data[held[inner.indices][:, None, :]] = 0.0
        shape = (self.system.mesh.n_pressures, self.system.n_displacements)
        return csr_array(bsr_array((data, inner.indices, inner.indptr), shape=shape))


class LoadPath:
    """States of one body that were reached under a sequence of loads, and the load at which the path ended.

    The loads must lie on one path, with rising size. A load beyond the end of the path has no solution near it
    and is not tried again. On a stable path the equilibrium does not depend on the load from which Newton's
    method starts, to the tolerance. Where a path branches it may.
    """

    def __init__(self) -> None:
        self._reached: list[Substep] = []
        self._end: Substep | None = None  # smallest load at which a last attempt failed

    def follow(self, newton: Newton, load: ScaledLoad) -> Iterator[Substep]:
        """As `Newton.follow`, to a load from the known state below it; yields that state first."""
        known = (state for state in self._reached if state.load.size <= load.size)
        start = max(known, key=lambda state: state.load.size, default=newton.rest)
        yield replace(start, load_factor=0.0, residuals=start.residuals[-1:])
        if self._end is not None and self._end.load.size <= load.size:
            yield replace(self._end, load_factor=1.0, residuals=self._end.residuals[-1:])
            return
        attempt = start
        for attempt in newton.follow(start.state, start.load, load):
            if attempt.converged:
                self._reached.append(attempt)
            yield attempt
        if not attempt.converged and attempt.code != "too-small":
            self._end = attempt
