"""The study of a command line, its plan, cases and run, and the progress of the run."""

from __future__ import annotations

import argparse
import contextlib
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..machine import results_directory, usable_processors
from ..study.errors import InputError
from .output import OK, complain, tell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..measures.case import Run
    from ..study.schema import Study
    from ..work.plan import Plan, PlannedCase
    from ..work.run import Event

SILENCE = 30.0  # s between two progress lines in a pipe


def load(options: argparse.Namespace) -> Study:
    """The study of a command line, with its changes."""
    from ..study.config import load_study
    from ..study.files import changes_of, study_path

    changes = [changes_of(change) for change in vars(options).get("changes", [])]
    return load_study(study_path(options.study), surface=options.surface, changes=changes)


def baseline_of(options: argparse.Namespace, study: str) -> Path:
    """The file of --baseline, or that of the study."""
    from ..gate import baseline_path

    return options.baseline or baseline_path(results_directory(), study)


def plan_of(options: argparse.Namespace) -> Plan:
    """The plan of the study of a command line, in its own directory if results are to be kept."""
    from ..work.explain import require_own

    plan = make_plan(load(options), options)
    if "out" in options:
        require_own(plan)
    return plan


def make_plan(
    study: Study, options: argparse.Namespace, *, directory: Path | None = None, command: tuple[str, ...] = ()
) -> Plan:
    """The plan of a study, of the directories that a command line names."""
    from ..work import plan as graph_plan

    given = vars(options)
    directory, fresh = directory or given.get("out"), given.get("fresh", False)
    command = command or command_of("run", options)
    return graph_plan.make_plan(study, directory, given.get("cache"), command, fresh=fresh)


def command_of(verb: str, options: argparse.Namespace) -> tuple[str, ...]:
    """The command that gives the same results again: the arguments that decide them, without folders."""
    from ..study.files import without_folders

    given = vars(options)
    words = [verb, *([_name(given["study"])] if given["study"] else [])]
    for key in ("surface", "out"):
        if given.get(key):
            words += [f"--{key}", _name(given[key])]
    for change in given.get("changes", []):
        key, _, value = change.partition("=")
        words += ["--set", f"{key}={without_folders(value)}"]
    return tuple(words)


def _name(path: str | Path) -> str:
    """The last part of a path: folders may name a patient."""
    return Path(path).name or str(path)


def check_files(plan: Plan, cases: Sequence[PlannedCase]) -> None:
    """Read the files of cases that are not meshed yet. Raises StudyError for unusable ones."""
    from ..study.config import geometry_error
    from ..study.errors import MeshError

    for mesh in plan.missing_meshes(cases):
        try:
            _ = mesh.size
        except MeshError as error:
            raise geometry_error(plan.study, error) from error


def run_missing(plan: Plan, options: argparse.Namespace, **how: Any) -> tuple[Run, Path]:
    """Run the missing part of a plan and show progress; returns the run and its report.

    Parameters
    ----------
    how : further `vdmbench.work.run.Options`
    """
    from ..report.rebuild import rebuild
    from ..work.run import Options, run_plan

    with Progress(plan.study.study.name, quiet=options.json) as progress:
        chosen = Options(jobs=options.jobs or usable_processors(), **how)
        return run_plan(plan, chosen, progress.show, rebuild)


def numbered_case(plan: Plan, number: int) -> PlannedCase:
    """The case that --case names, from 1. Raises InputError where there is none."""
    if number > len(plan.cases):
        raise InputError(f"--case {number}: the study has {len(plan.cases)} cases")
    return plan.cases[number - 1]


# --- progress of a run: one line of a terminal, or lines in a pipe, on standard error ---


class Progress:
    """Number of finished tasks, and the last event.

    Parameters
    ----------
    name : of the study, for a case without a label
    quiet : whether to show only sentences
    """

    def __init__(self, name: str, *, quiet: bool) -> None:
        self.name, self.quiet = name, quiet
        self.done = self.total = 0
        self.began = self.spoke = time.monotonic()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._line("")

    def show(self, event: Event) -> None:
        """Show one event of the run; sentences are shown even if quiet."""
        if event.kind == "told":
            self._line("")
            complain(event.message, OK)
            return
        if event.kind == "begun":
            self.total = event.count
        ended = event.kind in ("done", "failed", "stopped")
        self.done += ended
        now = time.monotonic()
        place = ": ".join(filter(None, [event.label or self.name, event.message]))
        self._line(f"{self.done}/{self.total}, {now - self.began:.0f} s, {place}")
        if self.quiet or sys.stderr.isatty():
            return
        if ended and event.kind != "stopped":
            tell(f"{event.kind} {place} ({event.seconds:.1f} s)")
        elif now - self.spoke >= SILENCE:
            tell(f"at {place}, {self.done} of {self.total} done")
        else:
            return
        self.spoke = now

    def _line(self, text: str) -> None:
        """Rewrite the line of a terminal."""
        if not self.quiet and sys.stderr.isatty():
            with contextlib.suppress(OSError):  # a terminal that is gone ends no run
                width = shutil.get_terminal_size().columns - 1
                print(f"\r\x1b[K{text[:width]}", end="", file=sys.stderr, flush=True)
