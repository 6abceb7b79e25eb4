"""Where the baseline of a run is: for the verbs that read or write it."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine.places import results_directory
from .argument_kinds import output_file, run_directory


def baseline_arguments(parser: argparse.ArgumentParser) -> None:
    """A run, and the file of its baseline."""
    parser.add_argument("directory", type=run_directory, metavar="DIR", help="run directory")
    parser.add_argument(
        "--baseline", type=output_file, metavar="FILE", help="baseline (default results/baselines/STUDY.json)"
    )


def baseline_of(options: argparse.Namespace, study: str) -> Path:
    """The file that was named, or that of the study."""
    from ..guard.gate import baseline_path

    return options.baseline or baseline_path(results_directory(), study)
