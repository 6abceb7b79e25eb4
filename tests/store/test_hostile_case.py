"""Case files that somebody made and sealed: what does not fit together is damage (StoreError), nothing else."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from tests.example_case import example_case
from tests.store.test_store import _replace, _reseal
from vdmbench.measures.case import Run
from vdmbench.measures.frame import frame
from vdmbench.store import cases as store
from vdmbench.store.hdf5 import StoreError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, example_case())
    return path


def _edited(name: str, edit: Callable[[np.ndarray], np.ndarray]) -> Callable[[h5py.File], None]:
    return lambda file: _replace(file, name, edit(file[name][()]))


def _declared(file: h5py.File) -> None:
    del file["VTKHDF/Points"]
    file.create_dataset("VTKHDF/Points", shape=(1 << 29, 3), dtype="f8", chunks=(1 << 14, 3))


EDITS: dict[str, Callable[[h5py.File], None]] = {
    "a facet beyond the nodes": _edited("VTKHDF/Connectivity", lambda x: x + 1),
    "a facet below zero": _edited("VTKHDF/Connectivity", lambda x: x - 1),
    "a node at 1e300": _edited("VTKHDF/Points", lambda x: x + 1e300),
    "a node nowhere": _edited("VTKHDF/Points", lambda x: x * np.nan),
    "a field of 1e300": _edited("VTKHDF/PointData/vdm-paper.displacement", lambda x: x * 0 + 1e300),
    "load factors without number": _edited("VTKHDF/Steps/Values", lambda x: x * np.inf),
    "a step too many": _edited("models/vdm-paper", lambda x: np.append(x, x[:1])),
    "a region of other nodes": _edited("VTKHDF/PointData/region.base", lambda x: x[:2]),
    "a size that is not there": _declared,
}


@pytest.mark.parametrize("what", EDITS)
def test_arrays_that_do_not_fit_are_refused(path: Path, what: str) -> None:
    _reseal(path, EDITS[what])
    with pytest.raises(StoreError, match=str(path)):
        store.read_case(path)


def test_a_case_that_would_not_be_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "MAX_BYTES", store._TEXTS_BYTES + 100)
    with pytest.raises(ValueError, match="more than a case file holds; use fewer load steps"):
        store.write_case(tmp_path / "case.vtkhdf", example_case())
    assert list(tmp_path.iterdir()) == []


def test_no_cell_of_the_table_is_a_formula() -> None:
    attack = '=HYPERLINK("http://example.org")'
    case = example_case()
    series = dataclasses.replace(case.metrics["vdm-paper"]["max_nodal_error"], unit=attack)
    models, metrics = {attack: case.models["vdm-paper"]}, {attack: {attack: series}}
    case = dataclasses.replace(case, swept={attack: attack}, models=models, metrics=metrics)
    rows = list(csv.reader(store.metrics_csv(frame(Run(case.study, "", [case], [], [], {}))).splitlines()))
    cells = [cell for row in rows for cell in row if "HYPERLINK" in cell]
    assert len(cells) == 1 + 4 * 3, "the heading; value, model, metric and unit of three steps"
    assert all(cell == f"'{attack}" for cell in cells)
