"""Studies of a ball under a finger, their plans, and what a worker does with these: for the tests of least work."""

import copy
import dataclasses
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import fem_reference.linear
import vdm.model
from tests.in_process import do_cases
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.measures.case import CaseResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.store.cases import read_case
from vdmbench.study.schema import Study
from vdmbench.work.plan import Plan, PlannedCase, make_plan
from vdmbench.work.tasks import tasks_of

BASE = {"kind": "fixed", "region": "base"}
FINGER = {"name": "finger", "kind": "contact", "region": "finger", "force": 0.1, "profile": "hertz"}
ONE_LOAD: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.03},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.25}},
        "finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.6}},
    },
    "constraints": [BASE, FINGER],
}
TABLES: dict[str, Any] = ONE_LOAD | {
    "load": {"factors": [0.5, 1.0]},
    "sweep": {"constraints.finger.force": [0.1, 0.3], "regions.finger.cap.direction.0": [0.0, 0.4]},
    "uncertainty": {"levels": 2},
}
ALONE: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-vector", "fem-linear"]},
    "uncertainty": None,
}
MOVED: dict[str, Any] = {
    "regions": TABLES["regions"] | {"side": {"cap": {"direction": [1.0, 0.0, 0.1], "angle": 0.4}}},
    "constraints": [
        *TABLES["constraints"],
        {"name": "tool", "kind": "constrained", "region": "side", "displacement": [-0.001, 0.0, 0.0]},
    ],
    # twice both is a multiple, twice one is none
    "sweep": {"constraints.tool.displacement.0": [-0.001, -0.002], "constraints.finger.force": [0.1, 0.2]},
}


@pytest.fixture(scope="session")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds the mesh of these studies once it is made."""
    made = tmp_path_factory.mktemp("meshes")
    study = Study.model_validate(copy.deepcopy(TABLES))
    mesh_from_cache(study.geometry, made)
    return made


@pytest.fixture
def cache(meshes: Path, tmp_path: Path) -> Path:
    """A cache with the mesh, and no answer."""
    return Path(shutil.copytree(meshes, tmp_path / "shared-cache"))


def plan_of(
    directory: Path,
    cache: Path,
    *,
    tables: Mapping[str, Any] = TABLES,
    fresh: bool = False,
    **changes: Any,
) -> Plan:
    """The plan of the study of these tables with some of them changed."""
    study = Study.model_validate(copy.deepcopy(tables) | changes)
    return make_plan(study, directory, cache, fresh=fresh)


def run(plan: Plan) -> list[CaseResult]:
    """The cases of a plan, all of whose tasks are done here."""
    do_cases(plan)
    return [read_case(plan.case_file(case)) for case in plan.cases]


def run_alone(planned: PlannedCase, plan: Plan, directory: Path) -> CaseResult:
    """One case, with nothing that another has made but the mesh."""
    alone = dataclasses.replace(plan, cases=(planned,), directory=directory, fresh=True)
    return run(alone)[0]


def scene_of(plan: Plan, case: PlannedCase) -> Scene:
    """A case's scene on its mesh."""
    mesh = mesh_from_cache(case.study.geometry, plan.cache, volume=plan.meshes[case.mesh].volume)
    return build_scene(case.study, mesh)


def planned_work(plan: Plan, *names: str) -> dict[str, int]:
    """Set-ups and solves of some models that a plan counts."""
    asked = [task.payload for task in tasks_of(plan, plan.cases_to_run()) if task.kind == "answers"]
    found = [one["asked"] for one in asked if not names or one["name"] in names]
    solves = sum(len(answer["factors"]) for one in found for answer in one)
    return {"set-ups": len(found), "solves": solves}


def assert_same_results(case: CaseResult, alone: CaseResult, direct: float, iterative: float) -> None:
    """The results of all models, up to so much of the largest value of each kind, by what solves the elements."""
    for name, result in alone.models.items():
        tolerance = iterative if result.parameters.get("solver") == "iterative" else direct
        for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
            a, b = getattr(case.models[name], field), getattr(result, field)
            label = f"{case.label} {name} {field}"
            assert_allclose(a, b, rtol=0, atol=tolerance * np.abs(b).max(), err_msg=label)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Counts set-ups and right-hand sides."""
    counts: Counter[str] = Counter()

    def counting(name: str, function: Callable[..., Any], size: Callable[..., int]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            counts[name] += size(*arguments)
            return function(*arguments, **options)

        return call

    linear = fem_reference.linear.LinearProblem
    for cls, name in ((linear, "fem set-ups"), (vdm.model.Model, "vdm set-ups")):
        monkeypatch.setattr(cls, "__init__", counting(name, cls.__init__, lambda *_: 1))
    monkeypatch.setattr(
        linear, "solve_nodal", counting("fem solves", linear.solve_nodal, lambda _, forces, __: len(forces))
    )
    surface = vdm.model.Model
    monkeypatch.setattr(surface, "solve", counting("vdm solves", surface.solve, lambda _, loads: len(loads)))
    return counts
