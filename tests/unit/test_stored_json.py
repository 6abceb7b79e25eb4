"""Texts of a run directory: an edit is damage, and so is what is sealed but of no use; never a traceback."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.unit.example_case import example_case
from vdmbench.machine.stored_json import sealed
from vdmbench.store import cases as store
from vdmbench.store.hdf5 import StoreError
from vdmbench.store.run_directory import (
    PLAN,
    RESOLVED,
    STUDY,
    case_path,
    failure_path,
    read_failure,
    read_plan,
    write_failure,
    write_plan,
)

HASH, FAILED = "a1" * 32, "b2" * 32
KEY = "tissue.poisson_ratio"


def _planned(value: float = 0.45) -> dict[str, Any]:
    about = {"label": "x", "swept": {KEY: value}, "swept_units": {KEY: "1"}}
    study = {"name": "s", "title": "t", "models": ["vdm-paper"], "reference": None}
    return {"study": study, "cases": [{"hash": HASH, **about}, {"hash": FAILED, **about}]}


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """One case done, one failed."""
    store.write_case(case_path(tmp_path, HASH), example_case(HASH))
    reason = {"hash": FAILED, "label": "x", "code": "error", "message": "too coarse", "remedy": ""}
    write_failure(failure_path(tmp_path, FAILED), reason, "")
    write_plan(tmp_path, _planned(), {STUDY: b"[study]", RESOLVED: b"[tissue]"})
    store.write_study(tmp_path, store.read_run(tmp_path))
    assert store.run_state(tmp_path)["damaged"] == []
    return tmp_path


@pytest.mark.parametrize("name", [PLAN, STUDY, RESOLVED, "metrics.csv", f"failed/{FAILED[:12]}.json"])
def test_one_changed_character_is_damage(directory: Path, name: str) -> None:
    path = directory / name
    text = path.read_text()
    edits = {"0.45": "0.46", "study": "stuby", "tissue": "tissve", "coarse": "course"}
    old = next(old for old in edits if old in text)
    path.write_text(text.replace(old, edits[old], 1))
    if name == "metrics.csv":  # which nothing is read from
        assert store.run_state(directory)["damaged"] == ["metrics.csv (vdmbench report makes it anew)"]
        return
    with pytest.raises(StoreError, match=path.name):
        store.read_run(directory)
    if name in (STUDY, RESOLVED):
        assert len(store.run_state(directory)["damaged"]) == 1
    else:
        with pytest.raises(StoreError, match=path.name):
            store.run_state(directory)


def test_a_plan_does_not_overrule_a_case_file(directory: Path) -> None:
    write_plan(directory, _planned(0.44), {STUDY: b"[study]", RESOLVED: b"[tissue]"})
    with pytest.raises(StoreError, match=rf"it says {KEY} = 0.44 of case a1a1a1a1a1a1, whose file says 0.45"):
        store.read_run(directory)


def test_a_seal_is_of_one_file(directory: Path) -> None:
    other = failure_path(directory, "c3" * 32)
    other.write_bytes(failure_path(directory, FAILED).read_bytes())
    with pytest.raises(StoreError, match="its seal does not match"):
        read_failure(directory, "c3" * 32, "x")


def _deep(depth: int) -> Any:
    value: Any = 1
    for _ in range(depth):
        value = [value]
    return value


HOSTILE = [
    None,
    True,
    3,
    -1e300,
    10**400,
    "x",
    [],
    {},
    [[]],
    {"x": None},
    float("nan"),
    "\x1b[2J",
    _deep(150),
]


def _places(value: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place, *(found for key, item in items for found in _places(item, (*place, key)))]


def _with(value: Any, place: tuple[Any, ...], new: Any) -> Any:
    if not place:
        return new
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[place[0]] = _with(value[place[0]], place[1:], new)
    return copy


@pytest.mark.parametrize("new", HOSTILE, ids=lambda new: repr(new)[:12])
def test_a_resealed_plan_of_the_wrong_shape_is_refused_or_read(directory: Path, new: Any) -> None:
    plan = {key: value for key, value in json.loads((directory / PLAN).read_text()).items() if key != "seal"}
    for place in _places(plan):
        changed = _with(plan, place, new)
        if not isinstance(changed, dict):
            (directory / PLAN).write_text(json.dumps(changed))
        else:
            (directory / PLAN).write_bytes(sealed(changed, PLAN))
        for read in (read_plan, store.run_state, store.read_run):
            with suppress(StoreError):
                read(directory)


@pytest.mark.parametrize("new", HOSTILE, ids=lambda new: repr(new)[:12])
def test_a_resealed_failure_of_the_wrong_shape_is_refused_or_read(directory: Path, new: Any) -> None:
    path = failure_path(directory, FAILED)
    failure = {key: value for key, value in json.loads(path.read_text()).items() if key != "seal"}
    for place in _places(failure)[1:]:
        path.write_bytes(sealed(_with(failure, place, new), path.name))
        try:
            found = read_failure(directory, FAILED, "x")
        except StoreError:
            continue
        assert all(isinstance(text, str) for text in found.values())


@pytest.mark.parametrize("text", ["[" * 100_000, "{" * 100_000, "9" * 5000, b"\xed\xa0\x80"])
def test_texts_that_are_no_json_are_refused(directory: Path, text: str | bytes) -> None:
    for path in (directory / PLAN, failure_path(directory, FAILED)):
        path.write_bytes(text.encode() if isinstance(text, str) else text)
    with pytest.raises(StoreError, match="damaged"):
        read_plan(directory)
    with pytest.raises(StoreError, match="damaged"):
        read_failure(directory, FAILED, "x")
