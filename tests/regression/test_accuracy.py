"""Accuracy of the shipped fast studies, held against what was accepted: a change that costs accuracy fails here.

Where a change is meant to move the numbers: `make baselines REASON="why"`, and look at the difference.
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.command import vdmbench
from tests.in_process import do_cases
from vdm.material import Parameters
from vdmbench import gate
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.measures.case import Run
from vdmbench.models import run_model
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_case, read_run
from vdmbench.study.config import load_study
from vdmbench.work import case
from vdmbench.work.plan import make_plan

ROOT = Path(__file__).parents[2]


def test_accuracy_of_the_quickstart_is_what_was_accepted(quickstart: Path) -> None:
    assert_accepted("quickstart", quickstart / "results" / "runs" / "quickstart")


@pytest.fixture(scope="module")
def regression(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of all models."""
    directory = tmp_path_factory.mktemp("regression")
    run = vdmbench("run", "regression", "--out", "run", cwd=directory)
    assert run.returncode == 0, run.stderr
    return directory / "run"


def test_accuracy_of_all_models_is_what_was_accepted(regression: Path) -> None:
    assert_accepted("regression", regression)


def assert_accepted(study: str, run: Path) -> None:
    baseline = ROOT / "results" / "baselines" / f"{study}.json"
    result = vdmbench("gate", run, "--baseline", baseline, cwd=run)
    assert result.returncode == 0, result.stdout + result.stderr
    findings = gate.compare(read_run(run), gate.read_baseline(baseline))
    blind = [f for f in findings if f.outcome in (gate.NOT_COMPARABLE, gate.MISSING, gate.NEW)]
    assert not blind, "\n".join(
        [*map(gate.describe, blind), 'accept what is meant: make baselines REASON="..."']
    )


def test_a_model_made_worse_by_a_tenth_turns_the_gate_red(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_rule = Parameters.from_tissue

    def worse(*arguments: object, **options: object) -> Parameters:
        found = by_rule(*arguments, **options)  # type: ignore[arg-type]
        tension = found.surface_tension
        return found if tension is None else dataclasses.replace(found, surface_tension=1.1 * tension)

    monkeypatch.setattr(Parameters, "from_tissue", worse)
    study = load_study(ROOT / "studies" / "cases" / "regression.toml")
    few = study.study.model_copy(update={"models": ("vdm-vector", "bem", "fem")})
    study = study.model_copy(update={"study": few})
    plan = make_plan(study, tmp_path / "run", tmp_path / "cache")
    do_cases(plan)
    run = Run(study, "", [read_case(plan.case_file(plan.cases[0]))], [], [], {})
    findings = gate.compare(run, gate.read_baseline(ROOT / "results" / "baselines" / "regression.json"))
    assert gate.regressed(findings)
    hit = {f.model for f in findings if f.outcome in gate.REGRESSED}
    assert "vdm-vector" in hit
    assert not {model for model in hit if model.startswith(("fem", "bem"))}


def test_rounding_is_far_within_the_tolerance(regression: Path) -> None:
    """Nodes, facets and tetrahedra in another order: the same sums, rounded otherwise, as on another machine."""
    study = load_study(ROOT / "studies" / "cases" / "regression.toml")
    names = study.study.models
    scene = build_scene(study, _shuffled(build_mesh(study.geometry)))
    answers = {name: run_model(scene, name) for name in names}
    other = case.compare(scene.surface, answers, scene.load_factors, study.study.reference)
    (first,) = (done.metrics for done in read_run(regression).cases)
    for name in names:
        for metric, series in first[name].items():
            was, now = abs(series[-1]), abs(other[name][metric][-1])
            floor = gate.CONSERVED if gate.sense_of(metric) == "conserved" else 1e-6
            assert abs(now - was) <= 1e-3 * max(gate.RELATIVE * was, floor), f"{name}: {metric}"


def _shuffled(mesh: Mesh) -> Mesh:
    rng = np.random.default_rng(3)
    order = rng.permutation(len(mesh.points))
    place = np.argsort(order)
    surface = np.sort(place[mesh.surface_nodes])
    facets = np.searchsorted(surface, place[mesh.surface_nodes])[mesh.triangles]
    return dataclasses.replace(
        mesh,
        points=mesh.points[order],
        tetrahedra=place[mesh.tetrahedra][rng.permutation(len(mesh.tetrahedra))],
        surface_nodes=surface,
        triangles=facets[rng.permutation(len(facets))],
    )
