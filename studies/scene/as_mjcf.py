"""A scene for MuJoCo: one flex of linear tetrahedra, Saint Venant-Kirchhoff, as MJCF.

Each point is a body with a slide joint an axis and its share of the mass. A held point has no joint; one that is
moved has joints that are held where it goes. A force is an actuator whose bias it is.
"""

from __future__ import annotations

from html import escape  # that of XML loads what opens network addresses

import numpy as np

from solver_common.arrays import Mask

from .handout import Handout, remarks

NAME = "MuJoCo (MJCF)"
TAKES = frozenset({"dead forces"})  # of the extras of a study what it writes
FLEX = "tissue"
_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
# its solver stops at absolute bounds made for robots: in newtons a soft body drifts on for hundreds of steps
FORCE_UNIT = 1e-6  # of the scene [N], and of its masses [kg]
# under 3.13 a flex is not integrated implicitly, and bursts
_HEAD = (
    "But here, so that its solver is exact enough: forces in uN, stresses in uPa, masses in mg. Lengths stay in m.",
    "Needs MuJoCo 3.13 or newer. Step until nothing moves: with so long a step that takes 5 to 50 steps.",
    "The law is Saint Venant-Kirchhoff, which is soft where it is pressed far together.",
)


def mjcf(body: Handout, *, loaded: bool = True) -> str:
    """The scene as text; not `loaded`, without forces, and with moved points at rest on bodies without joints."""
    free = ~body.held | body.moved if loaded else ~body.held
    tissue, masses = body.tissue, (body.mass / FORCE_UNIT).tolist()
    bodies = [
        _body(k, point, mass, free[k])
        for k, (point, mass) in enumerate(zip(body.mesh.points.tolist(), masses, strict=True))
    ]
    told = "\n".join(escape(line, quote=False).replace("--", "- -") for line in (*remarks(body), *_HEAD))
    lines = [
        f"<!--\n{told}\n-->",
        '<mujoco model="vdmbench">',
        '<option timestep="1" integrator="discrete" tolerance="1e-8" iterations="10000"',
        f'gravity="{_row(body.load.gravity.tolist())}">',
        '<flag contact="disable"/></option>',
        '<statistic meansize="0.01"/>',
        "<worldbody>",
        *bodies,
        "</worldbody>",
        "<deformable>",
        f'<flex name="{FLEX}" dim="3" radius="1e-6" body="{" ".join(f"p{k}" for k in range(len(bodies)))}"',
        f'element="{_row(body.mesh.tetrahedra.ravel().tolist())}">',
        '<contact selfcollide="none"/>',
        f'<elasticity young="{tissue.youngs_modulus / FORCE_UNIT!r}" poisson="{tissue.poisson_ratio!r}"/>',
        "</flex>",
        "</deformable>",
        *(_loads(body) if loaded else ()),
        "</mujoco>",
    ]
    return "\n".join([*lines, ""])


def _body(k: int, point: list[float], mass: float, free: bool) -> str:
    if not free:
        return f'<body name="p{k}" pos="{_row(point)}"/>'
    joints = "".join(f'<joint name="p{k}{axis}" type="slide" axis="{way}"/>' for axis, way in _AXES.items())
    inertial = f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-9 1e-9 1e-9"/>'
    return f'<body name="p{k}" pos="{_row(point)}">{inertial}{joints}</body>'


def _loads(body: Handout) -> list[str]:
    """Forces, and joints that are held where moved points go."""
    forces = [
        f'<general joint="p{k}{axis}" gainprm="0" biastype="affine" biasprm="{value!r} 0 0"/>'
        for k in _points(body.force.any(axis=1) & ~body.held)
        for axis, value in zip(_AXES, (body.force[k] / FORCE_UNIT).tolist(), strict=True)
    ]
    moves = [
        f'<joint joint1="p{k}{axis}" polycoef="{value!r} 0 0 0 0"/>'
        for k in _points(body.moved)
        for axis, value in zip(_AXES, body.displacement[k].tolist(), strict=True)
    ]
    return ["<actuator>", *forces, "</actuator>", "<equality>", *moves, "</equality>"]


def _points(mask: Mask) -> list[int]:
    found: list[int] = np.flatnonzero(mask).tolist()
    return found


def _row(numbers: list[float] | list[int]) -> str:
    return " ".join(map(repr, numbers))
