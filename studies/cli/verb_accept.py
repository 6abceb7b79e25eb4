"""`vdmbench accept`: a run's accuracy becomes the baseline."""

from __future__ import annotations

import argparse

from ..study.errors import plural
from .arguments import BASELINE, RUN, option
from .output import OK, print_json
from .studies import baseline_of

SUMMARY = "make a run's accuracy the baseline"
ARGUMENTS = (
    RUN,
    BASELINE,
    option("--reason", required=True, metavar="TEXT", help="why these numbers are right"),
)


def run(options: argparse.Namespace) -> int:
    """Write a run as the baseline."""
    from ..gate import accept
    from ..store.cases import read_run

    run = read_run(options.directory)
    path = baseline_of(options, run.study.study.name)
    baseline = accept(run, path, options.reason)
    if options.json:
        return print_json({"baseline": str(path), "cases": len(baseline.cases), "reason": baseline.reason})
    print(f"accepted {plural(len(baseline.cases), 'case')}: {path}")
    return OK
