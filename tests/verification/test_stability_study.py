"""The shipped studies of numerical stability, made small: a breakdown is a status, never a wrong number."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.linear import LinearProblem
from fem_reference.loads import Load as FemLoad
from tests.comparing import compare
from tests.report.runs import make_run
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.measures.case import CaseResult
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import ResolvedCase, expand, load_study
from vdmbench.study.shapes import geometry_key
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.ladders import Ladder, Reading, ladders
from vdmbench.work.keys import Wanted, wanted

SHIPPED = Path(__file__).parents[2] / "studies" / "cases"
LOCKING = ("fem-p1", "fem-p2")
VOLUMETRIC = ("stability-history", "stability-size-volume", "stability-volume")
# study -> (texts that make it small, every how many-th value of a ladder is solved)
SMALL: dict[str, tuple[tuple[tuple[str, str], ...], int]] = {
    "stability-history": (
        (('mesh_size = "16 mm"', 'mesh_size = "20 mm"'), ("= [1, 10, 100] #", "= [1, 4] #")),
        1,
    ),
    "stability-size": (
        (('"2.5 mm", "1.25 mm", "0.65 mm", "0.385 mm"', '"2.5 mm"'), ('    "bem",\n', "")),
        1,
    ),
    "stability-size-volume": ((('"10 mm", "7 mm", "5 mm"]', '"12 mm"]'),), 1),
    "stability-surface": ((('mesh_size = "12 mm"', 'mesh_size = "16 mm"'),), 2),
    "stability-volume": ((('mesh_size = "12 mm"', 'mesh_size = "20 mm"'),), 3),
}


@dataclass(frozen=True)
class Known:
    """Meshes by their keys, and results by what a case wants of a model."""

    meshes: dict[str, Mesh] = field(default_factory=dict)
    answers: dict[Wanted, ModelResult] = field(default_factory=dict)


def small_study(name: str, directory: Path) -> list[ResolvedCase]:
    """The cases of a shipped study made small."""
    path = directory / f"{name}.toml"
    text = (SHIPPED / path.name).read_text()
    for old, new in SMALL[name][0]:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path.write_text(text)
    return expand(load_study(path))


def small(name: str, directory: Path) -> dict[str, Ladder]:
    """The ladders of a shipped study made small."""
    known = Known()
    volume = name in VOLUMETRIC
    cases = [solved(case, volume, known) for case in some(small_study(name, directory), SMALL[name][1])]
    return {ladder.key: ladder for ladder in ladders(Digest(make_run(cases)))}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Ladder]:
    return small("stability-surface", tmp_path_factory.mktemp("study"))


def some(cases: list[ResolvedCase], every: int) -> Iterator[ResolvedCase]:
    """The base, and of each ladder the last and one value in so many."""
    base = cases[0].swept
    by_key: dict[str, list[ResolvedCase]] = {}
    for case in cases[1:]:
        [key] = [key for key, value in case.swept.items() if base.get(key) != value]
        by_key.setdefault(key, []).append(case)
    yield cases[0]
    for ladder in by_key.values():
        yield from ladder[:-1:every]
        yield ladder[-1]


def solved(case: ResolvedCase, volume: bool, known: Known) -> CaseResult:
    """A case, of which what another case has asked by the same keys is not solved again."""
    geometry = case.study.geometry
    mesh_key = geometry_key(geometry, volume=volume)
    if mesh_key not in known.meshes:
        known.meshes[mesh_key] = build_mesh(geometry, volume=volume)
    mesh = known.meshes[mesh_key]
    scene = build_scene(case.study, mesh)
    results = {}
    for want in wanted(case.study, mesh_key):
        if want not in known.answers:
            known.answers[want] = models.run_model(scene, want.name)
        results[want.name] = known.answers[want]
    return CaseResult(
        hash=case.label,
        label=case.label,
        swept=case.swept,
        swept_units=case.swept_units,
        study=case.study,
        provenance={},
        points=mesh.surface_points,
        triangles=mesh.triangles,
        load_factors=np.array(case.study.load.history),
        regions=scene.regions,
        models=results,
        metrics=compare(scene, results, None),
        reference=None,
    )


def check(study: dict[str, Ladder]) -> list[Reading]:
    """No step is silently wrong, every breakdown says what to change; returns the breakdowns."""
    readings = [
        (ladder.key, value, model, reading)
        for ladder in study.values()
        for model, on_it in ladder.readings.items()
        for value, reading in zip(ladder.values, on_it, strict=True)
        if reading is not None
    ]
    assert readings
    assert not [(*where, reading.message) for *where, reading in readings if reading.silent]
    broken = [reading for *_, reading in readings if not reading.ok]
    assert all(reading.message and reading.remedy for reading in broken)
    return broken


@pytest.mark.parametrize("name", SMALL)
def test_what_makes_a_study_small_is_still_in_it(name: str, tmp_path: Path) -> None:
    cases = small_study(name, tmp_path)
    assert 1 < len(list(some(cases, SMALL[name][1]))) <= len(cases)
    assert len(cases) <= len(expand(load_study(SHIPPED / f"{name}.toml")))


@pytest.mark.slow
def test_no_step_that_is_called_converged_is_wrong(found: dict[str, Ladder]) -> None:
    assert check(found), "the ladders go far enough to break something"


@pytest.mark.slow
def test_elements_break_down_by_a_status(tmp_path: Path) -> None:
    study = small("stability-volume", tmp_path)
    assert check(study)
    ratio = study["tissue.poisson_ratio"]
    assert ratio.values[-1] == 0.5
    for model in ("fem-linear", "fem-condensed", "fem"):
        assert not ratio.breakdowns(model), "the mixed elements stand 1/2"
    for model in ("fem-p1", "fem-p2"):
        last = ratio.readings[model][-1]
        assert last is not None
        assert last.code == models.REFUSED
    conditions = {
        model: [r.condition for r in ratio.readings[model] if r is not None and r.ok]
        for model in ("fem-linear", "fem-p1")
    }
    # a displacement element's grows as 1 / (1 - 2 nu), the mixed one's does not
    assert max(conditions["fem-p1"]) > 1e5 * min(conditions["fem-p1"])
    assert max(conditions["fem-linear"]) < 3.0 * min(conditions["fem-linear"])
    for model in ("fem-linear", "fem"):
        sound = study["geometry.slivers"].sound_range(model)
        assert sound is not None
        assert study["geometry.slivers"].values[sound[1]] >= 1e4
    last = study["constraints.finger.pressure"].readings["fem"][-1]
    assert last is not None
    assert not last.ok


@pytest.mark.slow
def test_nothing_drifts_in_a_long_history(tmp_path: Path) -> None:
    [ladder] = small("stability-history", tmp_path).values()
    check({ladder.key: ladder})
    for model, readings in ladder.readings.items():
        assert len(readings) == 2
        for read in readings:
            assert read is not None
            lags = model.endswith("quasi-linear")
            assert read.ok or (lags and read.code == "step-too-long")
            assert read.left < (1e-2 if lags else 1e-9), model
            if model.endswith(":nonlinear"):
                assert read.drift < 1e-12, model
    one, four = (read.left for read in ladder.readings["vdm-paper:quasi-linear"] if read is not None)
    assert_allclose(one / four, 16.0, rtol=0.3, atol=0, err_msg="second order in the step")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stability-size", "stability-size-volume"])
def test_the_size_of_the_mesh_breaks_no_solver(name: str, tmp_path: Path) -> None:
    [ladder] = small(name, tmp_path).values()
    assert not check({ladder.key: ladder})
    assert ladder.values[0] < 0.25 * ladder.values[-1]
    for model, readings in ladder.readings.items():
        finest, coarsest = readings[0], readings[-1]
        assert finest is not None
        assert coarsest is not None
        # a membrane's and a solid's condition grow with the square of the size over the edge
        growth = finest.condition / coarsest.condition
        squared = (ladder.values[-1] / ladder.values[0]) ** 2
        assert growth < 3.0 * squared, (model, growth)
        # where the bulk modulus is ten thousand times the shear modulus, it hides that of elements that lock
        assert model in LOCKING or 0.15 * squared < growth, (model, growth)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_support_of_one_node_is_refused_by_the_forms_that_could_turn(found: dict[str, Ladder]) -> None:
    ladder = found["regions.base.cap.angle"]
    for model in ("vdm-vector", "vdm-vector:cg", "vdm-vector:nonlinear"):
        first = ladder.readings[model][0]
        assert first is not None
        assert first.code == models.REFUSED
    for model in ("vdm-paper", "vdm-consistent"):  # which have a foundation that holds them
        assert not ladder.breakdowns(model)


@pytest.mark.slow
def test_conditions_are_told(found: dict[str, Ladder]) -> None:
    readings = found["models.vdm-paper:lu.penalty"].readings["vdm-paper:lu"]
    conditions = [reading.condition for reading in readings if reading is not None and reading.ok]
    assert len(conditions) >= 2
    assert np.isfinite(conditions).all()
    assert max(conditions) > 1e5 * min(conditions), "and they grow with the penalty"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hard", "both"),
    [
        ("tissue.poisson_ratio", 10),
        ("geometry.slivers", 4),
        ("anisotropy.contrast", 3),
        ("geometry.perturbation", 5),
    ],
)
def test_direct_and_iterative_elements_agree_where_both_converge(
    hard: str, both: int, tmp_path: Path
) -> None:
    """The solvers have nothing but the equations in common: at the base, and wherever on a ladder both converge."""
    cases = small_study("stability-volume", tmp_path)
    base, on_it = cases[0], [case for case in cases if case.swept.get(hard) != cases[0].swept.get(hard)]
    agreed = []
    for case in (base, *on_it):
        scene = build_scene(case.study, build_mesh(case.study.geometry, volume=True))
        tissue, fibres = scene.tissue, scene.anisotropy
        assert fibres is not None
        direct, iterative = (
            LinearProblem(
                scene.mesh.points,
                scene.mesh.tetrahedra,
                scene.mesh.surface_nodes,
                scene.mesh.triangles,
                youngs_modulus=tissue.youngs_modulus,
                poisson_ratio=tissue.poisson_ratio,
                held=scene.held,
                fibre_direction=fibres.fibre_direction,
                contrast=fibres.contrast,
                solver=solver,
            ).solve([FemLoad(scene.facet_pressure, scene.prescribed, scene.gravity)])
            for solver in ("direct", "iterative")
        )
        for solution in (direct, iterative):
            assert solution.status[0].ok or solution.status[0].remedy
        agreed.append(direct.status[0].ok and iterative.status[0].ok)
        if agreed[-1]:
            size = np.abs(direct.displacement).max()
            assert_allclose(iterative.displacement, direct.displacement, rtol=0, atol=1e-6 * size)
    assert agreed[0], "at the base both converge"
    assert sum(agreed[1:]) >= both, "and on the ladder"
