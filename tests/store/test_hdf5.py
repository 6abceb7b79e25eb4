"""A file is what plain h5py would read and would have written, and each of its arrays is where it is said to be."""

import io
import time
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
from numpy.testing import assert_array_equal

from vdmbench.store.hdf5 import Block, Entry, hdf5_image

RNG = np.random.default_rng(1)
ENTRIES = [
    Entry("data", None, {"version": np.array([2, 0]), "steps": 3, "kind": b"Grid"}),
    Entry("data/numbers", RNG.normal(size=3), {"unit": "m", "definition": "|u| in \u00e9"}),
    Entry("data/field", RNG.normal(size=(3000, 3))[:, ::-1]),
    Entry("data/counts", RNG.integers(0, 9, (2, 3))),
    Entry("data/mask", RNG.integers(0, 2, 5).astype(np.int8)),
    Entry("data/empty", np.zeros((0, 3)), {"unit": "m"}),
    Entry("data/none"),
]


def tree(file: h5py.File) -> dict[str, Any]:
    """All of a file, by h5py's own interface: path -> (attributes, values or the members)."""
    out: dict[str, Any] = {}

    def see(name: str, item: Any) -> None:
        about = {key: np.asarray(value).tolist() for key, value in item.attrs.items()}
        if isinstance(item, h5py.Group):
            out[name] = about, list(item)
        else:
            out[name] = about, item.dtype, np.asarray(item[()]).tolist()

    file.visititems(see)
    return out


def expected(wanted: Sequence[Entry]) -> dict[str, Any]:
    """The same tree written by h5py's own interface, entry by entry."""
    with h5py.File("plain.h5", "w", driver="core", backing_store=False) as file:
        for entry in wanted:
            item = (
                file.create_group(entry.path)
                if entry.values is None
                else file.create_dataset(entry.path, data=entry.values)
            )
            for name, value in entry.attributes.items():
                item.attrs[name] = np.bytes_(value) if isinstance(value, bytes) else value
        return tree(file)


def test_a_file_is_what_plain_h5py_writes_and_says_where_its_arrays_are() -> None:
    blocks: dict[str, Block] = {}

    def text(found: Mapping[str, Block]) -> str:
        blocks.update(found)
        return "é, of all"

    image, place = hdf5_image(ENTRIES, "data/text", text)
    assert image[place].decode() == "é, of all"
    with h5py.File(io.BytesIO(image), "r+") as file:
        assert file["data/text"][()].decode() == "é, of all"
        del file["data/text"]
        assert tree(file) == expected(ENTRIES)
    arrays = {entry.path: entry.values for entry in ENTRIES if entry.values is not None}
    assert blocks.keys() == arrays.keys()
    for path, values in arrays.items():
        found = blocks[path].of(image + b"more")
        assert_array_equal(found, values, err_msg=path)
        assert found.dtype == values.dtype
    time.sleep(1.01 - time.time() % 1.0)  # HDF5 has times in whole seconds: until the next
    assert hdf5_image(ENTRIES, "data/text", text)[0] == image, "the same numbers are the same bytes"
