"""Writes the table and the report of a run directory from the stored results alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..machine import lock
from ..measures.case import Run
from ..store.cases import read_run, write_metrics
from ..store.run_directory import REPORT, keep_told, read_plan
from ..verdict.digest import digest_of


def rebuild(directory: Path) -> tuple[Run, Path]:
    """Write the table and the report from the stored results alone; returns the run and the report's path."""
    from .headline import summary
    from .page import write_report  # slow to load, and a plan does not draw

    read_plan(directory)  # raises before anything is written to a directory that is no run's
    report = directory / REPORT
    with lock(directory / ".lock-report", wait=True):  # the last of several shards reads all results
        run = read_run(directory, damaged=True)
        write_metrics(directory, digest_of(run).table)
        write_report(run, report)
        run = dataclasses.replace(run, told=summary(run))
        keep_told(directory, run.plan, run.told or {})
    return run, report
