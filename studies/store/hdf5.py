"""Nodal arrays as an HDF5 file that ParaView reads. Only this file imports h5py.

The file is built in memory, because HDF5 crashes the process on a full disk. h5py's low-level interface takes
half of the time of the other one. Arrays are contiguous, so that a reader needs only their positions; the text at
the end has these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from h5py import h5a, h5d, h5f, h5g, h5p, h5s, h5t, string_dtype
from numpy.typing import NDArray

_TEXT = h5t.py_create(string_dtype("utf-8"), logical=True)  # in a file
_STRING = h5t.py_create(string_dtype("utf-8"))  # in memory
_SCALAR = h5s.create(h5s.SCALAR)
_ALIGNED = 8  # bytes


@dataclass(frozen=True)
class Entry:
    """The object at a path: an array, or a group if it has no values.

    Attributes
    ----------
    attributes : texts, numbers or arrays of numbers; bytes are ASCII of a fixed length
    """

    path: str
    values: NDArray[Any] | None = None
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """Position of an array in a file: first byte, NumPy type, shape."""

    offset: int
    dtype: str
    shape: tuple[int, ...]

    def of(self, data: bytes) -> NDArray[Any]:
        """The array as a read-only view of `data`. Raises ValueError if it does not fit."""
        count = int(np.prod(self.shape))
        if not count:
            return np.empty(self.shape, self.dtype)
        return np.frombuffer(data, self.dtype, count, self.offset).reshape(self.shape)


def hdf5_image(
    entries: Sequence[Entry], path: str, text: Callable[[Mapping[str, Block]], str]
) -> tuple[bytes, slice]:
    """The bytes of a file, groups before their content, and the slice of the text at `path`.

    `text` makes the text last, from the position of each array.
    """
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(1 << 16, False)
    access.set_fclose_degree(h5f.CLOSE_STRONG)  # closes all open objects in it too
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    access.set_alignment(1, _ALIGNED)
    file = h5f.create(b"case.h5", h5f.ACC_TRUNC, fcpl=_timeless(h5p.FILE_CREATE), fapl=access)
    blocks = {}
    for entry in entries:
        if entry.values is None:
            owner = h5g.create(file, entry.path.encode(), gcpl=_timeless(h5p.GROUP_CREATE))
        else:
            owner, blocks[entry.path] = _dataset(file, entry.path, np.ascontiguousarray(entry.values))
        for name, value in entry.attributes.items():
            _attach(owner, name.encode(), value)
    told = text(blocks).encode()
    _, place = _dataset(file, path, np.array(told, dtype=string_dtype("utf-8", len(told))))
    h5f.flush(file)
    image: bytes = file.get_file_image()
    file.close()
    return image, slice(place.offset, place.offset + len(told))


def _timeless(kind: Any) -> Any:
    """Creation properties without times: equal content gives equal bytes."""
    how = h5p.create(kind)
    how.set_obj_track_times(False)
    return how


def _dataset(file: Any, path: str, values: NDArray[Any]) -> tuple[Any, Block]:
    kind = h5t.py_create(values.dtype, logical=True)
    space = h5s.create_simple(values.shape) if values.shape else _SCALAR
    dataset = h5d.create(file, path.encode(), kind, space, dcpl=_timeless(h5p.DATASET_CREATE))
    if not values.size:
        return dataset, Block(0, values.dtype.str, values.shape)
    dataset.write(h5s.ALL, h5s.ALL, values)
    return dataset, Block(dataset.get_offset(), values.dtype.str, values.shape)


def _attach(owner: Any, name: bytes, value: Any) -> None:
    if isinstance(value, str):
        text = np.array(value, dtype=object)
        h5a.create(owner, name, _TEXT, _SCALAR).write(text, mtype=_STRING)
        return
    values = np.asarray(value)
    space = h5s.create_simple(values.shape) if values.shape else _SCALAR
    h5a.create(owner, name, h5t.py_create(values.dtype, logical=True), space).write(values)
