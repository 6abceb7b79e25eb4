"""Table and report of a run directory, from what is stored there alone."""

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
    from .page import write_report  # plotting is slow to load, and who only plans draws nothing

    read_plan(directory)  # nothing is left in a directory that is none of ours
    report = directory / REPORT
    with lock(directory / ".lock-report", wait=True):  # the last of several shards sees all
        run = read_run(directory, damaged=True)
        write_metrics(directory, digest_of(run).table)
        write_report(run, report)
        run = dataclasses.replace(run, told=summary(run))
        keep_told(directory, run.plan, run.told or {})
    return run, report
