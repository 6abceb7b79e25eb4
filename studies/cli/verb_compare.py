"""`vdmbench compare`: runs side by side."""

from __future__ import annotations

import argparse
import math
import os

from .argument_kinds import run_directory
from .output import OK, UsageError, print_json

SUMMARY = "put runs side by side, each held against the first"
MOST = 26  # runs, each a letter


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument(
        "directories",
        type=run_directory,
        metavar="DIR",
        nargs="+",
        help="run directories, two or more; the first is what the others are held against",
    )


def run(options: argparse.Namespace) -> int:
    """Print models by metrics by runs: what is worse, better, newly failing and not comparable."""
    from ..guard.side_by_side import as_text, side_by_side
    from ..store.cases import read_run

    directories = {os.path.normpath(path): path for path in options.directories}
    if not 2 <= len(directories) <= MOST:
        raise UsageError(f"give 2 to {MOST} different run directories, not {len(directories)}")
    found = side_by_side({name: read_run(path) for name, path in directories.items()})
    if not options.json:
        for line in as_text(found):
            print(line)
        return OK
    return print_json(
        {
            "runs": list(found.names),
            "rows": [
                {
                    "metric": row.metric,
                    "model": row.model,
                    "unit": row.unit,
                    "values": [None if math.isnan(value) else value for value in row.values],
                    "outcomes": list(row.outcomes),
                }
                for row in found.rows
            ],
            "findings": [[vars(finding) for finding in findings] for findings in found.findings],
        }
    )
