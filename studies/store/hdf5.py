"""HDF5 files as trees of arrays and texts, with a seal. The only file that imports h5py.

A file is built in memory, because HDF5 crashes the process on a full disk. Its last bytes hold the SHA-256 of all
before them, checked before HDF5 sees the file.

It is all in h5py's low-level interface, which takes a third of the time of the other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from h5py import h5, h5a, h5d, h5ds, h5f, h5g, h5o, h5p, h5s, h5t, string_dtype
from numpy.typing import NDArray

MAX_BYTES = 2 << 30  # of the results of a case
TRAILER = b"\nvdmbench-sha256 "
TRAILER_BYTES = len(TRAILER) + 64 + 1
_COMPRESS_FROM = 1 << 17  # bytes; of less, compressing takes longer than all else of a file
_CHUNK = 16384  # rows
_TEXT = h5t.py_create(string_dtype("utf-8"), logical=True)  # in a file
_STRING = h5t.py_create(string_dtype("utf-8"))  # in memory
_SCALAR = h5s.create(h5s.SCALAR)
_CREATION_ORDER = h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED


class StoreError(ValueError):
    """A stored result is damaged or of another schema; the message says which file and what to do."""


# what comes of a file whose parts do not fit each other
UNREADABLE = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, OSError, RuntimeError)


class OlderSchemaError(StoreError):
    """A stored result of an older version of the program, sound for that one."""


# --- writing ---


@dataclass(frozen=True)
class Entry:
    """What is at a path: a group, an array of numbers, or texts.

    Attributes
    ----------
    values : None of a group, whose members keep the order in which they are listed; a text or a list of texts
    attributes : texts, numbers or arrays of numbers; bytes are ASCII of a fixed length
    labels : names of dimensions; an array before it in the file's root, of such a name, is that dimension's scale
    """

    path: str
    values: NDArray[Any] | str | Sequence[str] | None = None
    attributes: Mapping[str, Any] = field(default_factory=dict)
    labels: tuple[str, ...] = ()


def sealed(entries: Sequence[Entry]) -> bytes:
    """The bytes of a file: groups before what is in them."""
    file = h5f.create(b"case.h5", h5f.ACC_TRUNC, fapl=_in_memory())
    for entry in entries:
        owner = _made(file, entry.path.encode(), entry.values)
        _name_dimensions(file, owner, entry.labels)
        for name, value in entry.attributes.items():
            _attach(owner, name.encode(), value)
    h5f.flush(file)
    image: bytes = file.get_file_image()
    file.close()
    return b"".join((image, TRAILER, hashlib.sha256(image).hexdigest().encode(), b"\n"))


def _made(file: Any, path: bytes, values: NDArray[Any] | str | Sequence[str] | None) -> Any:
    if values is None:
        ordered = h5p.create(h5p.GROUP_CREATE)
        ordered.set_link_creation_order(_CREATION_ORDER)
        return h5g.create(file, path, gcpl=ordered)
    if isinstance(values, np.ndarray):
        return _dataset(file, path, np.ascontiguousarray(values))
    texts = np.array(values, dtype=object)
    dataset = h5d.create(file, path, _TEXT, h5s.create_simple(texts.shape) if texts.shape else _SCALAR)
    dataset.write(h5s.ALL, h5s.ALL, texts, mtype=_STRING)
    return dataset


def _name_dimensions(file: Any, owner: Any, labels: Sequence[str]) -> None:
    for axis, label in enumerate(map(str.encode, labels)):
        h5ds.set_label(owner, axis, label)
        if file.links.exists(label):
            scale = h5d.open(file, label)
            if not h5ds.is_scale(scale):
                h5ds.set_scale(scale, label)
            h5ds.attach_scale(owner, scale, axis)


def _dataset(file: Any, path: bytes, values: NDArray[Any]) -> Any:
    how = h5p.create(h5p.DATASET_CREATE)
    how.set_obj_track_times(False)  # the same numbers, the same bytes, whoever writes them when
    # zeros shrink, the digits of a solution hardly do
    if values.nbytes > _COMPRESS_FROM and 2 * np.count_nonzero(values) < values.size:
        how.set_chunk((min(len(values), _CHUNK), *values.shape[1:]))
        how.set_shuffle()
        how.set_deflate(1)
    kind = h5t.py_create(values.dtype, logical=True)
    dataset = h5d.create(file, path, kind, h5s.create_simple(values.shape), dcpl=how)
    if values.size:
        dataset.write(h5s.ALL, h5s.ALL, values)
    return dataset


def _attach(owner: Any, name: bytes, value: Any) -> None:
    if isinstance(value, str):
        text = np.array(value, dtype=object)
        h5a.create(owner, name, _TEXT, _SCALAR).write(text, mtype=_STRING)
        return
    values = np.asarray(value)
    space = h5s.create_simple(values.shape) if values.shape else _SCALAR
    h5a.create(owner, name, h5t.py_create(values.dtype, logical=True), space).write(values)


def _in_memory(image: bytes = b"") -> Any:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(1 << 16, False)
    access.set_fclose_degree(h5f.CLOSE_STRONG)  # and with it whatever is open in it
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    if image:
        access.set_file_image(image)
    return access


# --- reading ---


class Stored:
    """A sealed file, open for reading. A name that it lacks is a KeyError."""

    def __init__(self, path: Path, schema: int) -> None:
        """Open a file of this schema.

        Raises
        ------
        StoreError
            damaged, or of another schema.
        """
        self._file, self._objects = _open(path), dict[str, Any]()
        try:
            found = self._schema()
            if found > schema:
                raise StoreError(f"schema {found} is newer than this program's {schema}; update vdmbench")
            if found < 1:
                raise StoreError("not a result file (it has no schema); delete it and run again")
            if found < schema:
                raise OlderSchemaError(f"schema {found} is older than this program's {schema}; run again")
        except StoreError as error:
            self._file.close()
            raise type(error)(f"{path}: {error}") from None

    def _schema(self) -> int:
        """Its schema; 0 where it has none."""
        try:
            return int(self.attribute("case", "schema"))
        except UNREADABLE:
            return 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def _object(self, path: str) -> Any:
        """A group or an array. Raises KeyError where there is none."""
        if path not in self._objects:
            try:
                self._objects[path] = h5o.open(self._file, path.encode())
            except (KeyError, RuntimeError):
                raise KeyError(path) from None
        return self._objects[path]

    def members(self, path: str) -> list[str]:
        """Names of what a group holds, in the order in which it was written."""
        names: list[str] = []
        self._object(path).links.iterate(
            lambda name: names.append(name.decode()), idx_type=h5.INDEX_CRT_ORDER
        )
        return names

    def floats(self, path: str) -> NDArray[np.float64]:
        """An array of double precision."""
        return self._read(path, np.dtype(np.float64), h5t.NATIVE_DOUBLE)

    def integers(self, path: str) -> NDArray[np.int64]:
        """An array of whole numbers."""
        return self._read(path, np.dtype(np.int64), h5t.NATIVE_INT64)

    def text(self, path: str) -> str:
        """A text."""
        found: bytes = self._read(path, np.dtype(object), _STRING)[()]
        return found.decode()

    def attribute(self, path: str, name: str) -> str | float:
        """An attribute: a text or a number."""
        stored = h5a.open(self._object(path), name.encode())
        if stored.get_type().get_class() == h5t.STRING:
            text = np.empty((), dtype=object)
            stored.read(text, mtype=_STRING)
            return bytes(text[()]).decode()
        number = np.empty(())
        stored.read(number, mtype=h5t.NATIVE_DOUBLE)
        return float(number)

    def _read(self, path: str, kind: np.dtype[Any], stored: Any) -> Any:
        dataset = self._object(path)
        values = np.empty(dataset.shape, dtype=kind)
        dataset.read(h5s.ALL, h5s.ALL, values, mtype=stored)
        return values


def _open(path: Path) -> Any:
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise StoreError(f"{path}: a directory is in a file's place; remove it, then run again") from None
    image, trailer = data[:-TRAILER_BYTES], data[-TRAILER_BYTES:]
    digest = hashlib.sha256(image).hexdigest().encode()
    if trailer != TRAILER + digest + b"\n":
        raise StoreError(f"{path}: damaged (its SHA-256 does not match); delete it and run again")
    try:
        return h5f.open(b"case.h5", h5f.ACC_RDONLY, fapl=_in_memory(image))
    except OSError as error:
        raise StoreError(f"{path}: not an HDF5 file ({error}); delete it and run again") from error
