"""Stored files are regular files under their own name, and new ones have the permissions that the umask leaves."""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from vdmbench.machine.files import clear_abandoned, write_atomically
from vdmbench.machine.locks import lock
from vdmbench.machine.safe_open import UnfitFileError, open_regular, read_regular
from vdmbench.machine.sealed import read_arrays, write_arrays
from vdmbench.store.cases import case_state, read_run
from vdmbench.store.hdf5 import Stored, StoreError
from vdmbench.store.run_directory import case_path, read_plan, refuse_linked

OTHERS: dict[str, Callable[[Path], object]] = {
    "a link": lambda path: path.symlink_to(path.parent / "other"),
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a FIFO": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.fixture(autouse=True)
def other(tmp_path: Path) -> Iterator[Path]:
    """A file that is none of ours."""
    path = tmp_path / "other"
    path.write_text("secret")
    yield path
    assert path.read_text() == "secret"


@pytest.mark.parametrize("what", OTHERS)
@pytest.mark.parametrize("flags", [os.O_RDONLY, os.O_RDWR | os.O_CREAT])
def test_only_regular_files_are_opened(tmp_path: Path, what: str, flags: int) -> None:
    path = tmp_path / "stored"
    OTHERS[what](path)
    with pytest.raises(UnfitFileError, match="is in a file's place; remove it") as caught:
        os.close(open_regular(path, flags))
    assert caught.value.filename == str(path)


def test_a_second_name_is_not_written_to(tmp_path: Path, other: Path) -> None:
    os.link(other, tmp_path / ".lock")
    with pytest.raises(UnfitFileError, match="second name"):
        os.close(open_regular(tmp_path / ".lock", os.O_RDWR | os.O_CREAT))
    assert read_regular(tmp_path / ".lock") == b"secret", "reading does no harm"


def test_a_file_beyond_the_bound_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "stored"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    with pytest.raises(UnfitFileError, match="has 5 bytes, more than the 4"):
        read_regular(path, 4)


@pytest.mark.parametrize("what", OTHERS)
@pytest.mark.parametrize("name", [".lock", ".lock-report"])
def test_a_lock_is_no_way_to_another_s_file(tmp_path: Path, what: str, name: str) -> None:
    OTHERS[what](tmp_path / name)
    with pytest.raises(UnfitFileError), lock(tmp_path / name, fcntl.LOCK_EX):
        pass


@pytest.mark.parametrize("what", OTHERS)
def test_nothing_else_is_read_as_a_stored_file(tmp_path: Path, what: str) -> None:
    for name in ("plan.json", "cases", "x.npz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
    OTHERS[what](tmp_path / "plan.json")
    for read in (read_plan, read_run):
        with pytest.raises(StoreError, match=r"plan\.json"):
            read(tmp_path)
    OTHERS[what](tmp_path / "x.npz")
    assert read_arrays(tmp_path / "x.npz") is None
    path = case_path(tmp_path, "ab" * 32)
    path.parent.mkdir()
    (path.parent / "other").write_text("secret")
    OTHERS[what](path)
    assert case_state(tmp_path, "ab" * 32) == "damaged"
    with pytest.raises(StoreError, match="is in a file's place; remove it; then run again"):
        Stored(path, 3)


def test_a_write_replaces_a_link_and_refuses_what_is_no_file(tmp_path: Path, other: Path) -> None:
    path = tmp_path / "stored"
    for what in ("a link", "a link to nothing"):
        OTHERS[what](path)
        write_atomically(path, b"mine")
        assert (path.read_bytes(), path.is_symlink()) == (b"mine", False)
        path.unlink()
    for what in ("a FIFO", "a device"):
        OTHERS[what](path)
        with pytest.raises(UnfitFileError):
            write_atomically(path, b"mine")
        path.unlink()
    assert sorted(tmp_path.iterdir()) == [other]


def test_clearing_away_removes_a_link_not_what_it_leads_to(tmp_path: Path, other: Path) -> None:
    (tmp_path / ".x.part").symlink_to(other)
    clear_abandoned(tmp_path)
    assert sorted(tmp_path.iterdir()) == [other]


@pytest.mark.parametrize("mask", [0o077, 0o002, 0o022, 0o027])
def test_new_files_have_the_permissions_that_the_umask_leaves(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        write_atomically(tmp_path / "made" / "stored", b"")
        with lock(tmp_path / ".lock", fcntl.LOCK_EX):
            pass
    finally:
        os.umask(before)
    for name, most in (("made", 0o777), ("made/stored", 0o666), (".lock", 0o666)):
        assert stat.S_IMODE((tmp_path / name).stat().st_mode) == most & ~mask, name


def test_devices_are_refused() -> None:
    with pytest.raises(UnfitFileError, match="a device or the like is in a file's place"):
        read_regular(Path("/dev/zero"))


@pytest.mark.parametrize("folder", ["cases", "failed"])
def test_a_folder_of_a_run_that_is_a_link_is_refused(tmp_path: Path, folder: str) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / folder).symlink_to("elsewhere")
    with pytest.raises(StoreError, match=f"{folder}: is a link"):
        refuse_linked(tmp_path)


def test_the_cache_does_not_wait_for_the_disk_and_results_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[int] = []
    monkeypatch.setattr(os, "fsync", waits.append)
    write_arrays(tmp_path / "a.npz", {"a": np.ones(3)})
    assert waits == []
    write_atomically(tmp_path / "b", b"b")
    assert len(waits) == 2, "the file and its directory"
    whole = (tmp_path / "a.npz").read_bytes()
    for end in (0, 10, len(whole) - 1):  # what a loss of power may leave
        (tmp_path / "a.npz").write_bytes(whole[:end])
        assert read_arrays(tmp_path / "a.npz") is None
