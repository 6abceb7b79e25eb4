"""Files, locks and memory of this machine. In: paths and limits. Out: complete files, sealed arrays, memory limits.
It knows nothing of studies.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import errno
import fcntl
import hashlib
import io
import json
import math
import os
import platform
import resource
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Container, Iterator, Mapping
from pathlib import Path
from typing import Any

_PART = ".part"  # ends the names of files being written, which nothing reads
_LONGEST = 200  # characters of a name that its temporary file repeats: file systems take 255 bytes
_LEAST_MEMORY = 3_000_000_000  # B of a shell's limit: the solvers' libraries and their buffers
_DIGEST_BYTES = 32  # a SHA-256 ends a file of arrays; readers of .npz do not mind it
_FORMAT = b"\1"  # part of that: files of another layout are made again
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_CONTAINER = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # versions 2 and 1
_PROCESSORS = Path("/proc/cpuinfo")


# --- files ---


def results_directory() -> Path:
    """Default directory of runs, cache and baselines."""
    return Path(os.environ.get("VDMBENCH_RESULTS") or "results")


def cache_directory() -> Path:
    """Default directory of meshes and answers."""
    return Path(os.environ.get("VDMBENCH_CACHE") or results_directory() / "cache")


def json_text(value: Any, *, indent: int | None = None) -> str:
    """JSON that every program reads: null stands for a number that is not finite."""
    return json.dumps(plain(value), indent=indent, allow_nan=False)


def plain(value: Any, without: Container[str] = ()) -> Any:
    """A value as JSON types; a dataclass gives all fields except some. `vdmbench.store.plain` reads it back."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if dataclasses.is_dataclass(value):
        names = (field.name for field in dataclasses.fields(value) if field.name not in without)
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "model_dump"):  # pydantic, which is not loaded for this
        return value.model_dump(mode="json", exclude_none=True)
    return plain(value.tolist()) if hasattr(value, "tolist") else value  # NumPy, likewise


def write_atomically(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Write `data` so that `path` is absent, unchanged or complete, even after a crash.

    Parameters
    ----------
    durable : wait for the disk; without it a power failure, but no killed program, may truncate the file

    Raises
    ------
    OSError
        disk full or read-only, or a directory of that name; it names `path`, and no file is left behind. A link
        of that name is replaced, not followed, unless it leads to a device or a pipe, which are written to.
    """
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "a directory is in a file's place; remove it", str(path))
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return None
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name[:_LONGEST]}.{secrets.token_hex(8)}{_PART}")
    try:
        with part.open("xb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until it has its final name, see `clear_abandoned`
            if not os.fstat(file.fileno()).st_nlink:  # cleared away before it was locked
                return write_atomically(path, data, durable=durable)
            file.write(data)
            file.flush()
            if durable:
                os.fsync(file.fileno())
            part.replace(path)
    except BaseException as error:
        part.unlink(missing_ok=True)
        if isinstance(error, OSError):  # a write error names no file, others name the temporary one
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def clear_abandoned(directory: Path, suffix: str = _PART) -> None:
    """Remove the hidden files with this suffix of killed processes: locks end with their process."""
    for path in directory.glob(f".*{suffix}"):
        with contextlib.suppress(OSError), path.open("rb") as file:  # gone meanwhile, in use, or not ours
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


@contextlib.contextmanager
def whole_directory(out: Path) -> Iterator[Path]:
    """A hidden directory beside `out` to write in; it replaces `out` at the end, and is removed after an error.

    `out` is new or empty. Raises OSError.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    begun = Path(tempfile.mkdtemp(prefix=f".{out.name[:_LONGEST]}.", suffix=_PART, dir=out.absolute().parent))
    try:
        begun.chmod(0o755)
        yield begun
        if out.exists():
            out.rmdir()
        begun.rename(out)
    except BaseException:
        shutil.rmtree(begun, ignore_errors=True)
        raise


def require_end(path: Path, end: bytes) -> None:
    """Raise OSError if a file that a library wrote does not end with `end`: a full disk or a limit truncated it."""
    if not path.read_bytes()[-100:].rstrip().endswith(end):
        raise OSError(errno.EFBIG, "is cut: the disk is full, or a limit of file size is reached", str(path))


class LockedError(ValueError):
    """Another process holds the lock; the message names it, as "process 12"."""


@contextlib.contextmanager
def lock(path: Path, *, shared: bool = False, wait: bool = False) -> Iterator[None]:
    """Hold the lock of a file, and write the holder into the file; the lock ends with the process.

    Raises
    ------
    LockedError
        another process holds it, without `wait`.
    OSError
        the file cannot be opened or written; it names `path`.
    """
    with path.open("ab+", buffering=0) as file:
        try:
            kind = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
            fcntl.flock(file, kind if wait else kind | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            number = file.read(20).decode(errors="replace").strip()
            raise LockedError(f"process {number}" if number.isdecimal() else "an unknown process") from None
        try:
            file.truncate(0)
            file.write(b"%d" % os.getpid())
        except OSError as error:  # a write names no file
            raise OSError(error.errno, error.strerror, str(path)) from error
        yield


# --- arrays with a seal that covers the file's name too, which is its content key ---


def packed(value: Any = None, **parts: Any) -> bytes:
    """The fields of a dataclass and further values as the bytes of an .npz file, for `unpacked`.

    Values are arrays, mappings of arrays by name, and JSON types.
    """
    import numpy as np

    named = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)} if value else {}
    arrays: dict[str, Any] = {}
    about: dict[str, Any] = {}
    for name, part in (named | parts).items():
        if isinstance(part, np.ndarray):
            arrays[name] = part
        elif part and isinstance(part, Mapping) and all(isinstance(one, np.ndarray) for one in part.values()):
            arrays |= {f"{name}/{key}": one for key, one in part.items()}
        else:
            about[name] = part
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, about=np.array(json_text(about)), **arrays)
    return buffer.getvalue()


def unpacked(content: bytes) -> dict[str, Any]:
    """The values given to `packed`, by name, and the fields of its dataclass."""
    import numpy as np

    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        found: dict[str, Any] = json.loads(str(stored["about"]))
        for name in stored:
            outer, inside, key = name.partition("/")
            if inside:
                found.setdefault(outer, {})[key] = stored[name]
            elif name != "about":
                found[name] = stored[name]
    return found


def write_arrays(path: Path, value: Any = None, **parts: Any) -> None:
    """Store what `packed` takes, whole or not at all. Raises OSError."""
    content = packed(value, **parts)
    # many small files, checked by their seals and remade if truncated: none is worth a wait for the disk
    write_atomically(path, content + _seal(path, content), durable=False)


def read_arrays(path: Path) -> dict[str, Any] | None:
    """The arrays stored at `path`; None if there is no file, or a damaged or foreign one.

    Raises
    ------
    OSError
        the file may not be read.
    """
    content = _content(path)
    return None if content is None else unpacked(content)


def is_sound(path: Path) -> bool:
    """Whether `read_arrays` finds arrays at `path`. Raises OSError where the file may not be read."""
    return _content(path) is not None


def _content(path: Path) -> bytes | None:
    try:
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        return None  # whatever is in its place is reported when it is written
    content, seal = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content if _seal(path, content) == seal else None


def _seal(path: Path, content: bytes) -> bytes:
    return hashlib.sha256(path.name.encode() + _FORMAT + content).digest()


# --- processors and memory ---


def usable_processors() -> int:
    """Number of processors of this process: a batch system or `taskset` may allow fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def processor_share() -> Callable[[], float]:
    """Tells what share of the time since this call the processor spent on this process, at most 1."""
    began, worked = time.perf_counter(), time.process_time()
    return lambda: min(1.0, (time.process_time() - worked) / max(time.perf_counter() - began, 1e-9))


def processor_name() -> str:
    """The machine's name of its processors, or "unknown"."""
    try:
        lines = _PROCESSORS.read_text().splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def machine_memory() -> int:
    """Bytes of memory of this machine, or of its container if that is less."""
    sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for name in _CONTAINER:
        with contextlib.suppress(OSError, ValueError):  # not there, or "max"
            sizes.append(int(Path(name).read_text()))
    return min(sizes)


def require_memory() -> None:
    """Raise MemoryError if a limit of the shell or batch system is too low to load the solvers.

    Without memory for its buffers, numpy's OpenBLAS would retry forever.
    """
    for letter, kind in (("v", resource.RLIMIT_AS), ("d", resource.RLIMIT_DATA)):
        limit = resource.getrlimit(kind)[0]
        if limit != resource.RLIM_INFINITY:
            os.environ["OPENBLAS_NUM_THREADS"] = "1"  # each further one takes a buffer
            if limit < _LEAST_MEMORY:
                allowed = f"ulimit -{letter} {limit // 1024}"
                raise MemoryError(
                    f"too little memory for the solvers: {allowed}; allow 3 GB or more, or no limit"
                )


def limit_memory(size: int) -> None:
    """Limit this process to `size` further bytes for the rest of its life; then allocations fail.

    Private data counts (RLIMIT_DATA), touched or not; only Linux has such a limit. Dense algebra then has one
    thread, with its work memory allocated before: without that memory OpenBLAS would retry forever
    (blas_memory_alloc in its driver/others/memory.c).
    """
    if not _STATUS.exists():
        return
    import numpy as np
    from scipy.linalg import lu_factor
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    np.linalg.solve(np.eye(2), np.eye(2))
    lu_factor(np.eye(2))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = _status("VmData") + size
    limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def reset_peak() -> int:
    """Reset the peak memory; returns the resident bytes now, for `peak_bytes_since`.

    First the allocator returns freed memory to the system, so that it counts when it is used again.
    """
    with contextlib.suppress(OSError, AttributeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
    try:
        _CLEAR.write_text("5")  # resets VmHWM (proc(5))
    except OSError:
        return 0
    return _status("VmRSS")


def peak_bytes_since(baseline: int) -> int:
    """Peak resident memory since `reset_peak`, in addition to the memory at that time [B].

    Where the peak cannot be reset (another system than Linux) it is that of the whole process.
    """
    peak = _status("VmHWM") if _STATUS.exists() else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return max(0, peak - baseline)


def _status(field: str) -> int:
    for line in _STATUS.read_text().splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) * 1024
    return 0
