"""Stored files that were cut, altered, renamed or replaced: found, told or made again, never read as good."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.in_process import outcomes_of
from vdmbench.body.mesh_cache import read_mesh
from vdmbench.store import cases as store
from vdmbench.store.plain import StoreError
from vdmbench.study.config import expand, load_study
from vdmbench.work.cache import read_answer
from vdmbench.work.plan import Plan, make_plan

from .processes import CACHE, RUN, planned_hash

KINDS = {
    "case": f"{RUN}/cases/*.vtkhdf",
    "mesh": f"{CACHE}/meshes/*.npz",
    "answer": f"{CACHE}/answers/*.npz",
}
SEAL = {"case": 82, "mesh": 32, "answer": 32}  # bytes at the end


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


def _one(kind: str, directory: Path) -> Path:
    path = sorted(directory.glob(KINDS[kind]))[0]
    assert _reads(kind, path), "it is sound to begin with"
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_a_cut_is_found_wherever_it_is(copy: Path, kind: str) -> None:
    path = _one(kind, copy)
    whole = path.read_bytes()
    seal = SEAL[kind]
    cuts = {0, 1, seal - 1, seal, seal + 1, len(whole) - seal, len(whole) - 1, *range(0, len(whole), 1024)}
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        assert not _reads(kind, path), f"cut after {cut} of {len(whole)} bytes"
    path.write_bytes(whole + b"\0")
    assert not _reads(kind, path), "one byte too many"
    path.write_bytes(whole)
    assert _reads(kind, path)


@pytest.mark.parametrize("kind", KINDS)
def test_a_flipped_bit_is_found_wherever_it_is(copy: Path, kind: str) -> None:
    path = _one(kind, copy)
    whole = path.read_bytes()
    ends = [*range(8), *range(len(whole) - SEAL[kind], len(whole))]
    for place in [*ends, *range(0, len(whole), 1024)]:
        broken = bytearray(whole)
        broken[place] ^= 1 << place % 8
        path.write_bytes(broken)
        assert not _reads(kind, path), f"bit flipped in byte {place} of {len(whole)}"


@pytest.mark.parametrize("kind", ["case", "mesh", "answer"])
def test_an_entry_under_another_s_name_is_none(copy: Path, kind: str) -> None:
    path = _one(kind, copy)
    assert not _reads(kind, path.rename(path.with_name("0" * 64 + path.suffix)))


def _directory(path: Path) -> None:
    path.mkdir()
    (path / "x").touch()


# --- and the next run? ---


def _plan(directory: Path) -> Plan:
    study = load_study(directory / "small.toml")
    return make_plan(study, expand(study), directory / RUN, directory / CACHE)


def _run(directory: Path) -> int:
    """What the workers of a run do, here; how many cases they did."""
    plan = _plan(directory)
    cases = plan.cases_to_run()
    failed = [said for _, said in outcomes_of(plan) if not said.ok]
    if failed:
        raise OSError(errno.EISDIR, failed[0].message)
    return len(cases)


def _displacements(directory: Path) -> dict[str, Any]:
    found = {}
    for case in _plan(directory).cases:
        stored = store.read_case(store.case_path(directory / RUN, case.hash), case.hash)
        found |= {(case.hash, name): model.displacement for name, model in stored.models.items()}
    return found


DAMAGE: dict[str, Callable[[Path, Path], object]] = {
    "cut": lambda path, _: path.write_bytes(path.read_bytes()[:2000]),
    "exchanged": lambda path, other: shutil.copy(other, path),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_is_damaged_is_made_again(
    copy: Path, undisturbed: tuple[Path, float], tmp_path: Path, damage: str
) -> None:
    """Case, mesh and answers at once; what a link leads to is left as it is."""
    cases, answers = (sorted(copy.glob(KINDS[kind])) for kind in ("case", "answer"))
    foreign = [Path(shutil.copy(path, tmp_path)) for path in (cases[1], answers[1])]
    before = [path.read_bytes() for path in foreign]
    for path in cases[2:]:
        path.unlink()
    DAMAGE[damage](cases[0], foreign[0])
    for path in [*answers, *copy.glob(KINDS["mesh"])]:
        DAMAGE[damage](path, foreign[1])
    assert sum(_reads("answer", path) for path in answers) <= 1, "sound under its own name only"
    assert _run(copy) == 5
    assert [path.read_bytes() for path in foreign] == before
    ours, theirs = _displacements(copy), _displacements(undisturbed[0])
    assert ours.keys() == theirs.keys()
    for key, displacement in theirs.items():
        atol = 1e-12 * float(np.abs(displacement).max())
        assert_allclose(ours[key], displacement, rtol=0, atol=atol, err_msg=str(key))
    assert all(_reads("answer", path) for path in answers)


@pytest.mark.parametrize("kind", ["case", "mesh", "answer"])
def test_a_directory_in_a_file_s_place_is_told_and_kept(copy: Path, kind: str) -> None:
    path = _one(kind, copy)
    for other in copy.glob(KINDS[kind]):  # whichever is come to first
        other.unlink()
        _directory(other)
    if kind != "case":
        shutil.rmtree(copy / RUN)
    with pytest.raises(IsADirectoryError, match="a directory is in a file's place; remove it") as caught:
        _run(copy)
    assert caught.value.errno == errno.EISDIR
    assert (path / "x").exists()
