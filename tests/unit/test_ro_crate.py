"""The metadata file of a run directory: what RO-Crate 1.1 wants, every file, and no folder of the machine."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from vdmbench.report.rebuild import rebuild
from vdmbench.store import cases as store
from vdmbench.store.ro_crate import CRATE, write_crate
from vdmbench.store.run_directory import refuse_foreign

from .test_store import _run_directory as make_directory

Entity = dict[str, Any]


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    """A run directory with a case that is done, one that failed and one that is missing."""
    made = tmp_path / "secret" / "run one"
    (made / "cases").mkdir(parents=True)
    (made / "failed").mkdir()
    make_directory(made)
    return made


def graph_of(directory: Path) -> dict[str, Entity]:
    data = json.loads((directory / CRATE).read_text())
    assert data.keys() == {"@context", "@graph"}
    assert data["@context"] == "https://w3id.org/ro/crate/1.1/context"
    ids = [entity["@id"] for entity in data["@graph"]]
    assert len(ids) == len(set(ids))
    return {entity["@id"]: entity for entity in data["@graph"]}


def links(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if value.keys() == {"@id"}:
            yield value["@id"]
        for item in value.values():
            yield from links(item)
    if isinstance(value, list):
        for item in value:
            yield from links(item)


def test_it_has_what_the_specification_wants(directory: Path) -> None:
    write_crate(directory, store.read_run(directory))
    graph = graph_of(directory)
    assert graph[CRATE] == {
        "@id": CRATE,
        "@type": "CreativeWork",
        "about": {"@id": "./"},
        "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
    }
    root = graph["./"]
    assert root["@type"] == "Dataset"
    assert all(root[key] for key in ("name", "description", "datePublished", "license", "hasPart"))
    assert graph[root["license"]["@id"]]["description"]
    assert all(isinstance(entity["@type"], str) for entity in graph.values())
    for target in links(list(graph.values())):
        assert target in graph or target.startswith(("http://schema.org/", "https://w3id.org/")), target


def test_every_file_is_there_with_its_type_and_size(directory: Path) -> None:
    rebuild(directory, print)
    graph = graph_of(directory)
    told = {unquote(one["@id"]): one for one in graph.values() if one["@type"] == "File"}
    there = {path.relative_to(directory).as_posix() for path in directory.rglob("*") if path.is_file()}
    assert set(told) == {name for name in there if not name.startswith(".lock") and name != CRATE}
    for name, one in told.items():
        assert one["contentSize"] == str((directory / name).stat().st_size)
        assert one["encodingFormat"]
    assert {part["@id"] for part in graph["./"]["hasPart"]} == {one["@id"] for one in told.values()}
    media = {Path(name).suffix: one["encodingFormat"] for name, one in told.items()}
    assert (media[".html"], media[".csv"], media[".vtkhdf"]) == (
        "text/html",
        "text/csv",
        "application/x-hdf5",
    )


def test_the_run_is_an_action_of_the_software_of_its_cases(directory: Path) -> None:
    run = store.read_run(directory)
    dates = {
        "date": "2026-01-02T03:04:05+00:00",
        "package.vdmbench": "9.8",
        "package.numpy": "2.1",
        "commit": "abc",
    }
    case = dataclasses.replace(run.cases[0], provenance=dates)
    write_crate(directory, dataclasses.replace(run, cases=[case]))
    graph = graph_of(directory)
    action = graph["#run"]
    assert action["@type"] == "CreateAction"
    assert action["instrument"] == {"@id": "#vdmbench"}
    assert action["object"] == [{"@id": "study.toml"}]
    assert {"@id": "plan.json"} in action["result"]
    assert action["endTime"] == dates["date"]
    assert action["actionStatus"] == {"@id": "http://schema.org/FailedActionStatus"}
    assert action["error"] == "cases that failed: 1, that were not run: 1"
    assert (graph["#vdmbench"]["softwareVersion"], graph["#vdmbench"]["identifier"]) == ("9.8", "abc")
    assert graph["#numpy"]["softwareVersion"] == "2.1"
    assert graph["./"]["datePublished"] == "2026-01-02"


def test_it_names_no_folder_and_comes_out_the_same(directory: Path) -> None:
    rebuild(directory, print)
    first = (directory / CRATE).read_bytes()
    for word in ("secret", "run one", "/tmp", "home"):
        assert word.encode() not in first
    refuse_foreign(directory)
    assert store.run_state(directory)["damaged"] == []
    run = store.read_run(directory)
    dated = {**run.cases[0].provenance, "date": "2026-01-02T03:04:05+00:00"}
    run = dataclasses.replace(run, cases=[dataclasses.replace(run.cases[0], provenance=dated)])
    texts = []
    for _ in range(2):
        write_crate(directory, run)
        texts.append((directory / CRATE).read_bytes())
    assert texts[0] == texts[1]
