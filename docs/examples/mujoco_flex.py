"""MuJoCo's flex as a model: linear tetrahedra of a Saint Venant-Kirchhoff law, stepped until they rest.

The scene is the one that `vdmbench export` writes. Where the body rests is judged by the forces of its own law.
"""

import sys
import time
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from solver_common.solution import CONVERGED, Solution, Status
from vdmbench.models import Model, SetUp, register
from vdmbench.scene.export import FORCE_UNIT, TAKES, Handout, cannot_express, scene_text

MOST_STEPS = 300
STILL = 1e-6  # change in a step over the largest displacement
MOST_UNBALANCED = 1e-3  # force that no support takes, over the largest force


def prepare(scene, solver, name, n_loads):  # noqa: ARG001
    """MuJoCo's model of the scene's body; see `vdmbench.models.Model`."""
    import mujoco  # takes a while, and who only plans solves nothing

    start = time.perf_counter()
    body = Handout(scene, scene.load(1.0))
    if why := cannot_express(body, TAKES):
        raise ValueError(f"{name}: {why}")
    mujoco.set_mju_user_warning(lambda text: print(text, file=sys.stderr))  # else into a file here
    model = mujoco.MjModel.from_xml_string(scene_text(body, "scene_mujoco.xml", with_loads=False))
    seconds = time.perf_counter() - start

    def solve(loads):
        parts = [Handout(scene, load) for load in loads]
        data = mujoco.MjData(model)
        return solution(scene, parts, [_rest(mujoco, model, data, part) for part in parts], seconds)

    return SetUp(solve)


def _rest(mujoco, model, data, part):
    """Displacements (n, 3) [m] from the last load on, steps taken, 0 where it does not rest, and seconds."""
    start = time.perf_counter()
    bodies = model.flex_vertbodyid
    free = model.body_dofnum[bodies] == 3
    rest = part.mesh.points
    model.body_pos[bodies[~free]] = rest[~free] + part.displacement[~free]
    dofs = model.body_dofadr[bodies[free]][:, None] + np.arange(3)
    data.qfrc_applied[dofs] = part.force[free] / FORCE_UNIT
    moved, taken = np.full_like(rest, np.nan), 0
    for step in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        last, moved = moved, data.xpos[bodies] - rest
        if data.warning[mujoco.mjtWarning.mjWARN_BADQPOS].number or not np.isfinite(moved).all():
            break  # it burst, and was set back to rest
        if np.abs(moved - last).max() <= STILL * np.abs(moved).max():
            taken = step
            break
    if not taken:
        mujoco.mj_resetData(model, data)
    return moved, taken, time.perf_counter() - start


@dataclass(frozen=True)
class State:
    """What displacements of linear tetrahedra mean.

    Attributes
    ----------
    force : (n, 3) what supports and loads together must give [N]
    energy : [J]
    pressure : mean of -tr(Cauchy stress)/3 over the rest volume [Pa]
    least_volume : of a tetrahedron, over its volume at rest; below 0 it is turned inside out
    """

    force: np.ndarray
    energy: float
    pressure: float
    least_volume: float


def state(mesh, displacement, young, nu):
    """The state of displacements (n, 3): W = mu tr(E^2) + lambda/2 tr(E)^2 of the Green strain E = (F^T F - 1)/2.

    P = F (2 mu E + lambda tr(E)); forces are V P of the gradients of the barycentric coordinates.
    """
    mu, lame = young / (2.0 * (1.0 + nu)), young * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))

    def edges(points):
        corners = points[mesh.tetrahedra]
        return corners[:, 1:] - corners[:, :1]  # rows

    rest = edges(mesh.points)
    volume, inverse = np.linalg.det(rest) / 6.0, np.linalg.inv(rest)
    gradient = np.swapaxes(inverse @ edges(displacement), 1, 2)  # not F: at rest nothing is left of rounding
    turned = np.swapaxes(gradient, 1, 2)
    deformation, strain = np.eye(3) + gradient, 0.5 * (gradient + turned + turned @ gradient)
    trace = np.trace(strain, axis1=1, axis2=2)
    energy = mu * np.einsum("eij,eij->e", strain, strain) + 0.5 * lame * trace**2
    first = deformation @ (2.0 * mu * strain + lame * trace[:, None, None] * np.eye(3))
    gradients = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2)  # columns: corners
    force = np.zeros_like(displacement)
    np.add.at(force, mesh.tetrahedra, volume[:, None, None] * np.swapaxes(first @ gradients, 1, 2))
    growth = np.linalg.det(deformation)
    cauchy = np.einsum("eij,eij->e", first, deformation) / growth
    pressure = -(volume @ cauchy) / (3.0 * volume.sum())
    return State(force, float(volume @ energy), float(pressure), float(growth.min()))


def solution(scene, parts, found, seconds):
    """Where the body came to rest under each load, as an answer."""
    tissue, held, surface = scene.tissue, parts[0].held, scene.mesh.surface_nodes
    moved, steps, taken = (np.array(values) for values in zip(*found, strict=True))
    needed = [state(scene.mesh, u, tissue.youngs_modulus, tissue.poisson_ratio) for u in moved]
    gaps = [one.force - part.whole_force for part, one in zip(parts, needed, strict=True)]
    # a force that rounding of the points' coordinates makes
    least = 1e-15 * tissue.youngs_modulus * np.ptp(scene.mesh.points, axis=0).max() ** 2
    loose = np.array(
        [
            np.abs(gap[~held]).max() / max(np.abs(one.force).max(), least)
            for gap, one in zip(gaps, needed, strict=True)
        ]
    )
    return Solution(
        displacement=moved[:, surface],
        fluid_pressure=np.array([one.pressure for one in needed]),
        reaction_force=np.array([np.where(held[:, None], gap, 0.0)[surface] for gap in gaps]),
        energy=np.array([one.energy for one in needed]),
        iterations=steps,
        status=tuple(_status(*each) for each in zip(steps, loose, needed, strict=True)),
        seconds_setup=seconds,
        seconds_per_step=taken,
        parameters={"youngs_modulus": tissue.youngs_modulus, "poisson_ratio": tissue.poisson_ratio},
        scalars={"relative_residual": loose},
    )


def _status(steps, loose, reached):
    if not steps:
        return Status("no-rest", "MuJoCo's body burst or did not come to rest", "take smaller loads")
    if not loose <= MOST_UNBALANCED:
        message = f"MuJoCo's body rests with forces out of balance by {loose:.1e} of the largest"
        return Status("no-balance", message, "take smaller loads")
    if not reached.least_volume > 0.0:
        return Status("inside-out", "MuJoCo's body rests with tetrahedra inside out", "take smaller loads")
    return CONVERGED


register(
    Model(
        name="mujoco-flex",
        version=f"2, mujoco {version('mujoco')}",
        prepare=prepare,
        volumetric=True,
        solvers=("linear",),
        superposes=(),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=(),
        takes=dict.fromkeys(TAKES, ("linear",)),
        memory=lambda size, _: 2e8 + 5e4 * size.tetrahedra,
    )
)
