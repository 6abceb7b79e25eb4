"""`results/FORMAT.md` and the files hold together: each names all that the other has."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import h5py
import numpy as np
from numpy.testing import assert_array_equal

from studies import hdf5, store
from studies.case import Run
from tests.benchmarks import sharing
from tests.docs import marked
from tests.unit.example_case import example_case

FORMAT = Path(__file__).parents[2] / "results" / "FORMAT.md"
PLACEHOLDERS = {"<model>": r"[^/.]+?", "<region>": r"[^/]+", "<metric>": r"[^/]+"}


def _documented() -> dict[str, re.Pattern[str]]:
    rows = re.findall(r"^\| `(/[^`]+)` \|", FORMAT.read_text(), flags=re.MULTILINE)
    patterns = {}
    for row in rows:
        pattern = re.escape(row)
        for placeholder, expression in PLACEHOLDERS.items():
            pattern = pattern.replace(re.escape(placeholder), expression)
        patterns[row] = re.compile(pattern)
    return patterns


def test_every_dataset_is_documented_and_every_document_has_a_dataset(tmp_path: Path) -> None:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, example_case())
    written: list[str] = []
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: written.append(f"/{name}") if isinstance(item, h5py.Dataset) else None
        )
    documented = _documented()
    assert len(documented) > 20
    undocumented = [name for name in written if not any(p.fullmatch(name) for p in documented.values())]
    assert undocumented == []
    unwritten = [row for row, p in documented.items() if not any(p.fullmatch(name) for name in written)]
    assert unwritten == []


def test_the_tables_of_a_study_are_as_documented(tmp_path: Path) -> None:
    case = dataclasses.replace(example_case(), reference_error={"gci:max_nodal_error": 0.02})
    bare = dataclasses.replace(case, hash="0" * 64, reference_error={})
    run = Run({"name": "s", "models": [*case.models]}, "text", [case, bare], [], [], {})
    store.write_study(tmp_path, run)
    section = FORMAT.read_text().split("## A study: `study.h5`")[1].split("\n## ")[0]
    documented = {
        path
        for cell in re.findall(r"^\| (`[^|]+) \|", section, flags=re.MULTILINE)
        for path in re.findall(r"`([^`]+)`", cell)
    }
    written: dict[str, tuple[int, ...]] = {}
    with h5py.File(tmp_path / store.STUDY_FILE) as file:
        file.visititems(
            lambda name, item: written.update({name: item.shape}) if isinstance(item, h5py.Dataset) else None
        )
        bars = file["reference_error/vdm-paper/max_nodal_error"]
        assert_array_equal(bars, [0.02, np.nan])
        assert bars.attrs["unit"] == "m"
    general = {
        re.sub(
            r"^swept/.*",
            "swept/<key>",
            re.sub(r"^(metrics|reference_error)/.*", r"\1/<model>/<metric>", name),
        )
        for name in written
    }
    assert general == documented


def test_attributes_and_seal_are_as_documented(tmp_path: Path) -> None:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, example_case())
    text = FORMAT.read_text()
    with h5py.File(path) as file:
        for group in ("VTKHDF", "VTKHDF/Steps", "VTKHDF/Points", "case", "models/vdm-paper", "metrics"):
            for name in file[group].attrs:
                assert f"`{name}`" in text, f"{group} has an attribute {name} that FORMAT.md does not name"
        assert file["case"].attrs["schema"] == store.SCHEMA
        assert f"`schema` ({store.SCHEMA};" in text
        about = json.loads(file["case/about"][()])
        fields = set(example_case().models["vdm-paper"].scalars)
        columns = set(file["models/vdm-paper"].dtype.names) - fields
        told = {*about, *about["models"]["vdm-paper"], *about["metrics"]["max_nodal_error"], *columns}
        assert [name for name in sorted(told) if f"`{name}`" not in text] == []
    assert f"last {hdf5.TRAILER_BYTES} bytes" in text


def test_the_table_of_sharing_is_as_its_benchmark_writes_it() -> None:
    history, multiples = "one case, a history of 100 loads", "100 cases, multiples of one load"
    rounds = [
        {"one load": 10.0, multiples: 11.0, history: 15.0},
        {"one load": 20.0, multiples: 24.0, history: 30.0},
    ]
    full = sharing.Costs(100, 390, rounds, [1.5, 3.0], 150.0, 1e-14, {"file": 0.03, "metrics": 0.013})
    bare = dataclasses.replace(full, rounds=[{"one load": 2.0, multiples: 4.84}], added=[0.2])
    rows = marked.cells(sharing.written([("5 mm, 1,531 nodes", full), ("4 mm, 2,384 nodes", bare)]))
    assert rows == [
        ["study", "5 mm, 1,531 nodes", "4 mm, 2,384 nodes"],
        ["one load", "15 s", "2 s"],
        ["100 cases, multiples of one load", "1.17 times (1.1 to 1.2)", "2.42 times (2.42 to 2.42)"],
        ["one case, a history of 100 loads", "1.5 times (1.5 to 1.5)", "not run"],
        ["the 100 multiples, each alone", "10 times", "75 times"],
        [sharing.BY_PARTS, "1.15 times (1.1 to 1.2)", "1.1 times (1.1 to 1.1)"],
        ["a further multiple", "43 ms", "43 ms"],
        ["of it file", "30.0 ms", "30.0 ms"],
        ["of it metrics", "13.0 ms", "13.0 ms"],
        ["difference of a multiple's numbers", "1e-14", "1e-14"],
    ]
    shown = marked.cells(marked.shown(FORMAT, "sharing"))
    assert {row[0] for row in rows} <= {row[0] for row in shown}
    assert len(shown[0]) == 1 + len(sharing.SHOWN)
