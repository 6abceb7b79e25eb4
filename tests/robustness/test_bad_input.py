"""Everything that a user can get wrong, in one table: one clear line, the right exit code, no traceback.

The command is called in this process, with the workers' tasks done here one after the other, so that a row takes a
fraction of a second. A timeout, memory that runs out and a read-only directory need real processes:
`test_command_line` and `test_memory_limit`.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from tests.command import write_study
from tests.in_process import HerePlaces
from tests.unit.test_store import _reseal
from vdmbench.cli import doctor
from vdmbench.cli.main import main
from vdmbench.graph import run, work
from vdmbench.guard.gate import SEALED_AS
from vdmbench.machine import files
from vdmbench.machine.stored_json import sealed
from vdmbench.report import rebuild
from vdmbench.store import run_directory
from vdmbench.store.hdf5 import TRAILER_BYTES

from .processes import RUN, planned_hash

pytestmark = pytest.mark.usefixtures("read_here")
Prepare = Callable[[Path], Sequence[str | Path]]  # spoils a directory, says what to call

CUBE = np.array([[x, y, z] for z in (0, 0.1) for y in (0, 0.1) for x in (0, 0.1)])
FACETS = [
    [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
    [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
]  # fmt: skip


def study(*changes: tuple[str, str], verb: str = "check") -> Prepare:
    """The small study with texts replaced."""

    def prepare(directory: Path) -> Sequence[str | Path]:
        write_study(directory, **{str(place): change for place, change in enumerate(changes)})
        return [verb, "small.toml"]

    return prepare


def sweep(text: str) -> Prepare:
    return study(("[load]", f"[sweep]\n{text}\n[load]"))


def text(content: str | bytes) -> Prepare:
    """A study file with this content."""

    def prepare(directory: Path) -> Sequence[str | Path]:
        (directory / "small.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
        return ["check", "small.toml"]

    return prepare


def with_mark(directory: Path) -> Sequence[str | Path]:
    path = write_study(directory)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    return ["check", "small.toml"]


def obj(points: Any = CUBE, facets: Any = FACETS, size: str = "20 mm") -> Prepare:
    """A study of a surface file."""

    def prepare(directory: Path) -> Sequence[str | Path]:
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in facets]
        (directory / "body.obj").write_text("\n".join(lines) + "\n")
        return of_file("body.obj", size)(directory)

    return prepare


def of_file(name: str, size: str = "20 mm", content: bytes | None = None) -> Prepare:
    def prepare(directory: Path) -> Sequence[str | Path]:
        if content is not None:
            (directory / name).write_bytes(content)
        shape = ('shape = "sphere"\nradius = "50 mm"', f'shape = "file"\npath = "{name}"')
        return study(shape, ('"16 mm"', f'"{size}"'), verb="run")(directory)

    return prepare


def msh(kind: int, width: int) -> bytes:
    """A Gmsh file of one cell."""
    nodes = "\n".join(f"{n + 1} {x} {y} {z}" for n, (x, y, z) in enumerate(CUBE))
    cell = " ".join(str(n + 1) for n in range(width))
    return (
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n{nodes}\n$EndNodes\n"
        f"$Elements\n1\n1 {kind} 2 0 1 {cell}\n$EndElements\n"
    ).encode()


HELD_ONLY = 'kind = "fixed"\nregion = "base"\n[[constraints]]\n'

# what is wrong: how to get there, the exit code, a part of what is said
TABLE: dict[str, tuple[Prepare, int, str]] = {
    "missing file": (lambda _: ["check", "none.toml"], 2, "none.toml:1: does not exist"),
    "missing study": (lambda _: ["run", "sphere"], 2, "no shipped study of that name"),
    "unread parameter": (
        study(("[regions.base]", "[models.'vdm-paper']\nrotation = 'none'\n[regions.base]")), 2,
        'models.vdm-paper.rotation: vdm-paper does not read it; leave it out',
    ),
    "TOML syntax": (text("[study]\nname = = 1"), 2, "small.toml:2: TOML syntax: invalid value"),
    "byte order mark": (with_mark, 0, "small.toml: ok, 1 case"),
    "not UTF-8": (text(b"a = '\xff'"), 2, "is not UTF-8 text; save the file in UTF-8"),
    "unknown key": (study(("mesh_size", "mesh_sice")), 2, 'did you mean "mesh_size"?'),
    "bool as number": (study(("= 0.49", "= true")), 2, "not true or false"),
    "text as number": (study(("= 0.49", '= "soft"')), 2, "tissue.poisson_ratio: "),
    "nan": (study(("= 0.49", "= nan")), 2, "must be a finite number"),
    "inf": (study(("= 0.49", "= -inf")), 2, "must be a finite number"),
    "1e999": (study(('"5 kPa"', "1e999")), 2, "must be a finite number"),
    "nu of -1": (study(("= 0.49", "= -1")), 2, "above -1"),
    "nu above 0.5": (study(("= 0.49", "= 0.51")), 2, "at most 0.5"),
    "E of zero": (study(('"5 kPa"', "0")), 2, "must be positive, not 0"),
    "E below zero": (study(('"5 kPa"', '"-5 kPa"')), 2, "must be positive"),
    "wrong unit": (study(('"5 kPa"', '"5 kg"')), 2, '"kg" is not a unit of a pressure or modulus'),
    "empty sweep axis": (sweep('"tissue.poisson_ratio" = []'), 2, "has no values"),
    "value swept twice": (sweep('"tissue.poisson_ratio" = [0.3, 0.3]'), 2, "is listed 2 times"),
    "axis swept twice": (
        sweep('"tissue.poisson_ratio" = [0.3]\ntissue.poisson_ratio = [0.4]'), 2, "swept twice",
    ),
    "too many cases": (
        sweep('"tissue.poisson_ratio" = { start = 0.1, stop = 0.4, num = 100000 }'), 2,
        "small.toml:32: sweep: makes 100000 cases, more than the 1000 allowed",
    ),
    "5,000 levels": (text("a = " + "[" * 5000 + "]" * 5000), 2, "nested more than 64 levels deep"),
    "5,000 digits": (study(('"5 kPa"', "5" * 5000)), 2, "a number is too long"),
    "name that climbs": (study(('"small"', '"../x"')), 2, "study.name: "),
    "name with a NUL": (study(('"small"', '"a\\u0000b"')), 2, "study.name: "),
    "name with a tag": (study(('"small"', '"<script>"')), 2, "study.name: "),
    "region with a tag": (study(("regions.base", "regions.'<b>'")), 2, "is not a usable"),
    "file outside": (of_file("../body.obj", content=b"v 0 0 0"), 2, "is outside the study's directory"),
    "script as mesh": (of_file("body.geo", content=b'SystemCall "true";'), 2, "geometry.path: "),
    "unreadable mesh": (of_file("body.vtu", content=b"\x7fELF\0"), 2, "cannot be read as .vtu"),
    "empty mesh": (of_file("body.stl", content=b""), 2, "body.stl: is empty"),
    "truncated mesh": (
        of_file("body.msh", content=msh(4, 4)[:-40]), 2, "body.msh: is truncated or has no complete Elements",
    ),
    "no cells": (of_file("body.obj", content=b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), 2, "body.obj: holds no facets"),
    "wrong cell kind": (of_file("body.msh", content=msh(5, 8)), 2, "holds hexahedron cells; only four-node"),
    "open surface": (obj(facets=FACETS[:-1]), 2, "open: 3 edges"),
    "non-manifold surface": (
        obj([*CUBE, *(CUBE + np.array([0.1, 0.1, 0]))], [*FACETS, *(np.array(FACETS) + 8)]), 2, "not manifold",
    ),
    "inverted facets": (obj(facets=np.array(FACETS)[:, ::-1]), 0, "1 done, 0 failed"),
    "duplicate and flat facets": (obj(facets=[*FACETS, FACETS[0], [0, 0, 1]]), 0, "1 done, 0 failed"),
    "orphan nodes": (obj([*CUBE, [9.0, 9.0, 9.0]]), 0, "1 done, 0 failed"),
    "surface without volume": (obj(CUBE * [1, 1, 0]), 2, "body.obj: no facet has an area"),
    "several components": (
        obj([*CUBE, *(CUBE + 0.2)], [*FACETS, *(np.array(FACETS) + 8)]), 2, "2 separate pieces",
    ),
    "point that is no number": (obj([*CUBE[:-1], [0.1, 0.1, np.nan]]), 2, "coordinates that are not finite"),
    "surface in mm": (obj(CUBE * 1000), 2, "mixed-up unit"),
    "mesh size beyond the body": (study(('"16 mm"', '"60 mm"')), 2, "too large for a body"),
    "over the node budget": (study(('"16 mm"', '"0.05 mm"')), 2, "nodes, more than the"),
    "region that selects nothing": (
        study(('[0, 0, 1], angle = "30 deg"', '[3, 1, 9], angle = "0.1 deg"'), verb="run"), 2,
        "region 'finger' selects no node of the mesh",
    ),
    "contact over fixed": (study(('"30 deg"', '"179 deg"'), verb="run"), 2, "nodes that are fixed or constrained"),
    "nothing held": (study((HELD_ONLY, "")), 2, "nothing is held"),
    "reference that cannot be incompressible": (
        study(("fem-linear", "fem-p1"), ("0.49", "0.5")), 2,
        "small.toml:15: tissue.poisson_ratio: fem-p1, the reference, is a displacement element",
    ),
    "the same in a sweep": (
        study(("fem-linear", "fem-p2"), ("[load]", '[sweep]\n"tissue.poisson_ratio" = [0.4, 0.5]\n[load]')), 2,
        "(in the case poisson_ratio = 0.5)",
    ),
    "radius in mm": (study(('"50 mm"', "50")), 2, "geometry.radius: "),
    "E in kPa": (study(('"5 kPa"', "5")), 2, "mixed-up unit"),
    "no convergence": (
        study(("fem-linear", "vdm-vector:nonlinear"), ("0.1 N", "60 N"), ("0.5, 1.0", "1.0"), verb="run"),
        3, "failed: small: vdm-vector:nonlinear: the nonlinear balance was not found, the load step halved",
    ),
    "jobs of none": (lambda _: ["run", "quickstart", "--jobs", "0"], 2, "1 or more"),
    "no such verb": (lambda _: ["fly"], 2, "invalid choice"),
}  # fmt: skip


def _case(directory: Path) -> Path:
    return sorted((directory / RUN / "cases").iterdir())[0]


def _damaged(directory: Path) -> Sequence[str | Path]:
    path = _case(directory)
    path.write_bytes(path.read_bytes()[:-TRAILER_BYTES])
    return ["report", RUN]


def _newer(directory: Path) -> Sequence[str | Path]:
    def edit(file: h5py.File) -> None:
        file["case"].attrs["schema"] = 99

    _reseal(_case(directory), edit)
    return ["report", RUN]


def _plan_lost(directory: Path) -> Sequence[str | Path]:
    (directory / RUN / "plan.json").unlink()
    return ["status", RUN]


def _plan_cut(directory: Path) -> Sequence[str | Path]:
    (directory / RUN / "plan.json").write_text('{"study": {')
    return ["status", RUN]


def _study_lost(directory: Path) -> Sequence[str | Path]:
    (directory / RUN / "study.toml").unlink()
    return ["report", RUN]


def _failure_cut(directory: Path) -> Sequence[str | Path]:
    path = run_directory.failure_path(directory / RUN, planned_hash(_case(directory)))
    _case(directory).unlink()
    path.parent.mkdir(exist_ok=True)
    path.write_text("{}")
    return ["status", RUN]


def _exchanged(directory: Path) -> Sequence[str | Path]:
    first, second = sorted((directory / RUN / "cases").iterdir())[:2]
    shutil.copy(second, first)
    return ["report", RUN]


def _tables_cut(directory: Path) -> Sequence[str | Path]:
    (directory / RUN / "study.h5").write_bytes(b"\x89HDF")
    return ["status", RUN]


def _no_baseline(_: Path) -> Sequence[str | Path]:
    return ["gate", RUN]


def _foreign_baseline(directory: Path) -> Sequence[str | Path]:
    """Of a study of another body: nothing can be compared."""
    with pytest.raises(SystemExit):
        main(["accept", str(RUN), "--reason", "a test", "--baseline", "b.json"])
    data = json.loads((directory / "b.json").read_text())
    data["study"] = "another"
    (directory / "b.json").write_bytes(sealed(data, SEALED_AS))
    return ["gate", RUN, "--baseline", "b.json"]


def _newer_baseline(directory: Path) -> Sequence[str | Path]:
    (directory / "b.json").write_text('{"schema": 99}')
    return ["gate", RUN, "--baseline", "b.json"]


DAMAGE: dict[str, tuple[Prepare, int, str]] = {
    "damaged result": (_damaged, 5, "damaged (its SHA-256 does not match); delete it and run again"),
    "newer schema": (_newer, 5, "schema 99 is newer than this program's"),
    "another case's result": (_exchanged, 5, "it holds another case"),
    "damaged study.h5": (_tables_cut, 5, "damaged: study.h5"),
    "no plan": (_plan_lost, 5, "not a run directory"),
    "damaged plan": (_plan_cut, 5, "plan.json: damaged"),
    "no study text": (_study_lost, 5, "study.toml: not readable"),
    "damaged failure": (_failure_cut, 5, "damaged ('hash': Field required); delete it and run again"),
    "no baseline": (_no_baseline, 6, "no such baseline; make one with: vdmbench accept"),
    "baseline of another study": (_foreign_baseline, 2, "another"),
    "newer baseline": (_newer_baseline, 2, "schema 99 is newer"),
}


@contextlib.contextmanager
def in_this_process(*_: Any) -> Iterator[HerePlaces]:
    """Places without processes."""
    yield HerePlaces()


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing leaves this process, and no report is drawn."""
    page = ModuleType("vdmbench.report.page")
    monkeypatch.setattr(page, "write_report", lambda _, path: path.touch(), raising=False)
    monkeypatch.setitem(sys.modules, page.__name__, page)
    monkeypatch.setattr(run, "_places", in_this_process)
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
    quiet = code == 0 or arguments[0] in ("doctor", "status")  # whose answer is the output
    assert quiet == (complaints == []) or code == 5, "a clear line for each problem"
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
    prepare, code, words = DAMAGE[wrong]
    assert words in said(prepare(tmp_path), code, capsys)


def test_a_run_that_finds_fewer_cases_than_it_made_says_so(
    undisturbed: tuple[Path, float],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(undisturbed[0], tmp_path, dirs_exist_ok=True)
    assert "no longer in" not in said(["run", "small.toml"], 0, capsys)
    whole = rebuild.rebuild

    def without_one(directory: Path, tell: Callable[[str], None]) -> Any:
        _case(tmp_path).unlink()
        return whole(directory, tell)

    monkeypatch.setattr(rebuild, "rebuild", without_one)
    assert "no longer in results/runs/small: 1 case of this run, first " in said(
        ["run", "small.toml"], 3, capsys
    )


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
    assert ("finish the run, or let them be missing by --allow-missing" in told) == (code == 6)
    assert ('failures="1"' in Path("out.xml").read_text()) == (code == 6)


# --- the machine ---


def test_a_missing_library_is_told_with_the_line_that_mends_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def load(name: str | None, *_: Any, **__: Any) -> Any:
        if name == "libGLU.so.1":
            raise OSError("libGLU.so.1: cannot open shared object file: No such file or directory")
        return None

    monkeypatch.setattr(doctor, "ctypes", SimpleNamespace(CDLL=load))
    assert "apt-get install libglu1-mesa\n" in said(["doctor"], 4, capsys)


def test_a_package_that_is_not_there_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: Any) -> None:
        raise ImportError("libXft.so.2: cannot open shared object file")

    monkeypatch.setattr(run, "run_plan", refuse)
    told = said(study(verb="run")(tmp_path), 4, capsys)
    assert "libXft.so.2: cannot open shared object file; see what is missing with: vdmbench doctor" in told


def test_a_full_disk_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the run begins; a case that finds the disk full is a failed case."""

    def no_room(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    arguments = study(verb="run")(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", no_room)
        assert f"{RUN}/study.toml: No space left on device" in said(arguments, 4, capsys)
    assert [path for path in (tmp_path / "results").rglob("*") if path.is_file()] == [
        tmp_path / RUN / ".lock"
    ]
    monkeypatch.setattr(work, "write_case", no_room)
    told = said(arguments, 3, capsys)
    assert "No space left on device" in told
    assert "; check free space and permissions" in told


def test_a_directory_where_another_run_is_at_work_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / RUN).mkdir(parents=True)
    with (tmp_path / RUN / ".lock").open("a+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert "another run is at work here" in said(study(verb="run")(tmp_path), 2, capsys)
