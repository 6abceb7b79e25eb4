"""Twenty small faults, one at a time in a copy: which of them the suite catches. They are in `mutants.toml`.

A fault is looked for by its text, so that it outlives a file that moves. The tests named beside it run,
the likeliest first. It ends with an error where one survives: such a fault needs a test, or was none.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tools.documents import ROOT, rows_shown, show, table
from tools.evidence import EVIDENCE

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
    own = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-B", "-m", "pytest", *options, *tests]
    ended = subprocess.run(command, cwd=place, env={**os.environ, **own}, capture_output=True, text=True)
    if ended.returncode == 0:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", ended.stdout, re.MULTILINE)
    return failed[1] if failed else f"pytest ends with {ended.returncode}: {ended.stderr[-300:]}"


def rewrite(path: Path, text: str) -> None:
    """Change a file; what numba compiled beside it goes, for it does not see what a function calls."""
    path.write_text(text, encoding="utf-8")
    for compiled in path.parent.glob("__pycache__/*.nb?"):
        compiled.unlink()


def mutants(arguments: Sequence[str]) -> None:
    """Try the faults of these numbers, by default all, and write what found each; lines of others stay."""
    document, head = (
        ROOT / EVIDENCE["mutants"]["document"],
        ("file", "what stands there", "fault", "found by"),
    )
    found = {row[1]: row for row in rows_shown(document, "mutants")}
    caught = {}
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for part in COPIED:
            copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
            (place / part).parent.mkdir(parents=True, exist_ok=True)
            copy(ROOT / part, place / part)
        (place / "build" / "typed").mkdir(parents=True)
        (place / "build" / "typed" / "vdmbench").symlink_to("../../studies")
        for number in map(int, arguments or range(1, len(MUTANTS) + 1)):
            mutant = MUTANTS[number - 1]
            path, tests = place_of(mutant, place), tests_of(mutant, place)
            text = path.read_text(encoding="utf-8")
            rewrite(path, text.replace(mutant.old, mutant.new))
            caught[mutant] = first_failure(tests, place)
            rewrite(path, text)
            by = f"`{caught[mutant].rpartition('::')[2]}`" if caught[mutant] else "**nothing**"
            row = [f"`{path.relative_to(place)}`", f"`{mutant.old}`", f"`{mutant.new}`", by]
            print(number, *row, sep=" | ", flush=True)
            found[row[1]] = row
        if broken := first_failure([test for test in caught.values() if test], place):
            sys.exit(f"{broken} fails without a fault: mend it first")
    order = [found[f"`{mutant.old}`"] for mutant in MUTANTS if f"`{mutant.old}`" in found]
    show(document, "mutants", table(head, order))
    survived = sum(not test for test in caught.values())
    sys.exit(f"{survived} survive" if survived else 0)
