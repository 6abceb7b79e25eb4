"""The league table: its studies are sound, its shares and profiles are counted right, its page has every model."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.report.runs import make_case, make_run
from tools.league import (
    BODIES,
    DOCUMENT,
    LOADS,
    MODELS,
    PART,
    Entry,
    accuracy_profile,
    entries,
    of,
    picture,
    ranked,
    section,
    study_text,
    table,
    time_profile,
    within,
)
from tools.marked import cells, shown
from vdmbench.study.config import expand, load_study

NAN = float("nan")
OURS = [name for name in MODELS if name not in ("mujoco-flex", "ngsolve-p2p1")]
# three cases; a is exact and slow, b is quick and fails once, c is off everywhere
FOUND = [
    Entry("1", "a", 0.01, 0.01, 1.0, 9.0),
    Entry("2", "a", 0.02, 0.01, 1.0, 9.0),
    Entry("3", "a", 0.04, 0.02, 1.0, 9.0),
    Entry("1", "b", 0.06, 0.01, 0.1, 2.0),
    Entry("2", "b", 0.095, 0.01, 0.5, 2.0),
    Entry("3", "b", NAN, NAN, NAN, 2.0),
    Entry("1", "c", 0.5, 0.01, 1e-3, 0.1),
    Entry("2", "c", 0.3, 0.01, 1e-3, 0.1),
    Entry("3", "c", 0.4, 0.01, 1e-3, 0.1),
]


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("load", LOADS)
def test_its_studies_are_sound(body: str, load: str, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(study_text(body, load, OURS))
    study = load_study(path)
    assert study.study.models == (*OURS, "fem")
    assert len(expand(study)) == (4 if load == "touch" else 2)


def test_shares_within_a_limit() -> None:
    assert within(of(FOUND, "a"), 0.05) == pytest.approx((2 / 3, 1.0)), (
        "0.04 + 0.02 is not surely within 0.05"
    )
    assert within(of(FOUND, "b"), 0.10) == pytest.approx((1 / 3, 2 / 3)), "a failure is within nothing"
    assert within(of(FOUND, "c"), 0.20) == (0.0, 0.0)
    assert ranked(FOUND) == ["a", "b", "c"]


def test_profiles() -> None:
    limits = np.array([0.01, 0.05, 0.1, 1.0])
    assert_allclose(accuracy_profile(of(FOUND, "a"), limits), [1 / 3, 1.0, 1.0, 1.0])
    assert_allclose(accuracy_profile(of(FOUND, "b"), limits), [0.0, 0.0, 2 / 3, 2 / 3])
    factors = np.array([1.0, 2.0, 10.0, 1e6])
    # the quickest within 10 %: b in two cases, a in the third; c is quick and never within
    assert_allclose(time_profile(FOUND, "a", factors), [1 / 3, 2 / 3, 1.0, 1.0])
    assert_allclose(time_profile(FOUND, "b", factors), [2 / 3] * 4)
    assert_allclose(time_profile(FOUND, "c", factors), [0.0] * 4)


def test_the_table_and_its_picture() -> None:
    rows = {row[0]: row[1:] for row in cells(table(FOUND))[1:]}
    assert list(rows) == ["a", "b", "c"]
    assert rows["a"][:4] == ["3", "0", "2.00 % ± 1 %", "4.00 %"]
    assert rows["b"][:2] == ["3", "1"]
    assert rows["a"][4] == "100 % (67 % surely)"
    assert rows["b"][-2:] == ["300 ms", "2.00 s"]
    told = section(FOUND, ["mujoco-flex"])
    assert "Not here: mujoco-flex, which is not installed: pip install ./docs/examples." in told
    words = "".join(ET.fromstring(picture(FOUND)).itertext())
    for name in ("a", "b", "c", "share of cases within an error"):
        assert name in words


def test_entries_are_those_of_a_run() -> None:
    run = make_run([make_case({"vdm-vector": 0.3, "vdm-paper": NAN}, reference="fem-linear")])
    found = {entry.model: entry for entry in entries(run, ("vdm-paper", "vdm-vector", "not there"))}
    assert found["vdm-vector"].error == pytest.approx(0.3)
    assert found["vdm-paper"].failed
    assert set(found) == {"vdm-paper", "vdm-vector"}


def test_the_page_has_every_model() -> None:
    rows = cells(shown(DOCUMENT, PART))[1:]
    assert {row[0] for row in rows} == set(MODELS)
    assert len({row[1] for row in rows}) == 1, "all on the same cases"
