"""The command line: arguments, progress and exit codes. Nothing else prints or exits."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from .cli_output import (
    DAMAGED,
    FAILED,
    INTERRUPTED,
    MACHINE,
    NOTHING_COMPARED,
    OK,
    REGRESSED,
    USAGE,
    Progress,
    complain,
    count,
    print_json,
    print_run,
    print_table,
    tell,
)

if TYPE_CHECKING:
    from .case import Run
    from .plan import Plan
    from .schema import Study

SHIPPED = Path(__file__).parent / "cases"


class UsageError(ValueError):
    """A mistake on the command line."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Entry point of `vdmbench`."""
    signal.signal(signal.SIGTERM, _interrupt)
    options = _parser().parse_args(arguments)
    try:
        code = options.verb(options)
        sys.stdout.flush()
    except KeyboardInterrupt:
        code = complain("interrupted; what is done is kept, the same command goes on from here", INTERRUPTED)
    except BrokenPipeError:
        os.dup2(
            os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno()
        )  # the reader has gone: nothing to tell it
        code = OK
    except ImportError as error:
        code = complain(f"{error}; see what is missing with: vdmbench doctor", MACHINE)
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        code = complain(f"{name}{error.strerror or error}", MACHINE)
    except ValueError as error:
        code = _complain_of(error)
    sys.exit(code)


def _complain_of(error: ValueError) -> int:
    """One line per problem and the exit code of a mistake; a ValueError of ours always carries a sentence."""
    from .hdf5 import StoreError
    from .problems import StudyError

    if isinstance(error, StudyError):
        for problem in error.problems:
            complain(str(problem), USAGE)
        return USAGE
    return complain(str(error), DAMAGED if isinstance(error, StoreError) else USAGE)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="vdmbench",
        description="Compare the Volume Distribution Method with finite elements on the same mesh.",
        epilog="exit codes: 0 ok, 1 accuracy regressed, 2 usage or study file wrong, 3 some cases failed, "
        "4 machine lacks something, 5 stored results damaged, "
        "6 nothing was compared, 130 interrupted",
    )
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")

    def verb(name: str, function: Any, text: str) -> argparse.ArgumentParser:
        sub = verbs.add_parser(name, help=text, description=text)
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=function)
        return sub

    def study_verb(name: str, function: Any, text: str, count: str | None = None) -> argparse.ArgumentParser:
        sub = verb(name, function, text)
        sub.add_argument(
            "study", metavar="STUDY", nargs=count, help="path of a study file, or a shipped study's name"
        )
        sub.add_argument(
            "--surface",
            type=Path,
            metavar="FILE",
            help="use this surface (STL, OBJ, PLY, VTP) as the geometry",
        )
        sub.add_argument(
            "--allow-outside", action="store_true", help="allow files outside the study file's directory"
        )
        return sub

    def directory(sub: argparse.ArgumentParser) -> None:
        sub.add_argument("--out", type=Path, metavar="DIR", help="run directory (default results/runs/NAME)")

    verb("list", _list, "list the shipped studies")
    study_verb("check", _check, "validate a study without running it")
    directory(study_verb("plan", _plan, "say what a run would do"))
    run = study_verb("run", _run, "run what is missing and write the report")
    directory(run)
    run.add_argument("--jobs", type=_positive, metavar="N", help="cases at once (default: one per core)")
    run.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/N",
        help="run only the I-th of N parts of the cases",
    )
    run.add_argument("--fresh", action="store_true", help="run every case again")
    run.add_argument("--fail-fast", action="store_true", help="stop at the first failure")
    run.add_argument("--timeout", type=_positive_seconds, metavar="S", help="seconds that one case may take")
    calibrate = study_verb(
        "calibrate", _calibrate, "fit VDM parameters on half of a study's loads, try them on the rest"
    )
    directory(calibrate)
    calibrate.add_argument(
        "--jobs", type=_positive, metavar="N", help="cases at once (default: one per core)"
    )
    calibrate.add_argument(
        "--transfer",
        action="append",
        default=[],
        metavar="STUDY",
        help="try the fit on the held-out loads of this study too (can be repeated)",
    )
    status = verb("status", _status, "say what is done, failed and missing")
    report = verb("report", _report, "rebuild the report from the stored results")
    status.add_argument("directory", type=Path, metavar="DIR", help="run directory")
    report.add_argument("directories", type=Path, metavar="DIR", nargs="+", help="run directory")
    report.add_argument(
        "--claims", action="store_true", help="put the paper's claims on trial by the results of all DIRs"
    )
    report.add_argument("--out", type=Path, metavar="FILE", help="of --claims (default results/claims.html)")
    report.add_argument(
        "--picture", type=Path, metavar="FILE", help="write a PNG of reference, model and difference too"
    )
    gate = verb("gate", _gate, "hold a run's accuracy against its baseline")
    accept = verb("accept", _accept, "make a run's accuracy the baseline")
    for sub in (gate, accept):
        sub.add_argument("directory", type=Path, metavar="DIR", help="run directory")
        sub.add_argument(
            "--baseline", type=Path, metavar="FILE", help="baseline (default results/baselines/STUDY.json)"
        )
    gate.add_argument("--junit", type=Path, metavar="FILE", help="write JUnit XML too")
    gate.add_argument("--markdown", type=Path, metavar="FILE", help="write a summary in Markdown too")
    accept.add_argument("--reason", required=True, metavar="TEXT", help="why these numbers are right")
    bench = study_verb("bench", _bench, "measure run time against error for every model", "?")
    bench.add_argument("--out", type=Path, metavar="DIR", help="directory (default results/bench)")
    bench.add_argument("--large", action="store_true", help="finer meshes, surfaces of up to 163,842 nodes")
    verb("doctor", _doctor, "say what the machine has and lacks")
    return parser


# --- verbs ---


def _list(options: argparse.Namespace) -> int:
    import tomllib

    titles = {}
    for path in sorted(SHIPPED.glob("*.toml")):
        titles[path.stem] = tomllib.loads(path.read_text())["study"]["title"]
    if options.json:
        return print_json(titles)
    width = max(map(len, titles))
    for name, title in titles.items():
        print(f"{name:<{width}}  {title}")
    return OK


def _check(options: argparse.Namespace) -> int:
    from .config import expand
    from .problems import StudyError

    try:
        study, path = _load(options)
        cases = expand(study)
        _make_plan(study, cases, None)
    except StudyError as error:
        if options.json:
            problems = [problem._asdict() for problem in error.problems]
            print_json({"ok": False, "problems": problems})
            return USAGE
        raise
    if options.json:
        return print_json({"ok": True, "problems": [], "cases": len(cases)})
    print(f"{path}: ok, {count(len(cases), 'case')}")
    return OK


def _plan(options: argparse.Namespace) -> int:
    from .config import expand
    from .explain import summary

    study, _ = _load(options)
    plan = _make_plan(study, expand(study), options.out)
    planned = summary(plan)
    if options.json:
        return print_json(planned)
    print(f"{study.study.title}: {count(len(planned['cases']), 'case')} of {', '.join(study.study.models)}")
    if study.study.reference is None:
        print("no reference: the models run without comparison")
    for case in planned["cases"]:
        print(f"  {case['hash'][:12]}  {case['state']:<8} {case['label']}")
    meshes = count(planned["meshes_to_make"], "mesh", "meshes")
    print(f"to run: {count(planned['cases_to_run'], 'case')}, {meshes}")
    for kind in ("shared", "skipped"):
        for line in planned[kind]:
            print(f"{kind}: {line}")
    print(_estimate(planned["estimate"]))
    return OK


def _estimate(expected: dict[str, float] | None) -> str:
    if expected is None:
        return "estimate: none before the surface is meshed"
    return (
        f"estimate: {expected['seconds']:.0f} s on one core, {expected['memory'] / 1e6:.0f} MB a worker, "
        f"{expected['disk'] / 1e6:.1f} MB on disk; each within a factor of {expected['factor']:g}"
    )


def _run(options: argparse.Namespace) -> int:
    from .config import expand
    from .run import Options, run_plan

    study, path = _load(options)
    plan = _make_plan(study, expand(study), options.out)
    how = Options(
        jobs=options.jobs or os.cpu_count() or 1,
        shard=options.shard,
        timeout=options.timeout,
        fail_fast=options.fail_fast,
        fresh=options.fresh,
    )
    cases = plan.cases_to_run(how.shard, fresh=how.fresh)
    with Progress(len(cases) + len(plan.missing_meshes(cases)), quiet=options.json) as progress:
        run, report = run_plan(plan, path.read_text(), how, progress.show)
    return print_run(run, plan.directory, report, options.json)


def _calibrate(options: argparse.Namespace) -> int:
    from .calibrate import FINER, as_json, as_toml, body, calibrate, check
    from .calibration_table import table
    from .config import with_mesh_size
    from .files import write_atomically

    study, path = _load(options)
    check(study)
    out = options.out or _results() / "runs" / study.study.name
    finer = with_mesh_size(study, FINER)
    own = body(
        *_run_for_fit(study, path, out, options),
        _run_for_fit(finer, path, out / "finer", options) if finer is not None else None,
    )
    others = []
    for name in options.transfer:
        other, other_path = _load(argparse.Namespace(**{**vars(options), "study": name}))
        where = _results() / "runs" / other.study.name
        others.append(body(*_run_for_fit(other, other_path, where, options), None))
    entries = calibrate(own, others)
    data = {own.name: as_json(entries)}
    write_atomically(out / "calibration.json", json.dumps(data, indent=1).encode())
    write_atomically(out / "calibration.toml", as_toml(entries).encode())
    if options.json:
        return print_json(data)
    print_table(table(entries))
    print(f"\n{as_toml(entries)}\nwritten: {out / 'calibration.toml'}")
    return OK


def _status(options: argparse.Namespace) -> int:
    from .store import run_state

    state = run_state(options.directory)
    if options.json:
        print_json(state)
    else:
        kinds = ("done", *(["stale"] if state["stale"] else []), "failed", "damaged", "missing")
        print(", ".join(f"{len(state[kind])} {kind}" for kind in kinds))
        for entry in state["failed"]:
            print(
                f"failed: {entry['label']}: {entry['message']}"
                + (f"; {entry['remedy']}" if entry["remedy"] else "")
            )
        for kind in ("stale", "damaged", "missing"):
            for label in state[kind]:
                print(f"{kind}: {label}")
    return DAMAGED if state["damaged"] else FAILED if state["failed"] else OK


def _report(options: argparse.Namespace) -> int:
    from .run import rebuild

    if options.claims:
        return _claims(options)
    if len(options.directories) > 1 or options.out:
        raise UsageError("several directories, and --out, go with --claims only")
    (directory,) = options.directories
    run, report = rebuild(directory)
    if options.picture:
        from .report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, directory, report, options.json)


def _claims(options: argparse.Namespace) -> int:
    from .report.claims_page import verdict_rows, write_claims
    from .store import read_run

    page = options.out or _results() / "claims.html"
    rows = verdict_rows(write_claims([read_run(directory) for directory in options.directories], page))
    if options.json:
        return print_json({"report": str(page), "claims": rows})
    print_table(rows)
    print(f"report: {page}")
    return OK


def _gate(options: argparse.Namespace) -> int:
    from . import gate
    from .files import write_atomically
    from .gate_report import describe, junit, markdown, summary
    from .store import read_run

    run = read_run(options.directory)
    study = str(run.study["name"])
    baseline = gate.read_baseline(_baseline(options, study))
    findings = gate.compare(run, baseline)
    if options.junit:
        write_atomically(options.junit, junit(study, findings))
    if options.markdown:
        text = markdown(study, baseline.reason, baseline.date, findings)
        write_atomically(options.markdown, text.encode("utf-8", "replace"))
    if options.json:
        print_json({"study": study, "counts": gate.counts(findings), "findings": gate.as_data(findings)})
    else:
        for finding in findings:
            if finding.outcome != gate.SAME:
                print(describe(finding))
        print(f"{study}: {summary(findings)} (baseline of {baseline.date}: {baseline.reason})")
    if gate.regressed(findings):
        return REGRESSED
    return NOTHING_COMPARED if gate.nothing_compared(findings) else OK


def _accept(options: argparse.Namespace) -> int:
    from .gate import accept
    from .store import read_run

    run = read_run(options.directory)
    path = _baseline(options, str(run.study["name"]))
    baseline = accept(run, path, options.reason)
    if options.json:
        return print_json({"baseline": str(path), "cases": len(baseline.cases), "reason": baseline.reason})
    print(f"accepted {count(len(baseline.cases), 'case')}: {path}")
    return OK


def _baseline(options: argparse.Namespace, study: str) -> Path:
    from .gate import baseline_path

    return options.baseline or baseline_path(_results(), study)


def _bench(options: argparse.Namespace) -> int:
    """The study, or a sphere and an organ (the given surface in its stead) with every model."""
    from . import bench
    from .bench_data import answers, machine_independent, rows
    from .bench_store import write_bench
    from .report.bench_page import write_bench_page

    names = [options.study] if options.study else ["quickstart", "accuracy-organ"]
    surfaces = [options.surface] if options.study else [None, options.surface]
    studies = [
        _load(argparse.Namespace(**vars(options) | {"study": name, "surface": surface}))[0]
        for name, surface in zip(names, surfaces, strict=True)
    ]
    out = options.out or _results() / "bench"
    found = bench.measure(
        studies,
        _results() / "cache",
        names=None if options.study else bench.MODELS,
        sizes=bench.LARGE_SIZES if options.large else bench.SIZES,
        large=options.large,
        watch=lambda text: tell(f"measuring {text}"),
    )
    write_bench(out / "bench.h5", found)
    write_bench_page(found, out / "bench.html")
    if options.json:
        return print_json(
            {"rows": rows(found), "answers": answers(found), "figures": machine_independent(found)}
        )
    print(", ".join(f"{name}: {text}" for name, text in list(found.machine.items())[:5]))
    print_table(rows(found))
    for growth in found.growths:
        print(f"{growth.what} grows as nodes ^ {growth.exponent:.2f}")
    print(*answers(found), f"report: {out / 'bench.html'}", sep="\n")
    return OK


def _doctor(options: argparse.Namespace) -> int:
    from .doctor import examine

    findings = examine()
    if options.json:
        print_json([finding._asdict() for finding in findings])
    else:
        for finding in findings:
            print(f"{'ok  ' if finding.ok else 'LACKS'} {finding.what}: {finding.detail}")
            if not finding.ok and finding.remedy:
                print(f"      {finding.remedy}")
    return OK if all(finding.ok or not finding.needed for finding in findings) else MACHINE


# --- what the verbs share ---


def _load(options: argparse.Namespace) -> tuple[Study, Path]:
    from .config import load_study

    path = Path(options.study)
    if path.suffix != ".toml" and not path.exists():
        shipped = SHIPPED / f"{options.study}.toml"
        if not shipped.exists() or shipped.parent != SHIPPED:
            known = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.toml")))
            raise UsageError(
                f"no study file {options.study!r} and no shipped study of that name; shipped are: {known}"
            )
        path = shipped
    return load_study(path, allow_outside=options.allow_outside, surface=options.surface), path


def _results() -> Path:
    return Path(os.environ.get("VDMBENCH_RESULTS", "results"))


def _make_plan(study: Study, cases: Any, out: Path | None) -> Plan:
    from .plan import make_plan

    return make_plan(study, cases, out or _results() / "runs" / study.study.name, _results() / "cache")


def _run_for_fit(study: Study, path: Path, out: Path, options: argparse.Namespace) -> tuple[Plan, Run]:
    """Run what is missing of a study that parameters are fitted on."""
    from .config import expand
    from .run import Options, run_plan

    plan = _make_plan(study, expand(study), out)
    cases = plan.cases_to_run()
    with Progress(len(cases) + len(plan.missing_meshes(cases)), quiet=options.json) as progress:
        run, _ = run_plan(
            plan, path.read_text(), Options(jobs=options.jobs or os.cpu_count() or 1), progress.show
        )
    return plan, run


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return value


def _positive_seconds(text: str) -> float:
    value = float(text)
    if not value > 0:
        raise argparse.ArgumentTypeError("must be more than 0")
    return value


def _shard(text: str) -> tuple[int, int]:
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise argparse.ArgumentTypeError("write I/N with 1 <= I <= N, such as 2/8")
