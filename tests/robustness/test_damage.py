"""Stored files that were cut, altered or renamed: found, told or made again, never read as good."""

import shutil
from pathlib import Path

import pytest

from tests.in_process import do_cases
from vdmbench.body.mesh_cache import read_mesh
from vdmbench.machine import write_atomically
from vdmbench.store import cases as store
from vdmbench.store.plain import StoreError
from vdmbench.study.config import load_study
from vdmbench.work.cache import read_answer
from vdmbench.work.plan import make_plan

from .processes import CACHE, RUN, assert_same_results, planned_hash

KINDS = {
    "case": f"{RUN}/cases/*.vtkhdf",
    "mesh": f"{CACHE}/meshes/*.npz",
    "answer": f"{CACHE}/answers/*.npz",
}


@pytest.fixture
def copy(undisturbed: tuple[Path, float], tmp_path: Path) -> Path:
    """A finished directory, to be broken."""
    return Path(shutil.copytree(undisturbed[0], tmp_path / "copy"))


def _reads(kind: str, path: Path) -> bool:
    """Whether a file is read as good. A damaged result is told, what is missing from a cache is None."""
    if kind == "mesh":
        return read_mesh(path) is not None
    if kind == "answer":
        return read_answer(path) is not None
    try:
        store.read_case(path, planned_hash(path))
    except StoreError as error:
        return str(path) not in str(error)
    return True


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_cut_altered_or_renamed_is_found_wherever_it_is(copy: Path, kind: str) -> None:
    path = sorted(copy.glob(KINDS[kind]))[0]
    whole = path.read_bytes()
    assert _reads(kind, path), "it is sound to begin with"
    places = [*range(8), *range(0, len(whole), 1024), *range(len(whole) - 100, len(whole))]
    for place in places:
        path.write_bytes(whole[:place])
        assert not _reads(kind, path), f"cut after {place} of {len(whole)} bytes"
        broken = bytearray(whole)
        broken[place] ^= 1 << place % 8
        path.write_bytes(broken)
        assert not _reads(kind, path), f"bit flipped in byte {place} of {len(whole)}"
    path.write_bytes(whole + b"\0")
    assert not _reads(kind, path), "one byte too many"
    path.write_bytes(whole)
    assert not _reads(kind, path.rename(path.with_name("0" * 64 + path.suffix))), "under another's name"


def test_what_is_damaged_is_made_again(copy: Path, undisturbed: tuple[Path, float]) -> None:
    """Case, mesh and answers at once, some cut, some exchanged for others of their kind."""
    files = {kind: sorted(copy.glob(pattern)) for kind, pattern in KINDS.items()}
    for number, (kind, paths) in enumerate(files.items()):
        for path in paths[1:]:
            shutil.copy(paths[0], path)
        paths[0].write_bytes(paths[0].read_bytes()[: 2000 + number])
        assert not any(_reads(kind, path) for path in paths)
    study = load_study(copy / "small.toml")
    do_cases(make_plan(study, copy / RUN, copy / CACHE))
    assert_same_results(copy / RUN, undisturbed[0] / RUN)
    assert all(_reads(kind, path) for kind, paths in files.items() for path in paths)


def test_a_directory_in_a_file_s_place_is_told_and_kept(tmp_path: Path) -> None:
    (tmp_path / "file" / "x").mkdir(parents=True)
    with pytest.raises(IsADirectoryError, match="a directory is in a file's place; remove it"):
        write_atomically(tmp_path / "file", b"1")
    assert (tmp_path / "file" / "x").exists()
