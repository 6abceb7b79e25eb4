"""The command line: a verb is a function of a file `verb*.py`, registered with its summary and its arguments."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, NamedTuple

from ..study.errors import InputError

_ORDER = (
    *("new", "list", "check", "show", "plan", "run", "calibrate", "report"),
    *("compare", "export", "gate", "accept", "bench", "claims", "schema"),
)
Option = tuple[tuple[str, ...], dict[str, Any]]  # as `add_argument` takes them
Do = Callable[[argparse.Namespace], int]


class Verb(NamedTuple):
    """Summary, arguments and function of a verb."""

    summary: str
    arguments: tuple[Option, ...]
    do: Do


_FOUND: dict[str, Verb] = {}


def verb(name: str, summary: str, *arguments: Option) -> Callable[[Do], Do]:
    """Register a function as a verb: given the arguments it returns the exit code; its docstring is the help."""

    def add(do: Do) -> Do:
        _FOUND[name] = Verb(summary, arguments, do)
        return do

    return add


@cache
def verbs() -> dict[str, Verb]:
    """Every verb of the files `verb*.py` by its name, in the order of the help."""
    for module in iter_modules(import_module(__package__).__path__):
        if module.name.startswith("verb"):
            import_module(f".{module.name}", __package__)
    return {name: _FOUND[name] for name in (*_ORDER, *sorted(_FOUND.keys() - {*_ORDER}))}


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, by default those of the process; `verb` is what to do with them. Exits on a mistake."""
    parser = argparse.ArgumentParser(
        prog="vdmbench",
        description="Compare the Volume Distribution Method with finite elements on the same mesh.",
        epilog="exit codes: 0 ok, 1 accuracy regressed, 2 usage or study file wrong, "
        "3 some cases failed, 4 machine lacks something, 5 stored results damaged, "
        "6 not all was compared, 70 a bug of the program, 130 interrupted",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    subparsers = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for name, verb in verbs().items():
        sub = subparsers.add_parser(name, help=verb.summary, description=verb.do.__doc__)
        sub.add_argument("--json", action="store_true", help="print JSON")
        for words, how in verb.arguments:
            sub.add_argument(*words, **how)
        sub.set_defaults(verb=verb.do)
    return parser.parse_args(sys.argv[1:] if arguments is None else list(arguments))


class _Version(argparse.Action):
    """Prints the version of the installed package, looked up only on demand."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('vdmbench')}")
        parser.exit()


# --- types of arguments; a value of another type is refused with a message ---


def run_directory(text: str) -> Path:
    """A directory with a plan, or one that has lost it, which is reported later. Raises InputError."""
    path = Path(text)
    if not any(map(os.path.exists, (path / "plan.json", path / "cases"))):
        raise InputError(f"{text}: not a run directory, such as results/runs/NAME (it has no plan.json)")
    return path


def place(text: str) -> Path:
    """A file or a directory to write; "" is refused, as it would be the current directory."""
    if not text.strip():
        raise argparse.ArgumentTypeError("name a place to write to, or leave the option out")
    return Path(text)


def _number(pattern: str, kind: Callable[[str], Any], told: str) -> Callable[[str], Any]:
    """A reader of numbers above 0 that match a pattern."""

    def read(text: str) -> Any:
        if re.fullmatch(pattern, text) is None or not (number := kind(f"0{text}")) > 0:
            raise argparse.ArgumentTypeError(f"must be {told}, not {text!r}")
        return number

    return read


positive = _number(r"[0-9]{1,6}", int, "a whole number of 1 or more")
positive_seconds = _number(r"[0-9]{0,9}(\.[0-9]*)?", float, "a number of seconds of more than 0")


def shard(text: str) -> tuple[int, int]:
    """I/N."""
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise argparse.ArgumentTypeError("write I/N with 1 <= I <= N, such as 2/8")


# --- the arguments that several verbs share ---


def option(*words: str, **how: Any) -> Option:
    """An argument of a verb."""
    return words, how


def output(word: str, what: str, told: str, **how: Any) -> Option:
    """An argument that names a place to write to."""
    return option(word, type=place, metavar=what, help=told, **how)


def flag(word: str, told: str) -> Option:
    """An argument without a value."""
    return option(word, action="store_true", help=told)


def study_argument(use: str = "", count: str | None = None) -> Option:
    """The study of a verb."""
    told = f"path of a study file, or a shipped study's name{use}"
    return option("study", metavar="STUDY", nargs=count, help=told)


STUDY_READS = (
    option(
        "--surface",
        type=Path,
        metavar="FILE",
        help="use this surface (STL, OBJ, PLY, VTP) as the geometry; names the study NAME-FILE",
    ),
    output(
        "--cache", "DIR", "where meshes and answers are kept (default VDMBENCH_CACHE, else results/cache)"
    ),
)
CHANGES = option(
    "--set",
    dest="changes",
    action="append",
    default=[],
    metavar="KEY=VALUE",
    help="change a value, such as tissue.youngs_modulus='3 kPa' or constraints.finger.force='1 N'; repeatable",
)
CASE = option("--case", type=positive, default=1, metavar="N", help="of a sweep the N-th case (default 1)")
RUNS = (
    output(
        "--out",
        "DIR",
        "run directory (default results/runs/NAME; another --surface of the same file name needs its own)",
    ),
    option(
        "--jobs",
        type=positive,
        metavar="N",
        help="cases at once (default: as many as processors that this process may use)",
    ),
)
PLANS = (study_argument(), *STUDY_READS, CHANGES, *RUNS, flag("--fresh", "run every case again"))
RUN = option("directory", metavar="DIR", help="run directory")
BASELINE = output("--baseline", "FILE", "baseline (default results/baselines/STUDY.json)")
