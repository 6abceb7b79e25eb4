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
from h5py import h5, h5a, h5d, h5ds, h5f, h5g, h5l, h5o, h5p, h5s, h5t, string_dtype
from numpy.typing import NDArray

MAX_BYTES = 2 << 30  # of the results of a case
TRAILER = b"\nvdmbench-sha256 "
TRAILER_BYTES = len(TRAILER) + 64 + 1
_COMPRESS_FROM = 1 << 17  # bytes; of less, compressing takes longer than all else of a file
_CHUNK = 16384  # rows
_TEXT = h5t.py_create(string_dtype("utf-8"), logical=True)  # in a file
_STRING = h5t.py_create(string_dtype("utf-8"))  # in memory
_SCALAR = h5s.create(h5s.SCALAR)
_TABLES: dict[bytes, np.dtype[Any]] = {}  # a table's type, as HDF5 writes it -> the same as NumPy's
_CREATION_ORDER = h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED


class StoreError(ValueError):
    """A stored result is damaged or of another schema; the message says which file and what to do."""


# what comes of a file whose parts do not fit each other
UNREADABLE = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, OSError, RuntimeError)


class OlderSchemaError(StoreError):
    """A stored result of an older version of the program, sound for that one."""


# --- what a file is made of ---


@dataclass(frozen=True)
class Group:
    """A group; its members keep the order in which they are listed.

    Attributes are texts, numbers or arrays of numbers; bytes are ASCII of a fixed length.
    """

    path: str
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Data:
    """An array of numbers. Attributes are texts or whole numbers, `labels` name its dimensions.

    An array before it in the file's root, of the name of a label, is the scale of that dimension.
    """

    path: str
    values: NDArray[Any]
    attributes: Mapping[str, str | int] = field(default_factory=dict)
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Text:
    """A text, or a list or table of texts."""

    path: str
    values: str | Sequence[Any]
    labels: tuple[str, ...] = ()


Entry = Group | Data | Text


# --- writing ---


def sealed(entries: Sequence[Entry]) -> bytes:
    """The bytes of a file: groups before what is in them."""
    file = h5f.create(b"case.h5", h5f.ACC_TRUNC, fapl=_in_memory())
    for entry in entries:
        _add(file, entry)
    h5f.flush(file)
    image: bytes = file.get_file_image()
    file.close()
    return b"".join((image, TRAILER, hashlib.sha256(image).hexdigest().encode(), b"\n"))


def _add(file: Any, entry: Entry) -> None:
    path = entry.path.encode()
    if isinstance(entry, Text):
        texts = np.array(entry.values, dtype=object)
        space = h5s.create_simple(texts.shape) if texts.shape else _SCALAR
        owner = h5d.create(file, path, _TEXT, space)
        owner.write(h5s.ALL, h5s.ALL, texts, mtype=_STRING)
        _name_dimensions(file, owner, entry.labels)
        return
    if isinstance(entry, Group):
        ordered = h5p.create(h5p.GROUP_CREATE)
        ordered.set_link_creation_order(_CREATION_ORDER)
        owner = h5g.create(file, path, gcpl=ordered)
    else:
        owner = _dataset(file, path, np.ascontiguousarray(entry.values))
        _name_dimensions(file, owner, entry.labels)
    for name, value in entry.attributes.items():
        _attach(owner, name.encode(), value)


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
    """A sealed file, open for reading. What is read of it is no link and stored in it: those could lead elsewhere.

    A name that it lacks is a KeyError.
    """

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
        except UNREADABLE as error:
            self._file.close()
            raise StoreError(f"{path}: not readable ({error}); delete it and run again") from error

    def _schema(self) -> int:
        """Its schema; 0 where it has none."""
        try:
            return int(self.number("case", "schema"))
        except (KeyError, TypeError, ValueError, OSError, OverflowError):
            return 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __contains__(self, path: str) -> bool:
        try:
            self._object(path)
        except KeyError:
            return False
        return True

    def _object(self, path: str) -> Any:
        """A group or an array. Raises KeyError where there is none, StoreError for a link, followed by nobody."""
        found = self._objects.get(path)
        if found is None:
            group, _, name = path.rpartition("/")
            owner = self._object(group) if group else self._file
            if not isinstance(owner, h5g.GroupID):
                raise KeyError(path)
            try:
                kind = owner.links.get_info(name.encode()).type
            except RuntimeError:
                raise KeyError(path) from None
            if kind != h5l.TYPE_HARD:
                raise StoreError(f"holds a link (/{path}), which a result file never does")
            found = self._objects[path] = h5o.open(owner, name.encode())
            if isinstance(found, h5d.DatasetID):
                _require_inside(found)
        return found

    def members(self, path: str) -> list[str]:
        """Names of what a group holds, in the order in which it was written."""
        names: list[str] = []
        group = self._object(path)
        if not isinstance(group, h5g.GroupID):
            raise KeyError(path)
        group.links.iterate(lambda name: names.append(name.decode()), idx_type=h5.INDEX_CRT_ORDER)
        return names

    def floats(self, path: str) -> NDArray[np.float64]:
        """An array of double precision."""
        return self._read(path, np.dtype(np.float64), h5t.NATIVE_DOUBLE)

    def integers(self, path: str) -> NDArray[np.int64]:
        """An array of whole numbers."""
        return self._read(path, np.dtype(np.int64), h5t.NATIVE_INT64)

    def table(self, path: str) -> dict[str, NDArray[np.float64]]:
        """The columns of a table of numbers by name."""
        stored = self._dataset(path).get_type()
        kind = _TABLES.get(key := stored.encode())
        if kind is None:  # which takes HDF5 as long as all else of a file
            kind = _TABLES[key] = stored.dtype
        rows = self._read(path, kind, stored)
        return {name: rows[name].astype(np.float64) for name in rows.dtype.names or ()}

    def texts(self, path: str) -> Any:
        """A text, or nested lists of texts."""
        kind = self._dataset(path).dtype
        return _decoded(self._read(path, kind, _STRING if kind.kind == "O" else h5t.py_create(kind)).tolist())

    def number(self, path: str, name: str) -> float:
        """An attribute that is a number."""
        value = np.empty(())
        h5a.open(self._object(path), name.encode()).read(value, mtype=h5t.NATIVE_DOUBLE)
        return float(value)

    def text(self, path: str, name: str, default: str | None = None) -> str:
        """An attribute that is a text."""
        owner = self._object(path)
        if default is not None and not h5a.exists(owner, name.encode()):
            return default
        value = np.empty((), dtype=object)
        h5a.open(owner, name.encode()).read(value, mtype=_STRING)
        return str(_decoded(value[()]))

    def _read(self, path: str, kind: np.dtype[Any], stored: Any) -> Any:
        dataset = self._dataset(path)
        values = np.empty(dataset.shape, dtype=kind)
        dataset.read(h5s.ALL, h5s.ALL, values, mtype=stored)
        return values

    def _dataset(self, path: str) -> Any:
        found = self._object(path)
        if not isinstance(found, h5d.DatasetID):
            raise KeyError(path)
        return found


def _decoded(values: Any) -> Any:
    if isinstance(values, list):
        return [_decoded(value) for value in values]
    return values.decode("utf-8", "surrogateescape") if isinstance(values, bytes) else str(values)


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


def _require_inside(dataset: Any) -> None:
    """Raises StoreError for an array that is stored outside the file."""
    made = dataset.get_create_plist()
    if made.get_external_count() or made.get_layout() == h5d.VIRTUAL:
        raise StoreError("holds an array that is stored outside the file, which a result file never does")
