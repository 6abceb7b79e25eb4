"""Twenty small faults, one at a time in a copy: which of them the suite catches. They are in `mutants.toml`.

A fault is looked for by its text, so that it outlives a file that moves. The tests named beside it run,
the likeliest first. It ends with an error where one survives: such a fault needs a test, or was none.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tools.documents import ROOT

COPIED = (
    *("vdm", "fem_reference", "solver_common", "studies", "tests", "tools", "docs"),
    *("results/baselines", "pyproject.toml"),
)


class Mutant(NamedTuple):
    """`old`, which stands once in the folder `where`, becomes `new`; `tests` are patterns of files below tests/."""

    where: str
    old: str
    new: str
    tests: str


MUTANTS = tuple(
    Mutant(*row) for row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text())["mutants"]
)


def place_of(mutant: Mutant, root: Path) -> Path:
    """The file with the text. Raises ValueError where it is not there once."""
    start = root / mutant.where
    files = [start] if start.is_file() else sorted(start.rglob("*.py"))
    found = [(path, path.read_text(encoding="utf-8").count(mutant.old)) for path in files]
    hits = [(path, count) for path, count in found if count]
    if [count for _, count in hits] != [1]:
        raise ValueError(
            f"{mutant.where}: {mutant.old!r} stands there {sum(count for _, count in hits)} times"
        )
    return hits[0][0]


def tests_of(mutant: Mutant, root: Path) -> list[str]:
    """The test files of a fault, the likeliest first. Raises ValueError where there are none."""
    found = [
        path
        for pattern in mutant.tests.split()
        for path in sorted((root / "tests").rglob("test_*.py"))
        if path.relative_to(root / "tests").match(pattern)
    ]
    if not found:
        raise ValueError(f"{mutant.where}: no tests are {mutant.tests}")
    return [str(path.relative_to(root)) for path in dict.fromkeys(found)]


def first_failure(tests: Sequence[str], place: Path) -> str:
    """The first of the tests of a copy that fails, and nothing where all pass."""
    options = ("-q", "-x", "-m", "not slow", "-p", "no:cacheprovider", "--basetemp", str(place / "tmp"))
    path = os.pathsep.join((str(place / "build" / "typed"), str(place)))
    own = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(place / "numba")}
    command = [sys.executable, "-B", "-m", "pytest", *options, *tests]
    ended = subprocess.run(command, cwd=place, env={**os.environ, **own}, capture_output=True, text=True)
    if ended.returncode == 0:
        return ""
    words = [line.split()[1] for line in ended.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return words[0] if words else f"pytest ends with {ended.returncode}: {ended.stderr[-300:]}"


def main(_: str, arguments: Sequence[str]) -> None:
    """Try the faults of these numbers, by default all."""
    survived, clean = 0, set[str]()
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        for part in COPIED:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
            (place / part).parent.mkdir(parents=True, exist_ok=True)
            copy(ROOT / part, place / part)
        (place / "build" / "typed").mkdir(parents=True)
        (place / "build" / "typed" / "vdmbench").symlink_to("../../studies")
        for number in map(int, arguments or range(1, len(MUTANTS) + 1)):
            mutant = MUTANTS[number - 1]
            path, tests = place_of(mutant, place), tests_of(mutant, place)
            untried = [test for test in tests if test not in clean]
            if untried and (broken := first_failure(untried, place)):
                sys.exit(f"{broken} fails without a fault: mend it first")
            clean.update(untried)
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace(mutant.old, mutant.new), encoding="utf-8")
            caught = first_failure(tests, place)
            path.write_text(text, encoding="utf-8")
            survived += not caught
            print(
                number,
                path.relative_to(place),
                mutant.old,
                "->",
                mutant.new,
                caught or "SURVIVES",
                flush=True,
            )
    sys.exit(f"{survived} survive" if survived else 0)
