"""A file is what plain h5py would read and would have written."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vdmbench.store import hdf5
from vdmbench.store.hdf5 import Entry, Stored, StoreError, sealed


def entries(seed: int, rows: int = 3) -> list[Entry]:
    """A tree with everything that a file can hold."""
    rng = np.random.default_rng(seed)
    sparse = np.zeros((9000, 3))
    sparse[rng.integers(0, 9000, 50)] = rng.normal(size=(50, 3))
    return [
        Entry("case", None, {"schema": 1, "hash": f"{seed}" * 5, "size": rng.normal(), "kind": b"Grid"}),
        Entry("case/label", "long " * seed + "é"),
        Entry("data", None, {"version": np.array([2, seed])}),
        Entry("data/columns", rng.normal(size=rows), {"unit": "m", "definition": "|u|", "version": 3}),
        Entry("data/dense", rng.normal(size=(3000, 3)), {"unit": "m"}),
        Entry("data/sparse", sparse, {"unit": "N"}),
        Entry("data/counts", rng.integers(0, 9, (2, rows)), {}, ("cases", "steps")),
        Entry("data/mask", rng.integers(0, 2, 5).astype(np.int8)),
        Entry("data/empty", np.zeros((0, 3)), {"unit": "m"}),
        Entry("data/states", ["ok", "", f"é{seed}", "why\n"]),
        Entry("data/none"),
    ]


def tree(file: h5py.File) -> dict[str, Any]:
    """All of a file, by h5py's own interface: path -> (attributes, values or the members in their order)."""
    out: dict[str, Any] = {}

    def see(name: str, item: Any) -> None:
        about = {key: np.asarray(value).tolist() for key, value in item.attrs.items()}
        if isinstance(item, h5py.Group):
            out[name] = about, list(item)
        else:
            out[name] = about, item.dtype, np.asarray(item[()]).tolist(), [dim.label for dim in item.dims]

    file.visititems(see)
    return out


def opened(content: bytes) -> h5py.File:
    return h5py.File(io.BytesIO(content[: -hdf5.TRAILER_BYTES]), "r")


def expected(wanted: Sequence[Entry]) -> dict[str, Any]:
    """The same tree written by h5py's own interface, entry by entry."""
    with h5py.File("plain.h5", "w", driver="core", backing_store=False) as file:
        for entry in wanted:
            if entry.values is None:
                item = file.create_group(entry.path, track_order=True)
            elif isinstance(entry.values, np.ndarray):
                item = file.create_dataset(entry.path, data=entry.values)
            else:
                texts = np.array(entry.values, dtype=object)
                item = file.create_dataset(entry.path, data=texts, dtype=h5py.string_dtype())
            for axis, label in enumerate(entry.labels):
                item.dims[axis].label = label
            for name, value in entry.attributes.items():
                item.attrs[name] = np.bytes_(value) if isinstance(value, bytes) else value
        return tree(file)


def test_a_file_is_what_plain_h5py_writes() -> None:
    with opened(sealed(entries(1))) as file:
        assert tree(file) == expected(entries(1))


def test_zeros_are_compressed_and_digits_are_not() -> None:
    with opened(sealed(entries(1))) as file:
        assert file["data/sparse"].compression == "gzip"
        assert file["data/sparse"].id.get_storage_size() < 20_000
        assert file["data/dense"].compression is None
    digits = np.random.default_rng(1).normal(size=(9000, 3))
    with opened(sealed([Entry("data"), Entry("data/sparse", digits)])) as file:
        assert file["data/sparse"].compression is None


def test_what_is_read_is_what_was_listed(tmp_path: Path) -> None:
    path, wanted = tmp_path / "file.h5", entries(7)
    path.write_bytes(sealed(wanted))
    with Stored(path, schema=1) as stored:
        assert stored.members("data") == [e.path[5:] for e in wanted if e.path.startswith("data/")]
        for entry in wanted:
            if isinstance(entry.values, np.ndarray):
                numbers = stored.floats if entry.values.dtype == float else stored.integers
                assert_array_equal(numbers(entry.path), entry.values)
        assert stored.text("case/label") == wanted[1].values
        assert stored.attribute("case", "hash") == "77777"
        assert stored.attribute("case", "schema") == 1
        for wrong in (
            lambda: stored.attribute("case", "other"),
            lambda: stored.floats("data/other"),
            lambda: stored.floats("data/dense/other"),
        ):
            with pytest.raises(KeyError):
                wrong()


@pytest.mark.parametrize(("schema", "message"), [(0, "newer"), (2, "older")])
def test_another_schema_is_refused(tmp_path: Path, schema: int, message: str) -> None:
    path = tmp_path / "file.h5"
    path.write_bytes(sealed(entries(1)))
    with pytest.raises(StoreError, match=message):
        Stored(path, schema)
