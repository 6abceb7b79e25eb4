"""`vdmbench report`: the page of a run, made again from its stored results."""

from __future__ import annotations

import argparse

from ..machine.places import results_directory
from .arguments import flag, option, output_file, run_directory
from .output import OK, UsageError, print_json, print_run, print_table, tell

SUMMARY = "rebuild the report from the stored results"
ARGUMENTS = (
    option("directories", type=run_directory, metavar="DIR", nargs="+", help="run directory"),
    flag("--claims", "put the paper's claims on trial by the results of all DIRs"),
    option("--out", type=output_file, metavar="FILE", help="of --claims (default results/claims.html)"),
    option(
        "--picture",
        type=output_file,
        metavar="FILE",
        help="write a PNG of reference, model and difference too",
    ),
)


def run(options: argparse.Namespace) -> int:
    """Rebuild the report of one directory, or the claims' page of several."""
    from ..report.rebuild import rebuild

    if options.claims:
        return _claims(options)
    if len(options.directories) > 1 or options.out:
        raise UsageError("several directories, and --out, go with --claims only")
    (directory,) = options.directories
    run, report = rebuild(directory, tell)
    if options.picture:
        from ..report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, directory, report, options.json)


def _claims(options: argparse.Namespace) -> int:
    from ..evidence.claims_page import verdict_rows, write_claims
    from ..store.cases import read_run

    page = options.out or results_directory() / "claims.html"
    rows = verdict_rows(write_claims([read_run(directory) for directory in options.directories], page))
    if options.json:
        return print_json({"report": str(page), "claims": rows})
    print_table(rows)
    print(f"report: {page}")
    return OK
