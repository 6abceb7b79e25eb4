"""The bars of two mesh levels hold what a third level finds; see `make evidence WHAT=error_bars`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from tools.error_bars import (
    CASES,
    DOCUMENT,
    FOUND,
    HEADLINE,
    TRIED,
    VECTOR,
    document,
    held,
    tried_on_a_third_level,
)
from tools.third_level import Bar
from vdmbench.measures.uncertainty import SIGNED
from vdmbench.study.config import load_study

SHARE = 0.95
SAME = 0.03  # of a bar: what is used of it, rounded to two digits, on another machine


def stored() -> list[dict[str, Any]]:
    """What `make evidence WHAT=error_bars` found."""
    found: list[dict[str, Any]] = json.loads(FOUND.read_text())
    return found


def test_what_is_used_of_a_bar_by_hand() -> None:
    assert_allclose(Bar("fem", VECTOR, value=0.3, bar=0.02, best=0.31).used, 0.5, rtol=1e-12, atol=0)
    assert Bar("fem", VECTOR, value=0.3, bar=0.0, best=0.31).used == math.inf
    assert Bar("fem", VECTOR, value=1e-15, bar=0.0, best=6e-11).used == 0.0, "rounding is no miss"
    assert_allclose(
        Bar("fem", "contact_work", value=5e-5, bar=1e-9, best=5.0002e-5).used, 2.0, rtol=1e-9, atol=0
    )
    rows = [{"used": {"a": [0.5, 1.2], "b": [1.0]}}, {"used": {"a": [0.7]}}]
    assert held(rows, ["a"]) == (2, 3)
    assert held(rows, ["a", "b", "c"]) == (3, 4)


def test_the_bars_of_the_shipped_studies_hold() -> None:
    rows = stored()
    assert {name: sum(row["study"] == name for row in rows) for name in TRIED} == {
        name: len(numbers) for name, numbers in TRIED.items()
    }
    count, of = held(rows, HEADLINE)
    assert count >= SHARE * of
    assert document(rows) == DOCUMENT.read_text(), "run `make evidence WHAT=error_bars`"
    signed, of_signed = held(rows, SIGNED)
    widest = max(share for row in rows for metric in HEADLINE for share in row["used"][metric])
    assert widest < 1.065, "the others would have to be up to 6 % wider"
    assert signed >= SHARE * of_signed


@pytest.mark.slow
@pytest.mark.parametrize("study", ["convergence"])
def test_a_measured_study_comes_out_again(study: str, tmp_path: Path) -> None:
    before = [row for row in stored() if row["study"] == study]
    loaded = load_study(CASES / f"{study}.toml")
    for old in before:
        new = tried_on_a_third_level(loaded, old["case"], tmp_path)
        assert new["used"].keys() == old["used"].keys()
        for metric in HEADLINE:
            assert_allclose(new["used"][metric], old["used"][metric], rtol=0, atol=SAME)
