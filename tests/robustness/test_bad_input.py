"""What is wrong with results or with the machine: one clear line, the right exit code, no traceback.

Mistakes of a study are in `tests/study/mistakes.toml`. A timeout, memory that runs out and a read-only directory
need real processes: `tests/work/test_pool.py` and `test_memory_limit`.
"""

import errno
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.command import vdmbench, write_study
from vdmbench import machine
from vdmbench.cli.arguments import verbs
from vdmbench.cli.main import _complain_of
from vdmbench.store import run_directory
from vdmbench.store.plain import OlderSchemaError, StoreError
from vdmbench.study.errors import InputError, Problem, StudyError, install_line
from vdmbench.work import run, worker

from .processes import RUN, planned_hash

pytestmark = pytest.mark.usefixtures("read_here")


def _case(directory: Path) -> Path:
    return sorted((directory / RUN / "cases").iterdir())[0]


def _failure_cut(directory: Path) -> None:
    path = run_directory.failure_path(directory / RUN, planned_hash(_case(directory)))
    _case(directory).unlink()
    path.parent.mkdir(exist_ok=True)
    path.write_text("{}")


# what spoils a directory with a run, and a part of what `report` then says
DAMAGE: list[tuple[Callable[[Path], object], str]] = [
    (lambda d: (d / RUN / "plan.json").unlink(), "not a run directory"),
    (lambda d: (d / RUN / "study.toml").unlink(), "study.toml: not readable"),
    (_failure_cut, "damaged ('hash' is not there); delete it and run again"),
]


def said(*arguments: str | Path, code: int, cwd: Path) -> str:
    """What a call says, after a look at its exit code and its manners."""
    result = vdmbench(*arguments, cwd=cwd)
    complaints = [line for line in result.stderr.splitlines() if line.startswith("vdmbench")]
    assert result.returncode == code, result
    assert (code == 0) == (complaints == []) or code == 5, "a clear line for each problem"
    assert all(line.isprintable() and len(line) < 1000 for line in complaints)
    return result.stdout + result.stderr


@pytest.mark.parametrize(("spoil", "words"), DAMAGE)
def test_what_is_wrong_with_results_is_told(
    undisturbed: tuple[Path, float], tmp_path: Path, spoil: Callable[[Path], object], words: str
) -> None:
    shutil.copytree(undisturbed[0], tmp_path, dirs_exist_ok=True)
    spoil(tmp_path)
    assert words in said("report", RUN, code=5, cwd=tmp_path)


# --- the machine ---


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (OSError("libGLU.so.1: cannot open shared object file"), "apt-get install libgomp1 libglu1-mesa "),
        (
            ModuleNotFoundError("No module named 'skfem'", name="skfem.element"),
            "pip install --constraint constraints.txt scikit-fem",
        ),
    ],
)
def test_a_missing_library_is_told_with_the_line_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, line: str
) -> None:
    def refuse(*_: Any) -> None:
        raise error

    write_study(tmp_path)
    monkeypatch.setattr(run, "run_plan", refuse)
    told = said("run", "small.toml", code=4, cwd=tmp_path)
    assert f"vdmbench: {error}; install it: {line}" in told
    assert worker._outcome(refuse) == ("error", str(error), install_line(error))


def test_a_full_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the run begins; a case that finds the disk full is a failed case."""

    def no_room(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    write_study(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(machine.os, "fsync", no_room)
        told = said("run", "small.toml", code=4, cwd=tmp_path)
        assert f"{RUN}/study.toml: No space left on device" in told
    left = [path for path in (tmp_path / "results").rglob("*") if path.is_file()]
    assert left == [tmp_path / RUN / ".lock"]
    monkeypatch.setattr("vdmbench.work.case.write_case", no_room)
    told = said("run", "small.toml", code=3, cwd=tmp_path)
    assert "No space left on device; check free space and permissions" in " ".join(told.split())


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (ImportError("no such library"), 4, ["no such library"]),
        (FileExistsError(17, "File exists", "x"), 4, ["x: is not a directory; remove it, or choose another"]),
        (OSError(28, "No space left on device", "x"), 4, ["x: No space left on device"]),
        (OSError(28, "No space left on device"), 4, ["No space left on device"]),
        (OSError("it is too late"), 4, ["it is too late"]),
        (StoreError("x.h5 is damaged"), 5, ["x.h5 is damaged"]),
        (OlderSchemaError("x.h5 is old"), 5, ["x.h5 is old"]),
        (InputError("no such thing"), 2, ["no such thing"]),
        (
            StudyError(Problem("s.toml", line, "a.b", "is bad") for line in (3, 5)),
            2,
            ["s.toml:3: a.b: is bad", "s.toml:5: a.b: is bad"],
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_an_error_means_to_the_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int, said: list[str]
) -> None:
    def verb(_: object) -> int:
        raise error

    monkeypatch.setitem(verbs(), "list", verbs()["list"]._replace(do=verb))
    result = vdmbench("list", cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.splitlines() == [f"vdmbench: {line}" for line in said]


def test_a_bug_is_told_from_a_regression(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError) as caught:
        {}["on mine"]
    assert _complain_of(caught.value) == 70
    *trace, told = capsys.readouterr().err.splitlines()
    assert told == "vdmbench: this is a bug: KeyError('on mine'); please report it with the lines above"
    assert trace[0].startswith("Traceback")
