"""Newton's VBD, run by `engine.py`: linear tetrahedra of a neo-Hookean law, stepped until nothing moves.

In: `points` (n, 3) [m], `tetrahedra` (E, 4), `held` (n,), `force` (S, n, 3) with the weight [N], `displacement`
(S, n, 3) of held points [m], `mu`, `lame` [Pa], `density` [kg/m3], `duration`: the time step to begin with [s].
Each load step starts from the last. Out: `displacement` (S, n, 3) [m], `iterations`: steps that the engine took, 0
where it burst or did not come to rest, `seconds` (S,), `setup`, `version`.

A step ends after a fixed number of sweeps over the points, which leave a part of its fall: the body rests too low,
the more the longer the time step. So that is halved until the rest moves no more.
"""

import time
from typing import Any

import newton
import numpy as np
import warp as wp

SWEEPS = 20  # over all points in a time step
MOST_STEPS = 4000  # of one load step
STILL, CALM = 2e-6, 20  # change in a step over the largest displacement; steps of which each changes less
ROUNDING = 2.0**-22  # of the largest coordinate: two of the last digit, which go up and down at rest
SAME, MOST_HALVINGS = 5e-4, 6  # change of the rest by a halved time step, likewise


def solve(given: dict[str, Any]) -> dict[str, Any]:
    """See above."""
    start = time.perf_counter()
    body = _Body(given)
    setup = time.perf_counter() - start
    found, steps, seconds = [], [], []
    for force, displacement in zip(given["force"], given["displacement"], strict=True):
        start = time.perf_counter()
        moved, taken = body.under(force, displacement)
        seconds.append(time.perf_counter() - start)
        found.append(moved)
        steps.append(taken)
    return {
        "displacement": np.array(found),
        "iterations": np.array(steps),
        "seconds": np.array(seconds),
        "setup": setup,
        "version": newton.__version__,
    }


class _Body:
    def __init__(self, given: dict[str, Any]) -> None:
        wp.config.quiet = True
        self.rest, self.held = given["points"], given["held"]
        self.duration = float(given["duration"])
        self.rounding = ROUNDING * float(np.abs(self.rest).max())
        build = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
        build.add_soft_mesh(
            pos=wp.vec3(0.0, 0.0, 0.0),
            rot=wp.quat_identity(),
            scale=1.0,
            vel=wp.vec3(0.0, 0.0, 0.0),
            vertices=[wp.vec3(*point) for point in self.rest.tolist()],
            indices=given["tetrahedra"].ravel().tolist(),
            density=float(given["density"]),
            k_mu=float(given["mu"]),
            k_lambda=float(given["lame"]),
            k_damp=0.0,
            add_surface_mesh_edges=False,
        )
        for point in np.flatnonzero(self.held):
            build.particle_mass[point] = 0.0  # such a point stays where it is put
        build.color()
        self.model = build.finalize(device="cpu")
        self.solver = newton.solvers.SolverVBD(self.model, iterations=SWEEPS)
        self.states = [self.model.state(), self.model.state()]

    def under(self, force: Any, displacement: Any) -> tuple[Any, int]:
        """The displacements at rest and the steps taken, 0 for none."""
        pull = wp.array(force.astype(np.float32), dtype=wp.vec3, device="cpu")
        at = self.states[0].particle_q.numpy()
        at[self.held] = self.rest[self.held] + displacement[self.held]
        for state in self.states:
            state.particle_q.assign(at)
            state.particle_qd.zero_()
        taken, duration, last = 0, self.duration, None
        for _ in range(MOST_HALVINGS):
            moved, steps = self._come_to_rest(pull, duration, MOST_STEPS - taken)
            taken += steps
            if not steps:
                self.states[0].particle_q.assign(self.rest)
                return np.full_like(self.rest, np.nan), 0
            if last is not None and np.abs(moved - last).max() <= SAME * np.abs(moved).max():
                return moved, taken
            last, duration = moved, duration / 2.0
        return moved, 0

    def _come_to_rest(self, pull: Any, duration: float, most: int) -> tuple[Any, int]:
        """The same with one time step; at each peak of the kinetic energy all points are stopped."""
        control = self.model.control()
        moved, energy, calm = self.states[0].particle_q.numpy() - self.rest, 0.0, 0
        for step in range(1, most + 1):
            now, then = self.states
            now.clear_forces()
            now.particle_f.assign(pull)
            self.solver.step(now, then, control, None, duration)
            self.states.reverse()
            speed = then.particle_qd.numpy()
            kinetic = float(np.einsum("ni,ni->", speed, speed))
            if kinetic < energy:
                then.particle_qd.zero_()
                kinetic = 0.0
            energy = kinetic
            last, moved = moved, then.particle_q.numpy() - self.rest
            if not np.isfinite(moved).all():
                return moved, 0
            change, size = np.abs(moved - last).max(), np.abs(moved).max()
            calm = calm + 1 if change <= max(STILL * size, self.rounding) else 0
            if calm == CALM:
                return moved, step
        return moved, 0
