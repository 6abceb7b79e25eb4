"""Engines of others, from their wheels: MuJoCo's flex, Newton's VBD, and NGSolve's elements as a second reference.

Each solve runs a file `engine_NAME.py` in a process of its own, which gets and gives arrays: what the engine
prints, holds or breaks stays there. Without its wheel a model is refused by name.
"""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..scene.as_mjcf import FORCE_UNIT, TAKES, mjcf
from ..scene.handout import Handout, cannot_express
from ..scene.scene import Scene, SurfaceLoad
from ..study.registry import missing
from . import costs
from .elements import fem_loads
from .model import Model, SetUp, register
from .tetrahedra import Law, State, moduli_of, saint_venant, stable_neo_hookean, state

if TYPE_CHECKING:
    from solver_common.solution import Solution, Status

Arrays = dict[str, Any]
MOST_SECONDS = 3600.0
MOST_UNBALANCED = 1e-3  # of an engine's answer, by its own law, over the forces of load and support
_HERE = Path(__file__).parent


def call(engine: str, given: Arrays) -> Arrays:
    """What the engine in a file `engine_NAME.py` answers, from a process of its own. Raises SolverError."""
    from solver_common.solution import SolverError, Status

    buffer = io.BytesIO()
    np.savez(buffer, **given)
    command = [sys.executable, "-P", str(_HERE / "engine.py"), str(_HERE / f"engine_{engine}.py")]
    try:
        ended = subprocess.run(
            command, input=buffer.getvalue(), capture_output=True, timeout=MOST_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        message = f"{engine} takes more than {MOST_SECONDS:.0f} s"
        raise SolverError(Status("too-slow", message, "use a larger mesh_size")) from None
    if ended.returncode or not ended.stdout:
        said = ended.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {ended.returncode}"]
        raise SolverError(Status("engine-failed", f"{engine} ended: {said[-1][:300]}", "leave the model out"))
    with np.load(io.BytesIO(ended.stdout)) as file:
        return dict(file)


def _require(name: str) -> None:
    from solver_common.solution import SolverError, Status

    lack = missing(name)
    if lack is not None:
        raise SolverError(Status("missing-wheel", *lack))


def _mujoco(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    body = _expressed(scene, name)
    text = mjcf(body, loaded=False)

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        parts = [Handout(scene, load) for load in loads]
        force = np.array([part.force for part in parts]) / FORCE_UNIT
        moved = np.array([part.displacement for part in parts])
        found = call("mujoco", {"scene": np.array(text), "force": force, "displacement": moved})
        return _rested(scene, parts, found, saint_venant, "MuJoCo")

    return SetUp(solve)


def _newton(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    body = _expressed(scene, name)
    mu, lame = moduli_of(body.tissue.youngs_modulus, body.tissue.poisson_ratio)
    edges = np.diff(body.mesh.points[body.mesh.tetrahedra[:, :2]], axis=1)
    # in which a wave of shear and stretch passes an edge
    duration = np.linalg.norm(edges, axis=2).mean() * np.sqrt(
        body.tissue.density / body.tissue.youngs_modulus
    )
    given = {
        "points": body.mesh.points,
        "tetrahedra": body.mesh.tetrahedra,
        "held": body.held,
        "mu": np.array(mu),
        "lame": np.array(lame),
        "density": np.array(body.tissue.density),
        "duration": np.array(duration),
    }

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        parts = [Handout(scene, load) for load in loads]
        force = np.array([part.whole_force for part in parts])
        moved = np.array([part.displacement for part in parts])
        found = call("newton", {**given, "force": force, "displacement": moved})
        return _rested(scene, parts, found, stable_neo_hookean, "Newton")

    return SetUp(solve)


def _expressed(scene: Scene, name: str) -> Handout:
    """The body for an engine of linear tetrahedra. Raises SolverError without its wheel, else ValueError."""
    _require(name)
    body = Handout(scene, scene.load(1.0))
    if why := cannot_express(body, TAKES):
        raise ValueError(f"{name}: {why}")
    return body


def _rested(scene: Scene, parts: Sequence[Handout], found: Arrays, law: Law, engine: str) -> Solution:
    """Where an engine came to rest under each load, judged by the forces of its own law."""
    from solver_common.solution import Solution

    tissue, held, surface = scene.tissue, parts[0].held, scene.mesh.surface_nodes
    # a force that rounding of the points' coordinates makes
    least = 1e-15 * tissue.youngs_modulus * np.ptp(scene.mesh.points, axis=0).max() ** 2
    needed = [
        state(scene.mesh, u, tissue.youngs_modulus, tissue.poisson_ratio, law) for u in found["displacement"]
    ]
    given = [one.force - part.whole_force for part, one in zip(parts, needed, strict=True)]
    loose = [
        np.abs(gap[~held]).max() / max(np.abs(one.force).max(), least)
        for gap, one in zip(given, needed, strict=True)
    ]
    reaction = [np.where(held[:, None], gap, 0.0)[surface] for gap in given]
    steps = found["iterations"].tolist()
    return Solution(
        displacement=found["displacement"][:, surface],
        fluid_pressure=np.array([one.pressure for one in needed]),
        reaction_force=np.array(reaction),
        energy=np.array([one.energy for one in needed]),
        iterations=found["iterations"],
        status=tuple(_at_rest(engine, *each) for each in zip(steps, loose, needed, strict=True)),
        seconds_setup=float(found["setup"]),
        seconds_per_step=found["seconds"],
        parameters=_parameters(scene, found),
        scalars={"relative_residual": np.array(loose)},
    )


def _at_rest(engine: str, steps: int, loose: float, reached: State) -> Status:
    from solver_common.solution import CONVERGED, Status

    if not steps:
        return Status("no-rest", f"{engine}'s body burst or did not come to rest", "take smaller loads")
    if not loose <= MOST_UNBALANCED:
        message = f"{engine}'s body rests with forces out of balance by {loose:.1e} of the largest"
        return Status("no-balance", message, "take smaller loads")
    if not reached.least_volume > 0.0:
        return Status("inside-out", f"{engine}'s body rests with tetrahedra inside out", "take smaller loads")
    return CONVERGED


def _ngsolve(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    from fem_reference.loads import held_nodes, nodal_forces
    from fem_reference.mesh import TetMesh

    _require(name)
    if scene.tissue.poisson_ratio == 0.0:
        raise ValueError(f"{name}: its pressure field needs a poisson_ratio above 0")
    mesh = TetMesh(scene.mesh.points, scene.mesh.tetrahedra, scene.mesh.surface_nodes, scene.mesh.triangles)
    held, n = held_nodes(mesh, scene.held)[:, 0], len(scene.mesh.points)
    body = {
        "points": scene.mesh.points,
        "tetrahedra": scene.mesh.tetrahedra,
        "facets": scene.mesh.surface_nodes[scene.mesh.triangles],
        "edges": mesh.skfem_mesh.edges.T.astype(np.int64),
        "held": held[:n],
        "held_edges": held[n:],
        "young": np.array(scene.tissue.youngs_modulus),
        "poisson": np.array(scene.tissue.poisson_ratio),
        "large": np.array(solver == "nonlinear"),
    }

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        from solver_common.solution import CONVERGED, Solution, Status

        forces = nodal_forces(mesh, fem_loads(loads, mesh), scene.tissue.density)
        displacement = np.array([Handout(scene, load).displacement for load in loads])
        steps = {"force": forces[:, :n], "edge_force": forces[:, n:], "displacement": displacement}
        found = call("ngsolve", {**body, **steps})
        failed = Status("no-balance", "NGSolve's Newton iteration finds no balance", "take smaller loads")
        surface = scene.mesh.surface_nodes
        return Solution(
            displacement=found["displacement"][:, surface],
            fluid_pressure=found["pressure"],
            reaction_force=found["reaction"][:, surface],
            energy=found["energy"],
            iterations=found["iterations"],
            status=tuple(CONVERGED if taken else failed for taken in found["iterations"].tolist()),
            seconds_setup=float(found["setup"]),
            seconds_per_step=found["seconds"],
            parameters=_parameters(scene, found),
        )

    return SetUp(solve)


def _parameters(scene: Scene, found: Arrays) -> dict[str, float | str]:
    return {
        "youngs_modulus": scene.tissue.youngs_modulus,
        "poisson_ratio": scene.tissue.poisson_ratio,
        "engine_version": str(found["version"]),
    }


def _version(own: str, wheel: str) -> str:
    """Of the numbers that a model gives: they change with the engine."""
    try:
        return f"{own}, {wheel} {version(wheel)}"
    except PackageNotFoundError:
        return own


_peer = partial(
    Model,
    volumetric=True,
    tissue=("youngs_modulus", "poisson_ratio"),
    parameters=(),
    fibres=False,
)
register(
    _peer(
        name="mujoco-flex",
        version=_version("1", "mujoco"),
        prepare=_mujoco,
        solvers=("linear",),
        superposes=(),
        takes=dict.fromkeys(TAKES, ("linear",)),
        cost=costs.mujoco,
        needs="mujoco",
    )
)
register(
    _peer(
        name="newton-vbd",
        version=_version("1", "newton"),
        prepare=_newton,
        solvers=("linear",),
        superposes=(),
        takes=dict.fromkeys(TAKES, ("linear",)),
        cost=costs.newton,
        needs="newton",
    )
)
register(
    _peer(
        name="ngsolve-p2p1",
        version=_version("1", "ngsolve"),
        prepare=_ngsolve,
        solvers=("linear", "nonlinear"),
        superposes=("linear",),
        takes={"dead forces": ("linear", "nonlinear")},
        cost=costs.ngsolve,
        needs="ngsolve",
    )
)
