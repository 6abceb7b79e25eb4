"""MuJoCo's flex, run by `engine.py`: a scene in MJCF, stepped until nothing moves.

In: `scene` (MJCF without loads, a body a point), `force` (S, n, 3) beside the weight, in its units,
`displacement` (S, n, 3) of points without joints [m]. Each load step starts from the last. Out: `displacement`
(S, n, 3) [m], `iterations`: steps that the engine took, 0 where it burst or did not come to rest, `seconds` (S,),
`setup`, `version`.
"""

import sys
import time
from typing import Any

import mujoco
import numpy as np

MOST_STEPS = 300
STILL = 1e-6  # change in a step over the largest displacement


def solve(given: dict[str, Any]) -> dict[str, Any]:
    """See above."""
    mujoco.set_mju_user_warning(lambda text: print(text, file=sys.stderr))  # noqa: T201  # else into a file here
    start = time.perf_counter()
    model = mujoco.MjModel.from_xml_string(str(given["scene"]))
    data = mujoco.MjData(model)
    setup = time.perf_counter() - start
    bodies = model.flex_vertbodyid
    free = model.body_dofnum[bodies] == 3
    dofs = model.body_dofadr[bodies[free]][:, None] + np.arange(3)
    rest = model.body_pos[bodies].copy()
    found, steps, seconds = [], [], []
    for force, displacement in zip(given["force"], given["displacement"], strict=True):
        start = time.perf_counter()
        model.body_pos[bodies[~free]] = rest[~free] + displacement[~free]
        data.qfrc_applied[dofs] = force[free]
        moved, taken = _come_to_rest(model, data, bodies, rest)
        seconds.append(time.perf_counter() - start)
        found.append(moved)
        steps.append(taken)
        if not taken:
            mujoco.mj_resetData(model, data)
    return {
        "displacement": np.array(found),
        "iterations": np.array(steps),
        "seconds": np.array(seconds),
        "setup": setup,
        "version": mujoco.__version__,
    }


def _come_to_rest(model: Any, data: Any, bodies: Any, rest: Any) -> tuple[Any, int]:
    """The displacements when nothing moves any more and the steps taken, 0 for none."""
    moved = np.full_like(rest, np.nan)
    for step in range(1, MOST_STEPS + 1):
        mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        last, moved = moved, data.xpos[bodies] - rest
        if data.warning[mujoco.mjtWarning.mjWARN_BADQPOS].number or not np.isfinite(moved).all():
            break  # it burst, and was set back to rest
        if np.abs(moved - last).max() <= STILL * np.abs(moved).max():
            return moved, step
    return moved, 0
