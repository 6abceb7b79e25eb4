"""`vdmbench bench`: run time against error for every model."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine import cache_directory, results_directory
from .arguments import STUDY_READS, option, place, study_argument
from .output import OK, UsageError, print_json, print_table, tell
from .studies import load, make_plan

SUMMARY = "measure run time against error for every model, in about five minutes a body"
ARGUMENTS = (
    study_argument(
        ": its body and its models, in place of every model on a sphere, an organ and the --surface given",
        "?",
    ),
    *STUDY_READS,
    option("--out", type=place, metavar="DIR", help="directory (default results/bench)"),
)


def run(options: argparse.Namespace) -> int:
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
    bench.write_bench_page(found, out / "bench.html")
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
    print(f"report: {out / 'bench.html'}")
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
