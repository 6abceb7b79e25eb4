"""`vdmbench report`: the page of a run, made again from its stored results."""

from __future__ import annotations

import argparse

from .arguments import option, place, run_directory
from .output import print_run

SUMMARY = "rebuild the report from the stored results"
ARGUMENTS = (
    option("directory", type=run_directory, metavar="DIR", help="run directory"),
    option(
        "--picture",
        type=place,
        metavar="FILE",
        help="write a PNG of reference, model and difference too",
    ),
)


def run(options: argparse.Namespace) -> int:
    """Rebuild the report of a directory."""
    from ..report.rebuild import rebuild

    run, report = rebuild(options.directory)
    if options.picture:
        from ..report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, options.directory, report, options.json)
