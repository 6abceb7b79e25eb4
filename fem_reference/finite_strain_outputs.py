"""Gathers the states of a finite-strain load history into a `Solution`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fem_reference.loads import gather_to_vertices
from fem_reference.newton import Newton, Substep
from fem_reference.outputs import strain_below
from fem_reference.solution import CONVERGED, Solution, Status
from fem_reference.surface_stretch import BIOT, CREASE, most_compressed
from solver_common.arrays import Array
from solver_common.jit import clock
from solver_common.solution import ENDED, RESIDUAL

OUTPUTS = {
    "condition_estimate": "condition number of the scaled tangent's symmetric part in that state, see"
    " `fem_reference.condition`",
    "max_det_f_deviation": "largest |det F - 1| at the quadrature points",
    "max_principal_strain": "largest principal Green-Lagrange strain at the quadrature points",
    "p95_principal_strain": "principal Green-Lagrange strain that 95 % of the volume stays below",
    "volume": "volume of the deformed body [m^3]",
}

_FAILURES = {
    "not-converged": "Newton's method did not converge",
    "inverted": "a tetrahedron would turn inside out",
    "passed": "contact lost: the indenter goes past the surface",
    "linear-solver": "the tangent system could not be solved, as where a body buckles",
    "unstable": "the equilibrium that was found is not stable",
}
_TOUCHING = "push it in less far, or use a larger radius or a finer mesh where it touches"
_REMEDY = "load the body less, or use a finer mesh where it deforms most"
_SOFTER = 'load the body less, or bear more of its surface on soft springs (`elastic`, `direction = "full"`)'
_SNAPS = "load the body less, or give a displacement in place of the load"
_NO_STIFFNESS = 0.2  # of the stiffness at rest: steps of 1/256 end within the root of that of a limit point
_TOO_SMALL = Status(
    "too-small",
    "the load strains the body by less than the rounding of its coordinates",
    "use the linear solver, which such a load does not tell from this one, or load the body more",
)


@dataclass(eq=False)
class Record:
    """The outcome of a load history so far.

    Attributes
    ----------
    newton : of the body
    shear_modulus : unit of stress [Pa]
    steps : number of load steps
    outputs : names out of `OUTPUTS`
    """

    newton: Newton
    shear_modulus: float
    steps: int
    outputs: frozenset[str]

    def __post_init__(self) -> None:
        steps, outputs = self.steps, self.outputs
        self.system, self.assembly = self.newton.system, self.newton.assembly
        mesh = self._mesh = self.system.mesh
        nodes = len(mesh.surface_nodes)
        self._displacement = np.full((steps, nodes, 3), np.nan)
        self._reaction = np.full((steps, nodes, 3), np.nan)
        self._fluid_pressure = np.full(steps, np.nan)
        self._energy = np.full(steps, np.nan)
        self._scalars = {
            name: np.full(steps, np.nan)
            for name in ("load_factor", "substeps", "relative_residual", *sorted(outputs))
        }
        self.states: dict[int, Substep] = {}  # final state of each step, kept where its condition is wanted
        self._iterations = np.zeros(steps, dtype=np.int64)
        self._seconds = np.zeros(steps)
        self._status = [Status("not-reached", "an earlier load step failed", "see that step")] * steps
        self._converged = self.newton.rest  # last converged attempt, of any step
        # current step: number, load factor, last attempt
        self._open: tuple[int, float, Substep] | None = None
        self._clock = self._now()

    def _now(self) -> float:
        """Seconds by a clock that stands still while states are examined."""
        return clock() - self.newton.seconds_examined

    def add(self, number: int, attempt: Substep) -> None:
        """Record one attempt of load step `number`."""
        self._iterations[number] += len(attempt.residuals) - 1
        reached = self._open[1] if self._open else 0.0
        if attempt.converged:
            self._converged = attempt
            reached = attempt.load_factor
            self._scalars["substeps"][number] = np.nan_to_num(self._scalars["substeps"][number]) + 1.0
        self._open = (number, reached, attempt)
        if reached == 1.0:
            self._close(number, reached, CONVERGED)

    def end(self) -> None:
        """Record that no attempt follows: an unfinished step has failed."""
        if self._open:
            number, reached, attempt = self._open
            self._close(number, reached, self._failure(number, reached, attempt))

    def solution(
        self, seconds_setup: float, parameters: dict[str, float | str], condition: Mapping[int, float]
    ) -> Solution:
        """The whole history; `condition` holds the estimate at some steps."""
        for number, estimate in condition.items():
            self._scalars["condition_estimate"][number] = estimate
        return Solution(
            displacement=self._displacement,
            fluid_pressure=self._fluid_pressure,
            reaction_force=self._reaction,
            energy=self._energy,
            iterations=self._iterations,
            status=tuple(self._status),
            seconds_setup=seconds_setup,
            seconds_per_step=self._seconds,
            parameters=parameters,
            scalars=self._scalars,
        )

    def _failure(self, number: int, reached: float, attempt: Substep) -> Status:
        """The reason why a load step failed, from its last attempt and the last equilibrium."""
        if attempt.code == _TOO_SMALL.code:
            return _TOO_SMALL
        iterations, residual = len(attempt.residuals) - 1, attempt.residuals[-1]
        told = ENDED.format(
            _FAILURES[attempt.code], reached, number + 1, iterations, RESIDUAL.format(residual)
        )
        if attempt.code == "unstable":
            return Status(attempt.code, f"{told}; below it is a limit point, or the body buckles", _SNAPS)
        u = self._converged.state.displacement
        remedy = _TOUCHING if attempt.code == "passed" else _REMEDY
        touched = self.newton.touched(u, attempt.load)
        if touched and attempt.code != "passed":
            told += (
                f"; the indenter meets the surface on {'1 facet' if touched == 1 else f'{touched} facets'}"
            )
            remedy = _TOUCHING
        if not u.any():
            return Status(attempt.code, f"{told}; it found no equilibrium but the rest", remedy)
        worst = most_compressed(self._mesh, u * self._mesh.mean_edge)
        volume, place = self.assembly.least_volume_ratio(u)
        told += (
            f"; before it the surface at {_at(worst.place)} is compressed to {worst.least:.3f} of its length, and"
            f" the least volume ratio J is {volume:.3f} at {_at(place)}"
        )
        if attempt.code == "passed":
            return Status(attempt.code, told, remedy)
        across = np.sqrt(worst.other)
        if worst.plane < CREASE:
            told += f"; creasing: a free surface creases there below {CREASE / across:.2f}"
            if worst.plane < BIOT:
                told += f" and is unstable below {BIOT / across:.2f}, so that no smooth solution is stable"
            if self.system.held[self._mesh.facet_nodes[worst.facet]].any():
                told += (
                    "; it is at the rim of what is held, where the strain grows without bound as a mesh is refined:"
                    " a finer one ends sooner"
                )
            return Status(attempt.code, told, _SOFTER)
        softest = self.newton.softest(self._converged)
        told += f"; the lowest eigenvalue of the tangent is {softest:.2g} of that at rest"
        if softest < _NO_STIFFNESS:
            told += ": a limit point, no equilibrium is near beyond it"
            if touched:
                told += "; contact lost, as where a body slips off an indenter"
            return Status(attempt.code, told, remedy if touched else _SNAPS)
        return Status(attempt.code, told, remedy)

    def _close(self, number: int, reached: float, status: Status) -> None:
        self._status[number] = status
        self._scalars["load_factor"][number] = reached
        self._scalars["relative_residual"][number] = self._converged.residuals[-1]
        if "condition_estimate" in self.outputs:
            self.states[number] = self._converged
        self._store(number, self._converged)
        self._open = None
        now = self._now()
        self._seconds[number] = now - self._clock
        self._clock = now

    def _store(self, number: int, substep: Substep) -> None:
        mesh, length = self._mesh, self._mesh.mean_edge
        u, q = substep.state.displacement, substep.state.pressure
        p = self.system.pressure_scale * q
        self._displacement[number] = u[mesh.surface_nodes] * length
        force_unit = self.shear_modulus * length**2
        self._reaction[number] = gather_to_vertices(mesh, substep.reaction[None])[0] * force_unit
        volume = self.assembly.volume(u)
        self._fluid_pressure[number] = self.shear_modulus * self.assembly.pressure_integral(u, p) / volume
        # p^2 / (2 lambda) = c q^2 / 2, the energy of the volume change
        energy = self.assembly.strain_energy(u)
        if self.system.compliance is not None:
            energy += 0.5 * float(q @ (self.system.compliance @ q))
        self._energy[number] = energy * self.shear_modulus * length**3
        local = self.outputs & {"max_det_f_deviation", "max_principal_strain", "p95_principal_strain"}
        deviation, strain = self.assembly.largest(u) if local else (np.nan, np.full((1, 1), np.nan))
        values = {
            "max_det_f_deviation": deviation,
            "max_principal_strain": float(strain.max()),
            "p95_principal_strain": strain_below(strain, self.assembly.volumes) if local else np.nan,
            "volume": volume * length**3,
        }
        for name in self.outputs & values.keys():
            self._scalars[name][number] = values[name]


def _at(place: Array) -> str:
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*(1e3 * place))
