"""Which step a multiple is taken from, what of it stays, and which earlier case the metrics follow from."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies.case import StepStatus
from studies.meshing.mesh import Mesh
from studies.metrics import METRICS, History, evaluate_all
from studies.proportional import Answer, Comparisons

from .example_case import model_result, tetrahedron
from .test_metrics import ROUND, bumpy
from .test_proportional import measured

POINTS, TRIANGLES = tetrahedron()
LOADS = {"finger": 1.0, "tool": 2.0}
THRICE = {"finger": 3.0, "tool": 6.0}


def scene(*factors: float) -> Any:
    return SimpleNamespace(
        load_factors=np.array(factors), mesh=SimpleNamespace(surface_points=POINTS, triangles=TRIANGLES)
    )


@pytest.mark.parametrize("factors", [(0.0, -2.0, 1.0), (-2.0, 0.0, 1.0), (0.5, 1.0, -2.0)])
def test_a_multiple_is_taken_from_the_largest_step(factors: tuple[float, ...]) -> None:
    largest = factors.index(-2.0)
    marks = tuple(StepStatus("converged", f"step {k}") for k in range(3))
    level = dataclasses.replace(
        model_result(np.random.default_rng(2), 4), status=marks, seconds_per_step=np.array([0.1, 0.4, 0.2])
    )
    (found,) = Answer([level], LOADS, np.array(factors)).under(THRICE, scene(0.5, -4.0)) or [None]
    assert found is not None
    for field, power in {"displacement": 1, "reaction_force": 1, "fluid_pressure": 1, "energy": 2}.items():
        # 3 times 0.5 and -4, over -2
        values = [share**power * getattr(level, field)[largest] for share in (-0.75, 6.0)]
        assert_allclose(getattr(found, field), values, **ROUND, err_msg=field)
    # a tetrahedron's volume: a sixth of a determinant
    edges = [POINTS[1:] + u[1:] - POINTS[0] - u[0] for u in found.displacement]
    assert_allclose(found.volume, [np.linalg.det(edge) / 6 for edge in edges], **ROUND)
    assert found.scalars["compliance"].tolist() == [level.scalars["compliance"][largest]] * 2
    assert found.status == (marks[largest],) * 2
    assert found.seconds_per_step.tolist() == [0.2, 0.2], "the median"
    assert found.parameters == {**level.parameters, "setup_shared": "yes", "steps_scaled": "yes"}


def test_no_multiple_is_taken_from_steps_without_load() -> None:
    level = model_result(np.random.default_rng(2), 4)
    assert Answer([level], LOADS, np.zeros(3)).under(THRICE, scene(1.0)) is None


def times(share: float, history: History, reaction: float | None = None) -> History:
    return dataclasses.replace(
        history,
        displacement=share * history.displacement,
        reaction_force=(reaction or share) * history.reaction_force,
    )


def comparisons_of(seed: int) -> tuple[Comparisons, Any, dict[str, History]]:
    """Nothing measured yet, a surface under contact, and three models of which none failed."""
    surface, (a, b, r) = bumpy(seed)
    b = dataclasses.replace(b, displacement=np.nan_to_num(b.displacement))
    mesh = cast(Mesh, SimpleNamespace(surface_points=surface.points, triangles=surface.triangles))
    return Comparisons(mesh), surface, {"a": a, "b": b, "r": r}


@pytest.mark.parametrize("change", ["names swapped", "another reaction"])
def test_metrics_do_not_follow_from_other_models_or_reactions(change: str) -> None:
    comparisons, surface, models = comparisons_of(5)
    comparisons.compare(surface, models, "r")
    twice = surface.under(surface.contact, 2 * surface.contact_force)
    a, b, r = (times(2.0, model) for model in models.values())
    others = {"b": a, "a": b, "r": r}
    if change == "another reaction":
        others = {"a": times(2.0, models["a"], reaction=3.0), "b": b, "r": r}
    found, plain = comparisons.compare(twice, others, "r"), evaluate_all(twice, others, "r")
    for model, metrics in plain.items():
        for name, values in metrics.items():
            assert np.array_equal(found[model][name], values, equal_nan=True), (model, name)


def test_metrics_follow_from_the_latest_case_that_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    comparisons, surface, models = comparisons_of(5)
    comparisons.compare(surface, models, "r")
    second = models | {"a": times(1.5, models["a"])}
    comparisons.compare(surface, second, "r")
    seen = measured(monkeypatch)
    twice = surface.under(surface.contact, 2 * surface.contact_force)
    comparisons.compare(twice, {name: times(2.0, model) for name, model in second.items()}, "r")
    assert set(seen) == {name for name, metric in METRICS.items() if metric.degree is None}
