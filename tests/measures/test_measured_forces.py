"""Force against depth: read from a file, simulated by hand, and told beside the models."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.work.shared_work import ONE_LOAD, cache, meshes, plan_of, run
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.measurement import FORCE, hold_against
from vdmbench.measures.pushed import Answer
from vdmbench.study.sweep import inputs_of

from .test_measured import STUDY, ball, load

__all__ = ["cache", "meshes"]

PRESSED = STUDY.replace(
    "[load]",
    """\
[regions.finger]
cap = { direction = [0, 0, 1], angle = 0.4 }
[[constraints]]
name = "finger"
kind = "contact"
region = "finger"
force = 8
[load]""",
).replace("factors = [0.5, 1.0]", "factors = [0.25, 0.5, 1.0]")
MOVED = PRESSED.replace('kind = "contact"', 'kind = "constrained"').replace(
    "force = 8", "displacement = [0, 0, -0.1]"
)
CURVE = "depth [mm], force [mN], uncertainty [mN]\n50, 3000, 100\n100, 9000, 200\n"


def sunk(depths: list[float]) -> np.ndarray:
    """(S, 162, 3) the ball's top pushed in along the normals."""
    mesh = ball()
    shape = np.where(mesh.points[:, 2:] > 0.9, -mesh.points, 0.0)
    return np.array(depths)[:, None, None] * shape


def test_forces_of_a_contact_by_hand(tmp_path: Path) -> None:
    """Forces of 2, 4 and 8 N; a linear answer goes on beyond its 40 mm, one that stiffens is read between steps."""
    study = load(tmp_path, CURVE, PRESSED)
    answers = {
        "linear": Answer(sunk([0.01, 0.02, 0.04]), linear=True),
        "steps": Answer(sunk([0.05, 0.09, 0.12])),
        "stopped": Answer(sunk([0.05, 0.09, np.nan])),
        "reaches no depth": Answer(sunk([0.01, 0.02, 0.04])),
    }
    found = hold_against(study, ball(), answers)
    assert [(q.point, q.component, q.depth, q.unit) for q in found.quantities] == [
        ("finger", FORCE, 0.05, "N"),
        ("finger", FORCE, 0.1, "N"),
    ]
    assert_allclose(found.error("linear"), [10.0 - 3.0, 20.0 - 9.0], rtol=1e-9)
    at_step, between = found.simulated["steps"]
    assert_allclose(at_step, 2.0, rtol=1e-9)
    assert 4.0 < between < 4.0 + 4.0 / 3.0 + 0.1
    assert_allclose(found.simulated["stopped"], [2.0, np.nan], rtol=1e-9)
    assert np.isnan(found.simulated["reaches no depth"]).all()
    assert found.within("linear").tolist() == [False, False]


def test_forces_of_a_movement_are_reactions(tmp_path: Path) -> None:
    study = load(tmp_path, CURVE, MOVED)
    mesh = ball()
    reaction = np.zeros((3, 162, 3))
    top = int(mesh.points[:, 2].argmax())
    reaction[:, top, 2] = [-1.5, -3.0, -8.8]
    reaction[:, int(mesh.points[:, 2].argmin()), 2] = 5.0  # of the support, which is no part of it
    found = hold_against(study, mesh, {"m": Answer(sunk([0.025, 0.05, 0.1]), reaction)})
    assert_allclose(found.simulated["m"], [3.0, 8.8], rtol=1e-9)
    assert found.within("m").tolist() == [True, True]


def test_forces_of_an_indenter_are_its_own(tmp_path: Path) -> None:
    """Its way is the depth: 25, 50 and 100 mm at 1, 3 and 9 N; a model that it does not touch has no answer."""
    pushed = PRESSED.replace("bem", "fem-p1").replace('kind = "contact"', 'kind = "indenter"')
    pushed = pushed.replace("force = 8", 'depth = 0.1\nshape = "sphere"\nradius = 0.5')
    study = load(tmp_path, CURVE, pushed)
    still = np.zeros((3, 162, 3))
    answers = {"m": Answer(still, indenter_force=np.array([1.0, 3.0, 9.0])), "none": Answer(still)}
    found = hold_against(study, ball(), answers)
    assert_allclose(found.error("m"), [0.0, 0.0], atol=1e-12)
    assert np.isnan(found.simulated["none"]).all()


@pytest.mark.parametrize(
    ("key", "change", "u_input"),
    [("tissue.youngs_modulus", 250.0, 0.05), ("constraints.finger.force", 0.4, 0.0)],
)
def test_u_input_of_a_stiffness(tmp_path: Path, key: str, change: float, u_input: float) -> None:
    """The force at a depth goes with the modulus; a larger force sinks in by more, at the same stiffness."""
    study = load(tmp_path, CURVE, PRESSED + f'[inputs]\n"{key}" = {{ sd = {change} }}\n')
    (known,), depths = inputs_of(study), np.array([0.01, 0.02, 0.04])
    modulus = key.startswith("tissue")
    answers = [
        Answer(sunk((depths * factor).tolist()), linear=True, values={key: value})
        for value, factor in zip(known.ends, (1 / 0.95, 1 / 1.05) if modulus else (0.95, 1.05), strict=True)
    ]
    own = {"m": Answer(sunk(depths.tolist()), linear=True)}
    found = hold_against(study, ball(), own, varied={"m": lambda: answers})
    assert_allclose(found.inputs["m"], u_input * found.simulated["m"], rtol=1e-9, atol=1e-12)
    assert_allclose(found.uncertainty("m"), np.hypot([0.1, 0.2], found.inputs["m"]), rtol=1e-9)


def test_a_run_holds_its_models_against_a_curve(tmp_path: Path, cache: Path) -> None:
    """A linear model's force goes with the depth; 10 % in the modulus are 10 % in the force."""
    changes: dict[str, Any] = {
        "measured": [
            {"name": "press", "forces": [{"depth": 0.004, "force": 0.3}], "force_uncertainty": 0.01}
        ],
        "inputs": {"tissue.youngs_modulus": {"sd": 500.0}},
    }
    (case,) = run(plan_of(tmp_path / "run", cache, tables=ONE_LOAD, **changes))
    found = case.measurement
    for name in ("vdm-vector", "fem-linear"):
        u = case.models[name].displacement[0]
        finger = np.flatnonzero(case.regions["finger"])
        depth = -np.einsum("ij,ij->i", u, Surface(case.points, case.triangles).normals)[finger].min()
        assert_allclose(found.simulated[name], 0.1 * 0.004 / depth, rtol=1e-9)
        assert_allclose(found.inputs[name], 0.1 * found.simulated[name], rtol=1e-9)
