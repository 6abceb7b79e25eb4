"""The shipped study of numerical stability, on a coarse mesh: a breakdown is a status, never a wrong number."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from studies import models
from studies.case import CaseResult
from studies.meshing.geometry import build_mesh
from studies.report.digest import Digest
from studies.report.ladders import Ladder, ladders
from studies.scene import build_scene
from studies.study_file.config import ResolvedCase, expand, geometry_of, load_study
from studies.worker import compare
from tests.unit.report_runs import make_run

SHIPPED = Path(__file__).parents[2] / "studies" / "cases" / "stability-surface.toml"
COARSE = '"16 mm"'


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ladder]:
    path = tmp_path_factory.mktemp("study") / "stability-surface.toml"
    text = SHIPPED.read_text()
    assert text.count('mesh_size = "8 mm"') == 1
    path.write_text(text.replace('mesh_size = "8 mm"', f"mesh_size = {COARSE}"))
    cases = [solved(case) for case in some(expand(load_study(path)))]
    return {ladder.key: ladder for ladder in ladders(Digest(make_run(cases)))}


def some(cases: list[ResolvedCase]) -> Iterator[ResolvedCase]:
    """The base, and of each ladder the ends and every third value; of the mesh sizes none."""
    base = cases[0].swept
    by_key: dict[str, list[ResolvedCase]] = {}
    for case in cases[1:]:
        [key] = [key for key, value in case.swept.items() if base.get(key) != value]
        by_key.setdefault(key, []).append(case)
    del by_key["geometry.mesh_size"]
    yield cases[0]
    for ladder in by_key.values():
        yield from ladder[:-1:3]
        yield ladder[-1]


def solved(case: ResolvedCase) -> CaseResult:
    mesh = build_mesh(geometry_of(case.study), volume=False)
    scene = build_scene(case.study, mesh)
    results = {name: models.run_model(scene, name) for name in case.study.study.models}
    return CaseResult(
        hash=case.label,
        label=case.label,
        swept=case.swept,
        swept_units=case.swept_units,
        resolved={},
        provenance={},
        points=mesh.surface_points,
        triangles=mesh.triangles,
        load_factors=np.array(case.study.load.history),
        regions=scene.regions,
        models=results,
        metrics=compare(scene, results, None),
        reference=None,
    )


def test_no_step_that_is_called_converged_is_wrong(found: dict[str, Ladder]) -> None:
    wrong = [
        (ladder.key, value, model, reading.message)
        for ladder in found.values()
        for model, readings in ladder.readings.items()
        for value, reading in zip(ladder.values, readings, strict=True)
        if reading is not None and reading.silent
    ]
    assert not wrong


def test_every_breakdown_says_what_to_change(found: dict[str, Ladder]) -> None:
    broken = [
        reading
        for ladder in found.values()
        for readings in ladder.readings.values()
        for reading in readings
        if reading is not None and not reading.ok
    ]
    assert broken, "the ladders go far enough"
    assert all(reading.message and reading.remedy for reading in broken)


def test_the_direct_solver_stands_every_modulus_penalty_and_sliver(found: dict[str, Ladder]) -> None:
    assert set(found) >= {"geometry.slivers", "vdm.bulk_modulus", "models.vdm-paper:lu.penalty"}
    for key in ("geometry.slivers", "geometry.perturbation", "vdm.bulk_modulus", "vdm.foundation"):
        for model in ("vdm-paper", "vdm-consistent", "vdm-vector"):
            assert not found[key].breakdowns(model), (key, model)
    for model in ("vdm-paper:lu", "vdm-vector:lu"):
        ladder = found[f"models.{model}.penalty"]
        assert ladder.values[0] == 1e2
        assert ladder.values[-1] == 1e16
        statuses = [reading.code for reading in ladder.readings[model] if reading is not None]
        assert set(statuses[1:]) == {"converged"}, statuses
        assert statuses[0] in ("converged", "inaccurate"), "a soft penalty may let held nodes go, and says so"


def test_a_support_of_one_node_is_refused_by_the_forms_that_could_turn(found: dict[str, Ladder]) -> None:
    ladder = found["regions.base.cap.angle"]
    for model in ("vdm-vector", "vdm-vector:cg", "vdm-vector:nonlinear"):
        first = ladder.readings[model][0]
        assert first is not None
        assert first.code == models.REFUSED
    for model in ("vdm-paper", "vdm-consistent"):  # which have a foundation that holds them
        assert not ladder.breakdowns(model)


def test_conditions_are_told(found: dict[str, Ladder]) -> None:
    readings = found["models.vdm-paper:lu.penalty"].readings["vdm-paper:lu"]
    conditions = [reading.condition for reading in readings if reading is not None and reading.ok]
    assert len(conditions) > 2
    assert np.isfinite(conditions).all()
    assert max(conditions) > 1e6 * min(conditions), "and they grow with the penalty"
