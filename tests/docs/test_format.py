"""`results/FORMAT.md` and the files hold together: each names all that the other has."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import h5py
import numpy as np
from numpy.testing import assert_array_equal

from tests.example_case import example_case
from vdmbench.measures.case import Run
from vdmbench.store import cases as store
from vdmbench.store import hdf5

FORMAT = Path(__file__).parents[2] / "results" / "FORMAT.md"
PLACEHOLDERS = {
    "<model>": r"[^/.]+?",
    "<region>": r"[^/]+",
}


def _documented() -> dict[str, re.Pattern[str]]:
    first = re.findall(r"^\| (`/[^|]+) \|", FORMAT.read_text(), flags=re.MULTILINE)
    rows = [path for cell in first for path in re.findall(r"`([^`]+)`", cell)]
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
    assert len(documented) > 15
    undocumented = [name for name in written if not any(p.fullmatch(name) for p in documented.values())]
    assert undocumented == []
    unwritten = [row for row, p in documented.items() if not any(p.fullmatch(name) for name in written)]
    assert unwritten == []


def test_the_tables_of_a_study_are_as_documented(tmp_path: Path) -> None:
    case = dataclasses.replace(example_case(), reference_error={"gci:max_nodal_error": 0.02})
    bare = dataclasses.replace(case, hash="0" * 64, reference_error={})
    run = Run(case.study, "text", [case, bare], [], [], {})
    store.write_study(tmp_path, run)
    section = FORMAT.read_text().split("## `study.h5`")[1].split("\n## ")[0]
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
    text = " ".join(FORMAT.read_text().split())
    with h5py.File(path) as file:
        for group in ("VTKHDF", "VTKHDF/Steps", "VTKHDF/Points", "case"):
            for name in file[group].attrs:
                assert f"`{name}`" in text, f"{group} has an attribute {name} that FORMAT.md does not name"
        assert file["case"].attrs["schema"] == store.SCHEMA
        assert f"`schema` ({store.SCHEMA};" in text
        about = json.loads(file["case/about"][()])
    (limit, *_), (quantity, *_) = (
        about["small_strain"]["models"]["vdm-paper"]["limits"],
        about["measurement"]["quantities"],
    )
    model, spread = (about[part]["models"]["vdm-paper"] for part in ("small_strain", "inputs"))
    own = about["models"]["vdm-paper"]
    tables = (
        about,
        own,
        own["status"][0],
        about["definitions"]["max_nodal_error"],
        about["small_strain"],
        model,
    )
    tables += (limit, quantity, about["measurement"], about["inputs"], spread)
    series = {name.removeprefix("vdm-paper.") for name in about["steps"] if name.startswith("vdm-paper.")}
    told = {key for table in tables for key in table} | {one for one in series if "." not in one}
    assert [name for name in sorted(told - set(own["scalars"])) if f"`{name}`" not in text] == []
    assert f"last {hdf5.TRAILER_BYTES} bytes" in text
