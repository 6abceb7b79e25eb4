"""HDF5 files as trees of arrays and texts, with a seal. The only file that imports h5py.

A file is built in memory, because HDF5 crashes the process on a full disk. Its last bytes hold the SHA-256 of all
before them, checked before HDF5 sees the file.

HDF5 takes some 50 microseconds for each object and attribute, and a case has fifty, of which only the numbers
differ from those of the case before it. So the file without its numbers, the skeleton, is made once for all files
of one structure, and the numbers are put where HDF5 says that they belong. For the same reason all of this is in
h5py's low-level interface, which takes a quarter of the time of the other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from h5py import h5, h5a, h5d, h5ds, h5f, h5g, h5l, h5o, h5p, h5s, h5t, string_dtype
from numpy.typing import NDArray

from ..machine.safe_open import MAX_CASE_BYTES, UnfitFileError, read_regular

MAX_BYTES = MAX_CASE_BYTES
TRAILER = b"\nvdmbench-sha256 "
TRAILER_BYTES = len(TRAILER) + 64 + 1
_COMPRESS_FROM = 1 << 17  # bytes; of less, compressing takes longer than all else of a file
_CHUNK = 16384  # rows
_MOST_COMPRESSED = 1100  # deflate makes no more of a byte
_CHUNK_BYTES = 1 << 20  # of small arrays nothing needs to be there
_TEXT = h5t.py_create(string_dtype("utf-8"), logical=True)  # in a file
_STRING = h5t.py_create(string_dtype("utf-8"))  # in memory
_SCALAR = h5s.create(h5s.SCALAR)
_CREATION_ORDER = h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED
_MOST_SKELETONS = 8
_LARGEST_SKELETON = 8 << 20


class StoreError(ValueError):
    """A stored result is damaged or of another schema; the message says which file and what to do."""


# what comes of a file whose parts do not fit each other
UNREADABLE = (LookupError, ValueError, TypeError, AttributeError, ArithmeticError, OSError, RuntimeError)


class OlderSchemaError(StoreError):
    """A stored result of an older version of the program, sound for that one."""


# --- what a file is made of ---


@dataclass(frozen=True)
class Group:
    """A group; its members keep the order in which they are listed, the texts after the others.

    Attributes are texts, numbers or arrays of numbers; bytes are ASCII of a fixed length.
    """

    path: str
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Data:
    """An array of numbers. Attributes are texts or whole numbers, `labels` name its dimensions."""

    path: str
    values: NDArray[Any]
    attributes: Mapping[str, str | int] = field(default_factory=dict)
    labels: tuple[str, ...] = ()


@dataclass(frozen=True)
class Text:
    """A text, or a list or table of texts."""

    path: str
    values: str | Sequence[Any]


Entry = Group | Data | Text


# --- writing ---


def sealed(entries: Sequence[Entry]) -> bytes:
    """The bytes of a file: groups before what is in them."""
    image = _image(entries)
    return b"".join((image, TRAILER, hashlib.sha256(image).hexdigest().encode(), b"\n"))


def _image(entries: Sequence[Entry]) -> bytearray:
    arrays = [entry for entry in entries if isinstance(entry, Data)]
    skeleton, places = _skeleton_of([entry for entry in entries if not isinstance(entry, Text)])
    file = h5f.open(b"case.h5", h5f.ACC_RDWR, fapl=_in_memory(skeleton))
    for entry in entries:
        if isinstance(entry, Group):
            group = h5g.open(file, entry.path.encode())
            for name, value in entry.attributes.items():
                _fill(h5a.open(group, name.encode()), value)
        elif isinstance(entry, Text):
            texts = np.array(entry.values, dtype=object)
            space = h5s.create_simple(texts.shape) if texts.shape else _SCALAR
            h5d.create(file, entry.path.encode(), _TEXT, space).write(h5s.ALL, h5s.ALL, texts, mtype=_STRING)
    for entry, place in zip(arrays, places, strict=True):
        if place is None and entry.values.size:
            h5d.open(file, entry.path.encode()).write(h5s.ALL, h5s.ALL, np.ascontiguousarray(entry.values))
    image = bytearray(_closed(file))
    for entry, place in zip(arrays, places, strict=True):
        if place is not None:
            content = np.ascontiguousarray(entry.values).tobytes()
            image[place : place + len(content)] = content
    return image


# structure -> a file without numbers and texts, and where the numbers of each array start (None: HDF5 knows)
_skeletons: dict[tuple[Any, ...], tuple[bytes, list[int | None]]] = {}


def _structure(entry: Group | Data) -> tuple[Any, ...]:
    """What the skeleton has of an entry."""
    if isinstance(entry, Group):
        return (entry.path, *((name, _kind(value)) for name, value in entry.attributes.items()))
    values = entry.values
    attributes = tuple(entry.attributes.items())
    return (entry.path, values.dtype, values.shape, _compressed(values), attributes, entry.labels)


def _kind(value: Any) -> tuple[Any, ...]:
    return () if isinstance(value, str) else (np.asarray(value).dtype.str, np.shape(value))


def _compressed(values: NDArray[Any]) -> bool:
    """Zeros shrink, the digits of a solution hardly do."""
    return bool(values.nbytes > _COMPRESS_FROM and 2 * np.count_nonzero(values) < values.size)


def _skeleton_of(entries: Sequence[Group | Data]) -> tuple[bytes, list[int | None]]:
    structure = tuple(map(_structure, entries))
    found = _skeletons.get(structure) or _skeleton(entries)
    if len(found[0]) <= _LARGEST_SKELETON:  # the time for a large file is that of its numbers
        while structure not in _skeletons and len(_skeletons) >= _MOST_SKELETONS:
            del _skeletons[next(iter(_skeletons))]
        _skeletons[structure] = found
    return found


def _skeleton(entries: Sequence[Group | Data]) -> tuple[bytes, list[int | None]]:
    file = h5f.create(b"case.h5", h5f.ACC_TRUNC, fapl=_in_memory())
    ordered = h5p.create(h5p.GROUP_CREATE)
    ordered.set_link_creation_order(_CREATION_ORDER)
    places: list[int | None] = []
    for entry in entries:
        if isinstance(entry, Group):
            group = h5g.create(file, entry.path.encode(), gcpl=ordered)
            for name, value in entry.attributes.items():
                _attach(group, name, value)
            continue
        values = entry.values
        how = h5p.create(h5p.DATASET_CREATE)
        how.set_obj_track_times(False)  # one structure, one header, whoever writes it when
        if _compressed(values):
            how.set_chunk((min(len(values), _CHUNK), *values.shape[1:]))
            how.set_shuffle()
            how.set_deflate(1)
        else:  # its bytes in one place, and all of them written
            how.set_alloc_time(h5d.ALLOC_TIME_EARLY)
            how.set_fill_time(h5d.FILL_TIME_NEVER)
        kind = h5t.py_create(values.dtype, logical=True)
        dataset = h5d.create(file, entry.path.encode(), kind, h5s.create_simple(values.shape), dcpl=how)
        for name, value in entry.attributes.items():
            _attach(dataset, name, value)
        for axis, label in enumerate(entry.labels):
            h5ds.set_label(dataset, axis, label.encode())
        places.append(dataset.get_offset())
    return _closed(file), places


def _attach(owner: Any, name: str, value: Any) -> None:
    if isinstance(value, str):
        attribute = h5a.create(owner, name.encode(), _TEXT, _SCALAR)
    else:
        values = np.asarray(value)
        kind = h5t.py_create(values.dtype, logical=True)
        space = h5s.create_simple(values.shape) if values.shape else _SCALAR
        attribute = h5a.create(owner, name.encode(), kind, space)
    _fill(attribute, value)


def _fill(attribute: Any, value: Any) -> None:
    if isinstance(value, str):
        attribute.write(np.array(value, dtype=object), mtype=_STRING)
    else:
        attribute.write(np.asarray(value))


def _in_memory(image: bytes = b"") -> Any:
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fapl_core(1 << 16, False)
    access.set_fclose_degree(h5f.CLOSE_STRONG)  # and with it whatever is open in it
    access.set_libver_bounds(h5f.LIBVER_V110, h5f.LIBVER_V110)
    if image:
        access.set_file_image(image)
    return access


def _closed(file: Any) -> bytes:
    h5f.flush(file)
    image: bytes = file.get_file_image()
    file.close()
    return image


# --- reading ---


class Stored:
    """A sealed file, open for reading, that holds no link and nothing that is stored elsewhere.

    A name that it lacks is a KeyError.
    """

    def __init__(self, path: Path, schema: int) -> None:
        """Open a file of this schema.

        Raises
        ------
        StoreError
            damaged, of another schema, or with a link: an external one could read other files of the machine.
        """
        self._file = _open(path)
        try:
            self._objects = _objects(self._file, path)
            found = self._schema()
            if found > schema:
                raise StoreError(
                    f"{path}: schema {found} is newer than this program's {schema}; update vdmbench"
                )
            if found < 1:
                raise StoreError(f"{path}: not a result file (it has no schema); delete it and run again")
            if found < schema:
                raise OlderSchemaError(
                    f"{path}: schema {found} is older than this program's {schema}; run again"
                )
        except BaseException as error:
            self._file.close()
            if isinstance(error, UNREADABLE) and not isinstance(error, StoreError):
                raise StoreError(f"{path}: not readable ({error}); delete it and run again") from error
            raise

    def _schema(self) -> int:
        """Its schema; 0 where it has none."""
        try:
            return int(self.number("case", "schema"))
        except (KeyError, TypeError, ValueError, OSError, OverflowError):
            return 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def __contains__(self, path: str) -> bool:
        return path in self._objects

    def members(self, path: str) -> list[str]:
        """Names of what a group holds, in the order in which it was written."""
        names: list[str] = []
        group = self._objects[path]
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
        kind, stored = _columns(self._dataset(path).get_type().encode())
        rows = self._read(path, kind, stored)
        return {name: rows[name].astype(np.float64) for name in kind.names or ()}

    def texts(self, path: str) -> Any:
        """A text, or nested lists of texts."""
        kind = self._dataset(path).dtype
        return _decoded(self._read(path, kind, _STRING if kind.kind == "O" else h5t.py_create(kind)).tolist())

    def number(self, path: str, name: str) -> float:
        """An attribute that is a number."""
        value = np.empty(())
        h5a.open(self._objects[path], name.encode()).read(value, mtype=h5t.NATIVE_DOUBLE)
        return float(value)

    def text(self, path: str, name: str, default: str | None = None) -> str:
        """An attribute that is a text."""
        owner = self._objects[path]
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
        found = self._objects[path]
        if not isinstance(found, h5d.DatasetID):
            raise KeyError(path)
        return found


@lru_cache(maxsize=64)  # the types of two tables of the same columns are one
def _columns(encoded: bytes) -> tuple[np.dtype[Any], Any]:
    """A table's rows as numpy and HDF5 have them in memory, from the type in the file."""
    kind = h5t.decode(encoded).dtype
    return kind, h5t.py_create(kind)


def _decoded(values: Any) -> Any:
    if isinstance(values, list):
        return [_decoded(value) for value in values]
    return values.decode("utf-8", "surrogateescape") if isinstance(values, bytes) else str(values)


def _open(path: Path) -> Any:
    try:
        data = read_regular(path, MAX_BYTES)
    except (FileNotFoundError, NotADirectoryError):
        raise StoreError(f"{path}: no such file") from None
    except (UnfitFileError, IsADirectoryError) as error:
        raise StoreError(f"{path}: {error.strerror}; then run again") from None
    image, trailer = data[:-TRAILER_BYTES], data[-TRAILER_BYTES:]
    digest = hashlib.sha256(image).hexdigest().encode()
    if trailer != TRAILER + digest + b"\n":
        raise StoreError(f"{path}: damaged (its SHA-256 does not match); delete it and run again")
    try:
        return h5f.open(b"case.h5", h5f.ACC_RDONLY, fapl=_in_memory(image))
    except OSError as error:
        raise StoreError(f"{path}: not an HDF5 file ({error}); delete it and run again") from error


def _objects(file: Any, path: Path) -> dict[str, Any]:
    """Everything in a file by its path. Raises StoreError for a link, followed by nobody, and for outside data."""
    names: list[bytes] = []

    def see(name: bytes, link: Any) -> bytes | None:
        names.append(name)
        return None if link.type == h5l.TYPE_HARD else name

    linked = file.links.visit(see, info=True)
    if linked is not None:
        name = linked.decode(errors="replace")
        raise StoreError(f"{path}: holds a link (/{name}), which a result file never does")
    objects = {name.decode(errors="replace"): h5o.open(file, name) for name in names}
    whole = sum(_declared(item, path) for item in objects.values() if isinstance(item, h5d.DatasetID))
    if whole > MAX_BYTES:
        raise StoreError(f"{path}: says that it holds {whole} bytes, more than a result file can have")
    for name, item in objects.items():
        # what has a place in the file is not outside it
        if isinstance(item, h5d.DatasetID) and item.get_offset() is None and _is_outside(item):
            raise StoreError(f"{path}: /{name} is stored outside the file, which a result file never does")
    return objects


def _declared(dataset: Any, path: Path) -> int:
    """Bytes that an array takes in memory. Raises StoreError where the file cannot hold as many."""
    size = int(dataset.get_type().get_size())
    for extent in dataset.shape:
        size *= int(extent)
    if size > _MOST_COMPRESSED * dataset.get_storage_size() + _CHUNK_BYTES:
        raise StoreError(
            f"{path}: says that it holds {size} bytes, which are not there; delete it and run again"
        )
    return size


def _is_outside(dataset: Any) -> bool:
    stored = dataset.get_create_plist()
    return bool(stored.get_external_count() or stored.get_layout() == h5d.VIRTUAL)
