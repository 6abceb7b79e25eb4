"""Trials that bring their own studies, in minutes: `bench claims`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine import cache_directory, results_directory
from .arguments import STUDY_READS, option, place, study_argument, verb
from .output import OK, UsageError, folded, print_json, print_table, tell
from .studies import load, make_plan


@verb(
    "bench",
    "measure run time against error for every model, in about five minutes a body",
    study_argument(
        ": its body and its models, in place of every model on a sphere, an organ and the --surface given",
        "?",
    ),
    *STUDY_READS,
    option("--out", type=place, metavar="DIR", help="directory (default results/bench)"),
)
def run_benchmark(options: argparse.Namespace) -> int:
    """Measure the study, or a sphere, an organ and the surface that is given, with every model."""
    from .. import bench
    from ..models import benched_names

    studies = {
        body: load(argparse.Namespace(**vars(options) | {"study": name, "surface": surface}))
        for body, (name, surface) in bodies_to_measure(options.study, options.surface).items()
    }
    if options.study:
        for study in studies.values():
            # a mesh that cannot be made is told with its line before anything is measured
            make_plan(study, options)
    out = options.out or results_directory() / "bench"
    if out.is_dir() and any(out.iterdir()) and not (out / "bench.json").exists():
        raise UsageError(f"{out}: is not empty and not a benchmark's directory; choose another --out")
    found = bench.measure(
        studies,
        vars(options).get("cache") or cache_directory(),
        names=None if options.study else benched_names(),
        watch=tell,
    )
    bench.write_bench(out / "bench.json", found)
    if options.json:
        return print_json(
            {
                "rows": bench.rows(found),
                "answers": bench.answers(found),
                "figures": bench.machine_independent(found),
            }
        )
    print(", ".join(f"{name}: {text}" for name, text in list(found.machine.items())[:5]))
    print_table(bench.rows(found))
    print(bench.ERROR_NOTE)
    print_table(bench.answers(found))
    print(bench.ANSWERS_NOTE)
    print(f"figures: {out / 'bench.json'}")
    return OK


def bodies_to_measure(study: str | None, surface: Path | None) -> dict[str, tuple[str, Path | None]]:
    """Name of each body of a benchmark -> its study, and the file that replaces the study's own body."""
    if study:
        return {Path(study).stem: (study, surface)}
    bodies: dict[str, tuple[str, Path | None]] = {
        "sphere": ("quickstart", None),
        "organ": ("accuracy-organ", None),
    }
    if surface is not None:
        bodies[surface.name if surface.stem in bodies else surface.stem] = ("accuracy-organ", surface)
    return bodies


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
    option(
        "--out",
        type=place,
        metavar="FILE",
        help="write what was measured as CSV, a line a row and case",
    ),
    option("--cache", type=place, metavar="DIR", help="where meshes are kept"),
)
def try_claims(options: argparse.Namespace) -> int:
    """Measure, or read, and print a line for each claim; of claims that are named every row."""
    from dataclasses import asdict

    from .. import claims

    numbers = sorted(set(options.numbers))
    if strange := [number for number in numbers if not 1 <= number <= len(claims.DATA["claims"])]:
        raise UsageError(f"there is no claim {strange[0]}; they are 1 to {len(claims.DATA['claims'])}")
    if options.points:
        points = claims.read_points(options.points)
    else:
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
