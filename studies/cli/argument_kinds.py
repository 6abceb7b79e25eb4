"""What arguments may be, each told where it is not; and the arguments that several verbs share."""

from __future__ import annotations

import argparse
import os
import re
import stat
from pathlib import Path

from ..machine.places import results_directory
from .output import UsageError

_LEAST_MEMORY = 50_000_000


def study_arguments(parser: argparse.ArgumentParser, count: str | None = None, use: str = "") -> None:
    """A study, and what it may read."""
    told = f"path of a study file, or a shipped study's name{use}"
    parser.add_argument("study", metavar="STUDY", nargs=count, help=told)
    file_arguments(parser)


def file_arguments(parser: argparse.ArgumentParser) -> None:
    """What a study may read, and where it keeps what it computes."""
    parser.add_argument(
        "--surface",
        type=Path,
        metavar="FILE",
        help="use this surface (STL, OBJ, PLY, VTP) as the geometry; names the study NAME-FILE",
    )
    parser.add_argument(
        "--allow-outside", action="store_true", help="allow files outside the study file's directory"
    )
    parser.add_argument(
        "--cache",
        type=directory,
        metavar="DIR",
        help="where meshes and answers are kept (default VDMBENCH_CACHE, else results/cache)",
    )


def change_argument(parser: argparse.ArgumentParser) -> None:
    """Values to change in the study."""
    parser.add_argument(
        "--set",
        dest="changes",
        type=change,
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a value, such as tissue.youngs_modulus='3 kPa' or constraints.finger.force='1 N'; repeatable",
    )


def run_arguments(parser: argparse.ArgumentParser) -> None:
    """Where a run goes, and how many cases at once."""
    parser.add_argument(
        "--out",
        type=directory,
        metavar="DIR",
        help="run directory (default results/runs/NAME; another --surface of the same file name needs its own)",
    )
    parser.add_argument(
        "--jobs",
        type=positive,
        metavar="N",
        help="cases at once (default: as many as processors that this process may use)",
    )


def plan_arguments(parser: argparse.ArgumentParser) -> None:
    """What decides the plan of a run."""
    study_arguments(parser)
    change_argument(parser)
    run_arguments(parser)
    parser.add_argument("--fresh", action="store_true", help="run every case again")


def run_directory(text: str) -> Path:
    """A directory with a plan, or one that has lost it, which is not the command's fault."""
    path = Path(text)
    if not any(map(os.path.exists, (path / "plan.json", path / "cases"))):
        raise argparse.ArgumentTypeError(f"{text}: not a run directory (it has no plan.json)")
    return path


def given_run_directory(text: str) -> Path:
    """The same of a word that may also be a study. Raises UsageError."""
    try:
        return run_directory(text)
    except argparse.ArgumentTypeError as error:
        raise UsageError(str(error)) from None


def baseline_arguments(parser: argparse.ArgumentParser) -> None:
    """A run, and the file of its baseline."""
    parser.add_argument("directory", type=run_directory, metavar="DIR", help="run directory")
    parser.add_argument(
        "--baseline", type=output_file, metavar="FILE", help="baseline (default results/baselines/STUDY.json)"
    )


def baseline_of(options: argparse.Namespace, study: str) -> Path:
    """The file that was named, or that of the study."""
    from ..gate import baseline_path

    return options.baseline or baseline_path(results_directory(), study)


def directory(text: str) -> Path:
    """A directory to write into; "" would be the one that one stands in."""
    if not text.strip():
        raise argparse.ArgumentTypeError("name a directory, or leave the option out")
    return Path(text)


def output_file(text: str) -> Path:
    """A file to write: a new one, or one that is there under its own name."""
    if not text.strip():
        raise argparse.ArgumentTypeError("name a file, or leave the option out")
    path = Path(text)
    try:
        found = os.lstat(path)
    except (OSError, ValueError):  # which writing tells, or reading
        return path
    if not stat.S_ISREG(found.st_mode):
        raise argparse.ArgumentTypeError(f"{text}: is no regular file; name one, not a link to it")
    return path


def change(text: str) -> str:
    """KEY=VALUE that is TOML, or becomes so where VALUE is quoted."""
    from ..study.files import OverrideError, changes_of

    try:
        changes_of(text)
    except OverrideError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


def positive(text: str) -> int:
    """A whole number of 1 or more."""
    if re.fullmatch(r"[0-9]{1,6}", text) is None or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of 1 or more, not {text!r}")
    return int(text)


def positive_seconds(text: str) -> float:
    """A number of seconds."""
    if re.fullmatch(r"[0-9]{0,9}(\.[0-9]*)?", text) is None or not float(f"0{text}") > 0:
        raise argparse.ArgumentTypeError(f"must be a number of seconds of more than 0, not {text!r}")
    return float(text)


def size_in_bytes(text: str) -> int:
    """A size such as 4GB in bytes."""
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) ?(kB|MB|GB|TB)", text)
    if found is None or float(found[1]) == 0:
        raise argparse.ArgumentTypeError("write a size such as 500MB or 4GB")
    size = int(float(found[1]) * 1000 ** (1 + ["kB", "MB", "GB", "TB"].index(found[2])))
    if size < _LEAST_MEMORY:
        raise argparse.ArgumentTypeError(
            f"must be {_LEAST_MEMORY // 1_000_000}MB or more: a worker takes as much before it solves anything"
        )
    return size


def shard(text: str) -> tuple[int, int]:
    """I/N."""
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise argparse.ArgumentTypeError("write I/N with 1 <= I <= N, such as 2/8")
