"""Trials in minutes: `bench claims calibrate`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine import cache_directory
from ..study.errors import InputError
from .arguments import RUNS, STUDY_READS, option, output, study_argument, verb
from .output import FAILED, OK, complain_of_failures, folded, print_json, print_table, tell
from .studies import check_files, command_of, load, make_plan, plan_of, run_missing


@verb(
    "bench",
    "measure run time against error for every model, in about five minutes a body",
    study_argument(
        ": its body and its models, in place of every model on a sphere, an organ and the --surface given",
        "?",
    ),
    *STUDY_READS,
    output("--out", "DIR", "where its run directories are (default results/runs)"),
    RUNS[1],
)
def run_benchmark(options: argparse.Namespace) -> int:
    """Run the study, or a sphere, an organ and the surface that is given, with every model on several mesh sizes.

    Each is a run like any other, of the study NAME-bench in a directory of its own, with a report.
    """
    from .. import bench

    plans = []  # check all before running any
    for name, surface in bodies_to_measure(options.study, options.surface):
        given = load(argparse.Namespace(**vars(options) | {"study": name, "surface": surface}))
        make_plan(given, options)  # an impossible mesh is reported with the line of the study
        names = given.study.models if options.study else bench.models_to_measure()
        study = bench.study_to_run(given, names, watch=tell)
        directory = options.out / study.study.name if options.out else None
        plan = make_plan(study, options, directory=directory, command=command_of("bench", options))
        check_files(plan, plan.cases_to_run())
        plans.append(plan)
    runs = [run_missing(plan, options, times=True) for plan in plans]
    rows = [row for run, _ in runs for row in bench.rows(run)]
    for run, _ in runs:
        complain_of_failures(run)
    if options.json:
        print_json({"rows": rows, "reports": [str(report) for _, report in runs]})
    else:
        print_table(rows)
        print(folded(bench.NOTE))
        for _, report in runs:
            print(f"report: {report}")
    # the benchmark's own mesh sizes may not suit the body
    return OK if all(run.cases for run, _ in runs) else FAILED


def bodies_to_measure(study: str | None, surface: Path | None) -> list[tuple[str, Path | None]]:
    """The studies of a benchmark, and the file that replaces a study's own body."""
    if study:
        return [(study, surface)]
    return [("quickstart", None), ("accuracy-organ", None)] + (
        [("accuracy-organ", surface)] if surface else []
    )


@verb(
    "claims",
    "put the paper's claims on trial over three bodies, two meshes and two materials, in some minutes",
    option("numbers", type=int, nargs="*", metavar="N", help="these claims alone, row by row"),
    option(
        "--from",
        dest="points",
        type=Path,
        metavar="FILE",
        help="judge what was measured before, in place of measuring",
    ),
    output("--out", "FILE", "write what was measured as CSV, a line a row and case"),
    output("--cache", "DIR", "where meshes are kept"),
)
def try_claims(options: argparse.Namespace) -> int:
    """Measure, or read, and print a line for each claim; of claims that are named every row."""
    from dataclasses import asdict

    from .. import claims

    numbers = sorted(set(options.numbers))
    if strange := [number for number in numbers if not 1 <= number <= len(claims.DATA["claims"])]:
        raise InputError(f"there is no claim {strange[0]}; they are 1 to {len(claims.DATA['claims'])}")
    points = claims.read_points(options.points) if options.points else None
    if options.out:  # what cannot be written is told before minutes of measuring
        options.out.parent.mkdir(parents=True, exist_ok=True)
        is_new = not options.out.exists()
        options.out.open("a").close()
        if is_new:
            options.out.unlink()
    if points is None:
        points = claims.measure(options.cache or cache_directory(), numbers, tell)
    if options.out:
        claims.write_points(points, options.out)
    rows = [row for row in claims.judge(points) if not numbers or row.claim in numbers]
    if options.json:
        return print_json({"claims": [asdict(row) for row in rows]})
    if not numbers:
        print_table(claims.table_of_claims(rows))
        return OK
    for number in numbers:
        print(f"\n{claims.title(number)}")
        for line in claims.told(number):
            print(folded(line, "  "))
        print_table(claims.table_of(number, rows))
    return OK


@verb(
    "calibrate",
    "fit VDM parameters on half of a study's loads, try them on the rest",
    study_argument(),
    *STUDY_READS,
    *RUNS,
    option(
        "--transfer",
        action="append",
        default=[],
        metavar="STUDY",
        help="try the fit on the held-out loads of this study too (can be repeated)",
    ),
)
def calibrate_study(options: argparse.Namespace) -> int:
    """Fit VDM parameters on half of a study's loads, try them on the rest."""
    from ..calibrate import as_json, as_toml, body, calibrate, check, table
    from ..machine import json_text, write_atomically

    plan = plan_of(options)
    check(plan, fit=True)
    plans = [plan]  # check all before running any
    for name in options.transfer:
        there = argparse.Namespace(**vars(options) | {"study": name, "surface": None, "out": None})
        plans.append(make_plan(load(there), there))
        check(plans[-1])
    runs = [run_missing(each, options)[0] for each in plans]
    for run in runs:
        complain_of_failures(run)
    own, *others = (body(*each) for each in zip(plans, runs, strict=True))
    entries = calibrate(own, others, tell)
    data, out = {own.name: as_json(entries)}, plan.directory
    write_atomically(out / "calibration.json", json_text(data, indent=1).encode())
    write_atomically(out / "calibration.toml", as_toml(entries).encode())
    if options.json:
        print_json(data)
    else:
        print_table(table(entries))
        print(f"\n{as_toml(entries)}\nwritten: {out / 'calibration.toml'}")
    return FAILED if any(run.failed for run in runs) else OK
