"""What an earlier run or case left behind: what is read back, said, replaced, and not built upon."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from studies import worker
from studies.case import StepStatus
from studies.proportional import Answer
from studies.result_cache import read_reference, reference_path, write_reference

from .example_case import model_result
from .shared_work import ALONE, TABLES, plan_of, run
from .test_store import assert_same


def test_a_reference_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    levels = [dataclasses.replace(model_result(rng, n), key=f"key {n}") for n in (4, 7)]
    answer = Answer(levels, {"finger": 0.1, "tool": -2.0}, np.array([0.25, -1.0, 0.5]))
    write_reference(reference_path(tmp_path, "k"), answer)
    assert_same(answer, read_reference(reference_path(tmp_path, "k")))


def test_a_result_of_an_earlier_run_says_so(tmp_path: Path) -> None:
    """Of a model read from a case file; what is solved now does not."""
    changes: dict[str, Any] = ALONE | {"sweep": {}}
    run(plan_of(tmp_path, tmp_path / "cache", **changes))
    study = ALONE["study"] | {"models": ["vdm-vector", "vdm-paper", "fem-linear"]}
    (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes | {"study": study}))
    marked = {name for name, result in case.models.items() if "measured_earlier" in result.parameters}
    assert marked == {"vdm-vector", "fem-linear"}


def test_a_stored_reference_that_does_not_serve_is_replaced(tmp_path: Path) -> None:
    """Of one key, and of loads that differ beyond what may be scaled."""
    stored = []
    for force in (1e-155, 0.1):
        plan = plan_of(
            tmp_path, tmp_path / "cache", sweep={"constraints.finger.force": [force]}, uncertainty=None
        )
        run(plan)
        answer = read_reference(reference_path(tmp_path / "cache", plan.cases[0].reference))
        assert answer is not None
        assert answer.loads == worker.loads_of(plan.cases[0].study)
        stored.append(plan.cases[0].reference)
    assert len(set(stored)) == 1


def test_what_failed_is_no_answer_to_the_next_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solve, asked = worker.models.run_model, []

    def failing_once(scene: Any, name: str) -> Any:
        result = solve(scene, name)
        if name != "fem-linear":
            return result
        asked.append(name)
        if len(asked) > 1:
            return result
        stopped = (StepStatus("diverged", "it did not converge", ""),) * len(result.status)
        return dataclasses.replace(result, status=stopped, displacement=7.0 * result.displacement)

    monkeypatch.setattr(worker.models, "run_model", failing_once)
    first, second = run(
        plan_of(tmp_path, tmp_path / "cache", **ALONE | {"sweep": {"constraints.finger.force": [0.1, 0.3]}})
    )
    assert len(asked) == 2
    failed, solved = (case.models["fem-linear"] for case in (first, second))
    assert {status.code for status in failed.status} == {"diverged"}
    assert {status.code for status in solved.status} == {"converged"}
    assert_allclose(solved.displacement, 3.0 / 7.0 * failed.displacement, rtol=1e-9, atol=1e-15)


def test_a_body_at_rest_that_an_earlier_version_refused_is_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Condensed elements did, up to version 2: a case file of theirs is no result of today's."""

    def refusing(scene: Any, solver: str, name: str) -> Any:  # noqa: ARG001
        raise ValueError("contact has no whole facet")

    names = {"study": {"name": "test", "models": ["fem-condensed"]}, "uncertainty": None, "sweep": {}}
    changes = names | {"constraints": TABLES["constraints"][:1]}
    today = worker.models.MODELS["fem-condensed"]
    earlier = dataclasses.replace(today, version="2", solve=refusing)
    with monkeypatch.context() as patched:
        patched.setitem(worker.models.MODELS, "fem-condensed", earlier)
        (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes))
    assert {status.code for status in case.models["fem-condensed"].status} == {worker.models.REFUSED}
    (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes))
    assert {status.code for status in case.models["fem-condensed"].status} == {"converged"}
    assert not case.models["fem-condensed"].displacement.any()
