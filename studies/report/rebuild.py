"""Tables and report of a run directory, from what is stored there alone."""

from __future__ import annotations

import dataclasses
import fcntl
from collections.abc import Callable
from pathlib import Path

from ..machine.locks import LockedError, lock
from ..measures.case import Run
from ..store.cases import read_run, write_study
from ..store.run_directory import REPORT, keep_told, read_plan
from ..verdict.digest import digest_of

_PATIENCE = 300.0  # s that one other process may take to write the tables and the report


class ReportError(ValueError):
    """A report that cannot be written now."""


def rebuild(directory: Path, tell: Callable[[str], None]) -> tuple[Run, Path]:
    """Write the tables and the report from the stored results alone; returns the run and the report's path.

    `tell` is told who is waited for, where another process writes them. Raises ReportError if that takes long.
    """
    from .page import write_report  # plotting is slow to load, and who only plans draws nothing
    from .summary import summary

    read_plan(directory)  # nothing is left in a directory that is none of ours
    report = directory / REPORT
    try:
        # the last of several shards sees all
        with lock(directory / ".lock-report", fcntl.LOCK_EX, patience=_PATIENCE, tell=tell):
            run = read_run(directory, damaged=True)
            write_study(directory, run, digest_of(run).table)
            write_report(run, report)
            run = dataclasses.replace(run, told=summary(run))
            keep_told(directory, run.plan, run.told or {})
    except LockedError as error:
        raise ReportError(
            f"{directory}: {error} has locked the report for more than {_PATIENCE:g} s; the results are kept, "
            f"vdmbench report {directory} writes it later"
        ) from None
    return run, report
