"""What an earlier run left behind: what is read back, said, replaced, and not built upon."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.example_case import model_result
from tests.work.shared_work import TABLES, plan_of, run
from vdmbench import models
from vdmbench.machine import processor_name
from vdmbench.work.cache import answer_path, read_answer, write_answer

from .test_store import assert_same


def test_an_answer_is_read_back_as_it_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = model_result(np.random.default_rng(3), 7)
    path = answer_path(tmp_path, "k")
    write_answer(path, result)
    assert_same(result, read_answer(path))
    monkeypatch.setattr("vdmbench.work.cache.processor_name", lambda: "another")
    elsewhere = read_answer(path)
    assert elsewhere is not None
    assert elsewhere.parameters["measured_on"] == processor_name()


def test_a_body_at_rest_that_an_earlier_version_refused_is_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Condensed elements did, up to version 2: an answer of theirs is none of today's."""

    def refusing(scene: Any, solver: str, name: str, n_loads: int) -> Any:  # noqa: ARG001
        raise ValueError("contact has no whole facet")

    names = {"study": {"name": "test", "models": ["fem-condensed"]}, "uncertainty": None, "sweep": {}}
    changes = names | {"constraints": TABLES["constraints"][:1]}
    today = models.all_models()["fem-condensed"]
    earlier = dataclasses.replace(today, version="2", prepare=refusing)
    with monkeypatch.context() as patched:
        patched.setitem(models.all_models(), "fem-condensed", earlier)
        (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes))
    assert {status.code for status in case.models["fem-condensed"].status} == {models.REFUSED}
    (case,) = run(plan_of(tmp_path, tmp_path / "cache", **changes))
    assert {status.code for status in case.models["fem-condensed"].status} == {"converged"}
    assert not case.models["fem-condensed"].displacement.any()
