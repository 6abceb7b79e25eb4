"""The command line's arguments; the verbs are in `cli_study` and `cli_results`."""

from __future__ import annotations

import argparse
import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from ..machine.streams import harmless
from . import results as cli_results
from . import study_verbs as cli_study

_LEAST_MEMORY = 50_000_000


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, by default those of the process; `verb` is what to call with them. Exits on a mistake."""
    return _parser().parse_args(arguments)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong as `output.complain` does: no argument steers the terminal."""

    def error(self, message: str) -> NoReturn:
        super().error(harmless(message))


class _Version(argparse.Action):
    """Prints the version of the installed package, which is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('vdmbench')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="vdmbench",
        description="Compare the Volume Distribution Method with finite elements on the same mesh.",
        epilog="exit codes: 0 ok, 1 accuracy regressed, 2 usage or study file wrong, 3 some cases failed, "
        "4 machine lacks something, 5 stored results damaged, "
        "6 not all was compared, 70 a bug of the program, 130 interrupted",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")

    def verb(name: str, function: Any, text: str) -> argparse.ArgumentParser:
        sub = verbs.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=function, goes_on=False, solves=True)
        return sub

    def study_verb(
        name: str, function: Any, text: str, count: str | None = None, use: str = ""
    ) -> argparse.ArgumentParser:
        sub = verb(name, function, text)
        told = f"path of a study file, or a shipped study's name{use}"
        sub.add_argument("study", metavar="STUDY", nargs=count, help=told)
        sub.add_argument(
            "--surface",
            type=Path,
            metavar="FILE",
            help="use this surface (STL, OBJ, PLY, VTP) as the geometry; names the study NAME-FILE",
        )
        sub.add_argument(
            "--allow-outside", action="store_true", help="allow files outside the study file's directory"
        )
        return sub

    def directory(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--out",
            type=_directory,
            metavar="DIR",
            help="run directory (default results/runs/NAME; another --surface of the same file name needs its own)",
        )

    def jobs(sub: argparse.ArgumentParser) -> None:
        sub.add_argument(
            "--jobs",
            type=_positive,
            metavar="N",
            help="cases at once (default: as many as processors that this process may use)",
        )

    shipped = verb("list", cli_study.list_verb, "list the shipped studies, or the models")
    shipped.set_defaults(solves=False)
    shipped.add_argument("--models", action="store_true", help="list the models with what a study may set")
    study_verb("check", cli_study.check_verb, "validate a study without running it")
    plan = study_verb("plan", cli_study.plan_verb, "say what a run would do")
    run = study_verb("run", cli_study.run_verb, "run what is missing and write the report")
    for sub in (plan, run):
        directory(sub)
        jobs(sub)
        sub.add_argument("--fresh", action="store_true", help="run every case again")
    run.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/N",
        help="run only the I-th of N parts of the cases",
    )
    run.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run the cases on this Dask cluster, such as tls://HOST:8786; meshes are made here; without TLS it "
        "trusts all who reach it, on loopback every user of the machine",
    )
    run.add_argument(
        "--insecure-scheduler",
        action="store_true",
        help="allow a scheduler on another machine without TLS: whoever reaches its network can run programs",
    )
    run.set_defaults(goes_on=True)
    run.add_argument("--fail-fast", action="store_true", help="stop at the first failure")
    run.add_argument("--timeout", type=_positive_seconds, metavar="S", help="seconds that one case may take")
    run.add_argument(
        "--memory",
        type=_bytes,
        metavar="SIZE",
        help="memory that one worker may take, such as 4GB (default: the machine's, divided by the jobs)",
    )
    calibrate = study_verb(
        "calibrate",
        cli_study.calibrate_verb,
        "fit VDM parameters on half of a study's loads, try them on the rest",
    )
    calibrate.set_defaults(goes_on=True)
    directory(calibrate)
    jobs(calibrate)
    calibrate.add_argument(
        "--transfer",
        action="append",
        default=[],
        metavar="STUDY",
        help="try the fit on the held-out loads of this study too (can be repeated)",
    )
    status = verb("status", cli_results.status_verb, "say what is done, failed and missing")
    report = verb("report", cli_results.report_verb, "rebuild the report from the stored results")
    status.add_argument("directory", type=_run_directory, metavar="DIR", help="run directory")
    report.add_argument("directories", type=_run_directory, metavar="DIR", nargs="+", help="run directory")
    report.add_argument(
        "--claims", action="store_true", help="put the paper's claims on trial by the results of all DIRs"
    )
    report.add_argument(
        "--out", type=_output, metavar="FILE", help="of --claims (default results/claims.html)"
    )
    report.add_argument(
        "--picture", type=_output, metavar="FILE", help="write a PNG of reference, model and difference too"
    )
    gate = verb("gate", cli_results.gate_verb, "hold a run's accuracy against its baseline")
    accept = verb("accept", cli_results.accept_verb, "make a run's accuracy the baseline")
    for sub in (gate, accept):
        sub.add_argument("directory", type=_run_directory, metavar="DIR", help="run directory")
        sub.add_argument(
            "--baseline", type=_output, metavar="FILE", help="baseline (default results/baselines/STUDY.json)"
        )
    gate.add_argument(
        "--allow-missing", action="store_true", help="compare what is there; by default what is missing is 6"
    )
    gate.add_argument("--junit", type=_output, metavar="FILE", help="write JUnit XML too")
    gate.add_argument("--markdown", type=_output, metavar="FILE", help="write a summary in Markdown too")
    accept.add_argument("--reason", required=True, metavar="TEXT", help="why these numbers are right")
    bench = study_verb(
        "bench",
        cli_study.bench_verb,
        "measure run time against error for every model, in about five minutes a body",
        "?",
        ": its body and its models, in place of every model on a sphere, an organ and the --surface given",
    )
    bench.add_argument("--out", type=_directory, metavar="DIR", help="directory (default results/bench)")
    bench.add_argument("--large", action="store_true", help="growth on surfaces of up to 163,842 nodes")
    doctor = verb("doctor", cli_results.doctor_verb, "say what the machine has and lacks")
    doctor.set_defaults(solves=False)
    return parser


def _run_directory(text: str) -> Path:
    """A directory with a plan, or one that has lost it, which is not the command's fault."""
    path = Path(text)
    if not any(map(os.path.exists, (path / "plan.json", path / "cases"))):
        raise argparse.ArgumentTypeError(f"{text}: not a run directory (it has no plan.json)")
    return path


def _directory(text: str) -> Path:
    """A directory to write into; "" would be the one that one stands in."""
    if not text.strip():
        raise argparse.ArgumentTypeError("name a directory, or leave the option out")
    return Path(text)


def _output(text: str) -> Path:
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


def _positive(text: str) -> int:
    if re.fullmatch(r"[0-9]{1,6}", text) is None or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of 1 or more, not {text!r}")
    return int(text)


def _positive_seconds(text: str) -> float:
    if re.fullmatch(r"[0-9]{0,9}(\.[0-9]*)?", text) is None or not float(f"0{text}") > 0:
        raise argparse.ArgumentTypeError(f"must be a number of seconds of more than 0, not {text!r}")
    return float(text)


def _bytes(text: str) -> int:
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) ?(kB|MB|GB|TB)", text)
    if found is None or float(found[1]) == 0:
        raise argparse.ArgumentTypeError("write a size such as 500MB or 4GB")
    size = int(float(found[1]) * 1000 ** (1 + ["kB", "MB", "GB", "TB"].index(found[2])))
    if size < _LEAST_MEMORY:
        raise argparse.ArgumentTypeError(
            f"must be {_LEAST_MEMORY // 1_000_000}MB or more: a worker takes as much before it solves anything"
        )
    return size


def _shard(text: str) -> tuple[int, int]:
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise argparse.ArgumentTypeError("write I/N with 1 <= I <= N, such as 2/8")
