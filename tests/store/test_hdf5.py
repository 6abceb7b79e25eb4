"""A file is what plain h5py would read and would have written."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from vdmbench.store import hdf5
from vdmbench.store.hdf5 import Data, Entry, Group, Stored, StoreError, Text, sealed


def table(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Columns of numbers; of zeros mostly, as a large array that is compressed has them."""
    values = np.zeros(rows, [("length", "f8"), ("of seed", "i8")])
    values["length"][-1], values["of seed"] = rng.normal(), rng.integers(0, 2, rows)
    return values


def entries(seed: int, rows: int = 3) -> list[Entry]:
    """A tree with everything that a file can hold."""
    rng = np.random.default_rng(seed)
    sparse = np.zeros((9000, 3))
    sparse[rng.integers(0, 9000, 50)] = rng.normal(size=(50, 3))
    return [
        Group("case", {"schema": 1, "hash": f"{seed}" * 5, "size": rng.normal(), "kind": b"Grid"}),
        Text("case/label", "long " * seed),
        Group("data", {"version": np.array([2, seed])}),
        Data("data/columns", rng.normal(size=rows), {"unit": "m", "definition": "|u|", "version": 3}),
        Data("data/dense", rng.normal(size=(3000, 3)), {"unit": "m"}),
        Data("data/sparse", sparse, {"unit": "N"}),
        Data("data/counts", rng.integers(0, 9, (2, rows)), {}, ("cases", "steps")),
        Data("data/table", table(rng, rows), {"units": "m, 1"}),
        Data("data/mask", rng.integers(0, 2, 5).astype(np.int8)),
        Data("data/empty", np.zeros((0, 3)), {"unit": "m"}),
        Text("data/states", [["ok", "", f"é{seed}"], ["bad", "why\n", ""]]),
        Group("data/none"),
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
            if isinstance(entry, Text):
                file.create_dataset(
                    entry.path, data=np.array(entry.values, dtype=object), dtype=h5py.string_dtype()
                )
                continue
            if isinstance(entry, Data):
                item = file.create_dataset(entry.path, data=entry.values)
                for axis, label in enumerate(entry.labels):
                    item.dims[axis].label = label
            else:
                item = file.create_group(entry.path, track_order=True)
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
    with opened(sealed([Group("data"), Data("data/sparse", digits)])) as file:
        assert file["data/sparse"].compression is None


def test_what_is_read_is_what_was_listed(tmp_path: Path) -> None:
    path, wanted = tmp_path / "file.h5", entries(7)
    path.write_bytes(sealed(wanted))
    with Stored(path, schema=1) as stored:
        assert stored.members("data") == [e.path[5:] for e in wanted if e.path.startswith("data/")]
        for entry in wanted:
            if isinstance(entry, Data):
                if entry.values.dtype.names:
                    read = stored.table(entry.path)
                    assert list(read) == list(entry.values.dtype.names)
                    for name, values in read.items():
                        assert_array_equal(values, entry.values[name])
                        assert values.dtype == float
                    continue
                numbers = stored.floats if entry.values.dtype == float else stored.integers
                assert_array_equal(numbers(entry.path), entry.values)
            elif isinstance(entry, Text):
                assert stored.texts(entry.path) == entry.values
        assert stored.text("case", "hash") == "77777"
        assert stored.number("case", "schema") == 1.0
        assert stored.text("case", "other", "none") == "none"
        for wrong in (
            lambda: stored.text("case", "other"),
            lambda: stored.floats("data/other"),
            lambda: stored.floats("data"),
            lambda: stored.members("data/dense"),
        ):
            with pytest.raises(KeyError):
                wrong()


def test_a_file_that_plain_h5py_wrote_is_read(tmp_path: Path) -> None:
    """As this program's earlier versions did: other layouts, texts of a fixed length."""
    path = tmp_path / "file.h5"
    values = np.random.default_rng(3).normal(size=(500, 30))
    with h5py.File(path, "w") as file:
        file.create_group("case").attrs["schema"] = 1
        group = file.create_group("data", track_order=True)
        group.create_dataset("b", data=values, compression="gzip", shuffle=True)
        group["a"] = values.astype(np.float32)
        group["names"] = [b"x", b"yz"]
    content = path.read_bytes()
    path.write_bytes(content + hdf5.TRAILER + hashlib.sha256(content).hexdigest().encode() + b"\n")
    with Stored(path, schema=1) as stored:
        assert stored.members("data") == ["b", "a", "names"]
        assert_array_equal(stored.floats("data/b"), values)
        assert_array_equal(stored.floats("data/a"), values.astype(np.float32).astype(float))
        assert stored.texts("data/names") == ["x", "yz"]


def test_a_newer_schema_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file.h5"
    path.write_bytes(sealed(entries(1)))
    with pytest.raises(StoreError, match="newer"):
        Stored(path, schema=0)
    with pytest.raises(StoreError, match="older"):
        Stored(path, schema=2)


def test_a_long_table_is_compressed_where_it_is_empty(tmp_path: Path) -> None:
    path, rng = tmp_path / "file.h5", np.random.default_rng(3)
    empty, full = (table(rng, 9000) for _ in range(2))
    empty["of seed"] = 0
    full["length"] = 1.0
    path.write_bytes(sealed([Group("case", {"schema": 1}), Data("empty", empty), Data("full", full)]))
    with opened(path.read_bytes()) as file, Stored(path, schema=1) as stored:
        assert [file[name].compression for name in ("empty", "full")] == ["gzip", None]
        for name, values in (("empty", empty), ("full", full)):
            assert_array_equal(stored.table(name)["length"], values["length"])
