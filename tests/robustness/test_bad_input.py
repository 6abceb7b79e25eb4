"""Everything that a user can get wrong, in one table: one clear line, the right exit code, no traceback.

The command is called in this process, with the workers' tasks done here one after the other, so that a row takes a
fraction of a second. A timeout, memory that runs out and a read-only directory need real processes:
`tests/work/test_pool.py` and `test_memory_limit`.
"""

from __future__ import annotations

import contextlib
import errno
import json
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import pytest

from tests.command import write_study
from tests.in_process import HerePool
from tests.store.test_store import _reseal
from vdmbench import machine
from vdmbench.cli.main import main
from vdmbench.store import run_directory
from vdmbench.study.errors import install_line
from vdmbench.work import run, worker

from .processes import RUN, planned_hash

pytestmark = pytest.mark.usefixtures("read_here")
Prepare = Callable[[Path], Sequence[str | Path]]  # spoils a directory, says what to call


def study(*changes: tuple[str, str], verb: str = "check") -> Prepare:
    """The small study with texts replaced."""

    def prepare(directory: Path) -> Sequence[str | Path]:
        write_study(directory, **{str(place): change for place, change in enumerate(changes)})
        return [verb, "small.toml"]

    return prepare


def of_file(name: str, size: str = "20 mm", content: bytes | None = None) -> Prepare:
    def prepare(directory: Path) -> Sequence[str | Path]:
        if content is not None:
            (directory / name).write_bytes(content)
        shape = ('shape = "sphere"\nradius = "50 mm"', f'shape = "file"\npath = "{name}"')
        return study(shape, ('"16 mm"', f'"{size}"'), verb="run")(directory)

    return prepare


HELD_ONLY = 'kind = "fixed"\nregion = "base"\n[[constraints]]\n'

# what is wrong: how to get there, the exit code, a part of what is said
TABLE: dict[str, tuple[Prepare, int, str]] = {
    "missing file": (lambda _: ["check", "none.toml"], 2, "none.toml:1: does not exist"),
    "unreadable mesh": (of_file("body.vtu", content=b"\x7fELF\0"), 2, "cannot be read as .vtu"),
    "region that selects nothing": (
        study(('[0, 0, 1], angle = "30 deg"', '[3, 1, 9], angle = "0.1 deg"'), verb="run"), 2,
        "region 'finger' selects no node of the mesh",
    ),
    "nothing held": (study((HELD_ONLY, "")), 2, "nothing is held"),
    "reference that cannot be incompressible": (
        study(("fem-linear", "fem-p1"), ("0.49", "0.5")), 2,
        "small.toml:15: tissue.poisson_ratio: fem-p1, the reference, is a displacement element",
    ),
}  # fmt: skip


def _case(directory: Path) -> Path:
    return sorted((directory / RUN / "cases").iterdir())[0]


def _of_a_newer_program(file: h5py.File) -> None:
    file["case"].attrs["schema"] = 99


def _failure_cut(directory: Path) -> None:
    path = run_directory.failure_path(directory / RUN, planned_hash(_case(directory)))
    _case(directory).unlink()
    path.parent.mkdir(exist_ok=True)
    path.write_text("{}")


def _foreign_baseline(directory: Path) -> None:
    """Of a study of another body: nothing can be compared."""
    with pytest.raises(SystemExit):
        main(["accept", str(RUN), "--reason", "a test", "--baseline", "b.json"])
    data = json.loads((directory / "b.json").read_text())
    data["study"] = "another"
    (directory / "b.json").write_text(json.dumps(data))


# what spoils a directory with a run: how, what to call, the exit code, a part of what is said
DAMAGE: dict[str, tuple[Callable[[Path], object], str, int, str]] = {
    "newer schema": (
        lambda d: _reseal(_case(d), _of_a_newer_program), f"report {RUN}", 5,
        "schema 99 is newer than this program's",
    ),
    "no plan": (lambda d: (d / RUN / "plan.json").unlink(), f"report {RUN}", 5, "not a run directory"),
    "damaged plan": (
        lambda d: (d / RUN / "plan.json").write_text('{"study": {'), f"report {RUN}", 5, "plan.json: damaged",
    ),
    "no study text": (
        lambda d: (d / RUN / "study.toml").unlink(), f"report {RUN}", 5, "study.toml: not readable",
    ),
    "damaged failure": (
        _failure_cut, f"report {RUN}", 5, "damaged ('hash' is not there); delete it and run again",
    ),
    "no baseline": (
        lambda _: None, f"gate {RUN}", 6, "no such baseline; make one with: vdmbench accept",
    ),
    "baseline of another study": (_foreign_baseline, f"gate {RUN} --baseline b.json", 2, "another"),
    "newer baseline": (
        lambda d: (d / "b.json").write_text('{"schema": 99}'), f"gate {RUN} --baseline b.json", 2,
        "schema 99 is newer",
    ),
}  # fmt: skip


@contextlib.contextmanager
def in_this_process(*_: Any) -> Iterator[HerePool]:
    """Places without processes."""
    yield HerePool()


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing leaves this process, and no report is drawn."""
    page = ModuleType("vdmbench.report.page")
    monkeypatch.setattr(page, "write_report", lambda _, path: path.touch(), raising=False)
    monkeypatch.setitem(sys.modules, page.__name__, page)
    monkeypatch.setattr(run, "_pool", in_this_process)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.chdir(tmp_path)


def said(arguments: Sequence[str | Path], code: int, capsys: pytest.CaptureFixture[str]) -> str:
    """What a call says, after a look at its exit code and its manners."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    found = capsys.readouterr()
    assert caught.value.code == code, found
    complaints = [line for line in found.err.splitlines() if line.startswith("vdmbench")]
    assert (code == 0) == (complaints == []) or code == 5, "a clear line for each problem"
    assert all(line.isprintable() and len(line) < 1000 for line in complaints)
    if code != 3:  # the log of a failed case, which goes to a file
        assert "Traceback" not in found.out + found.err
    return found.out + found.err


@pytest.mark.parametrize("wrong", TABLE)
def test_a_mistake_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str) -> None:
    prepare, code, words = TABLE[wrong]
    assert words in said(prepare(tmp_path), code, capsys)


@pytest.mark.parametrize("wrong", DAMAGE)
def test_what_is_wrong_with_results_is_told(
    undisturbed: tuple[Path, float], tmp_path: Path, capsys: pytest.CaptureFixture[str], wrong: str
) -> None:
    shutil.copytree(undisturbed[0], tmp_path, dirs_exist_ok=True)
    spoil, command, code, words = DAMAGE[wrong]
    spoil(tmp_path)
    assert words in said(command.split(), code, capsys)


@pytest.mark.parametrize(("extra", "code"), [([], 6), (["--allow-missing"], 0)])
def test_half_a_study_does_not_pass_the_gate(
    undisturbed: tuple[Path, float],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    extra: list[str],
    code: int,
) -> None:
    shutil.copytree(undisturbed[0], tmp_path, dirs_exist_ok=True)
    said(["accept", RUN, "--reason", "a test"], 0, capsys)
    said(["gate", RUN], 0, capsys)
    _case(tmp_path).unlink()
    told = said(["gate", RUN, "--junit", "out.xml", *extra], code, capsys)
    assert "the run has not got to it" in told
    assert ("or let them be by --allow-missing" in told) == (code == 6)
    assert ('failures="1"' in Path("out.xml").read_text()) == (code == 6)


# --- the machine ---


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (
            OSError("libGLU.so.1: cannot open shared object file: No such file or directory"),
            "apt-get install ",
        ),
        (
            ImportError("libXft.so.2: cannot open shared object file"),
            "apt-get install libgomp1 libglu1-mesa ",
        ),
        (
            ModuleNotFoundError("No module named 'skfem'", name="skfem.element"),
            "pip install --constraint constraints.txt scikit-fem",
        ),
    ],
)
def test_a_missing_library_is_told_with_the_line_that_installs_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    line: str,
) -> None:
    def refuse(*_: Any) -> None:
        raise error

    monkeypatch.setattr(run, "run_plan", refuse)
    assert f"vdmbench: {error}; install it: {line}" in said(study(verb="run")(tmp_path), 4, capsys)
    assert worker._outcome(refuse) == ("error", str(error), install_line(error))


def test_a_full_disk_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the run begins; a case that finds the disk full is a failed case."""

    def no_room(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    arguments = study(verb="run")(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(machine.os, "fsync", no_room)
        assert f"{RUN}/study.toml: No space left on device" in said(arguments, 4, capsys)
    assert [path for path in (tmp_path / "results").rglob("*") if path.is_file()] == [
        tmp_path / RUN / ".lock"
    ]
    monkeypatch.setattr("vdmbench.work.case.write_case", no_room)
    told = said(arguments, 3, capsys)
    assert "No space left on device" in told
    assert "; check free space and permissions" in told
