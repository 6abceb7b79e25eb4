"""Memory against arrays of known size; processors; files that are whole, and locks."""

import os
import resource
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vdmbench import machine
from vdmbench.machine import (
    LockedError,
    clear_abandoned,
    lock,
    peak_bytes_since,
    read_arrays,
    reset_peak,
    write_arrays,
    write_atomically,
)


@pytest.mark.parametrize("megabytes", [20, 80])
def test_a_peak_that_is_freed_again_counts(megabytes: int) -> None:
    small = [np.ones(1000) for _ in range(1000)]
    del small  # what was freed before must neither count nor hide what comes
    resident = reset_peak()
    array = np.ones(megabytes * 125_000)
    del array
    # the interpreter itself takes and gives back some pages meanwhile
    assert 0.9 * megabytes < peak_bytes_since(resident) / 1e6 < 1.2 * megabytes + 2


_RESERVES = """
import mmap, resource
import numpy as np
from scipy.sparse import csc_array, diags_array, eye_array, kron, tril
from fem_reference.factorisation import Analysis
from fem_reference.memory import _data_bytes, reserved_not_counted
from vdmbench.machine import limit_memory

def room():
    return resource.getrlimit(resource.RLIMIT_DATA)[0] - _data_bytes()

def taken(megabytes):
    try:
        return bool(np.ones(megabytes * 125_000).all())
    except MemoryError:
        return False

def reserve():
    return mmap.mmap(-1, 1 << 30, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)

line, one = diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(20, 20)), eye_array(20)
cube = kron(kron(line, one), one) + kron(kron(one, line), one) + kron(kron(one, one), line)
limit_memory(8_000_000_000)
before = room()
kept = Analysis(csc_array(tril(cube)))
print(before - room())

limit_memory(300_000_000)
try:
    reserve()
except OSError:
    print("refused")
for _ in range(2):
    with reserved_not_counted():
        more = reserve()
    print(taken(200), taken(400))
"""


def test_what_is_reserved_and_not_used_does_not_count_against_the_limit() -> None:
    """The library of sparse factors reserves a gigabyte and more for the stacks of its threads."""
    done = subprocess.run([sys.executable, "-c", _RESERVES], capture_output=True, text=True, check=True)
    of_analysis, *others = done.stdout.splitlines()
    assert int(of_analysis) < 50e6
    assert others == ["refused", "True False", "True False"]


_MULTIPLIES = """
import numpy as np
from scipy.linalg import lu_factor, solve_triangular
from threadpoolctl import threadpool_limits
from vdmbench.machine import limit_memory

limit_memory(10_000_000)
with threadpool_limits(1):
    square = np.eye(200) + 0.1
    print(float((square @ square)[0, 1]))
    print(float(solve_triangular(square, np.triu(square))[1, 1]), lu_factor(square)[0].shape)
try:
    np.ones(10**7)
except MemoryError:
    print("no more")
"""


@pytest.mark.parametrize("threads", ["1", "4"])
def test_dense_algebra_does_not_wait_for_memory_that_it_may_not_have(threads: str) -> None:
    """OpenBLAS, refused its working memory, asks again for ever."""
    surroundings = os.environ | {"OPENBLAS_NUM_THREADS": threads, "OMP_NUM_THREADS": threads}
    done = subprocess.run(
        [sys.executable, "-c", _MULTIPLIES],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env=surroundings,
    )
    product, triangle, rest = done.stdout.split("\n", 2)
    np.testing.assert_allclose(float(product), 2 * 0.1 + 200 * 0.1**2, rtol=1e-12, atol=0)
    assert (triangle, rest) == ("1.0 (200, 200)", "no more\n")


def test_what_a_batch_system_leaves_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {5, 9, 11})
    assert machine.usable_processors() == 3
    monkeypatch.delattr(os, "sched_getaffinity")  # as on other systems than Linux
    assert machine.usable_processors() == 64


def test_a_container_s_memory_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(machine, "_CONTAINER", (str(limit), str(tmp_path / "none")))
    whole = machine.machine_memory()
    assert whole > 100e6
    limit.write_text("max\n")
    assert machine.machine_memory() == whole
    limit.write_text("50000000\n")
    assert machine.machine_memory() == 50_000_000


def test_a_lock_names_its_holder_and_goes_with_it(tmp_path: Path) -> None:
    place = tmp_path / "lock"
    with lock(place):
        for shared in (False, True):
            with pytest.raises(LockedError, match=f"^process {os.getpid()}$"), lock(place, shared=shared):
                pass
    with lock(place, shared=True), lock(place, shared=True), pytest.raises(LockedError), lock(place):
        pass


def test_a_lock_on_a_full_disk_names_its_file(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        with pytest.raises(OSError, match=r"File too large: '.*/lock'"), lock(tmp_path / "lock"):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_the_cache_does_not_wait_for_the_disk_and_results_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[int] = []
    monkeypatch.setattr(os, "fsync", waits.append)
    write_arrays(tmp_path / "a.npz", a=np.ones(3))
    assert waits == []
    write_atomically(tmp_path / "b", b"b")
    assert len(waits) == 1
    whole = (tmp_path / "a.npz").read_bytes()
    for end in (0, 10, len(whole) - 1):  # what a loss of power may leave
        (tmp_path / "a.npz").write_bytes(whole[:end])
        assert read_arrays(tmp_path / "a.npz") is None


def test_a_write_replaces_a_link_and_leaves_what_it_leads_to(tmp_path: Path) -> None:
    (tmp_path / "other").write_text("theirs")
    path = tmp_path / "stored"
    path.symlink_to("other")
    before = os.umask(0o027)
    try:
        write_atomically(path, b"mine")
    finally:
        os.umask(before)
    assert (path.read_bytes(), path.is_symlink()) == (b"mine", False)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert (tmp_path / "other").read_text() == "theirs"


def test_what_a_killed_process_left_is_cleared_and_what_is_being_written_is_not(tmp_path: Path) -> None:
    (tmp_path / ".left.ab.part").write_bytes(b"half")
    (tmp_path / ".alive.cd.part").write_bytes(b"half")
    with lock(tmp_path / ".alive.cd.part"):
        clear_abandoned(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [".alive.cd.part"]


def test_a_device_or_a_pipe_is_written_to_and_stays(tmp_path: Path) -> None:
    """`--out /dev/stdout` of root would else put a file in its place."""
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_atomically(link, b"told")
        assert os.read(reader, 10) == b"told"
    finally:
        os.close(reader)
    assert link.is_symlink()
    assert pipe.is_fifo()
