"""The study that a command line names, its plan, its cases and its run, and how far that is."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..machine import cache_directory, results_directory, usable_processors
from ..study.errors import InputError
from .output import OK, complain, tell

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..measures.case import Run
    from ..study.schema import Study
    from ..work.plan import Plan, PlannedCase
    from ..work.run import Event

SILENCE = 30.0  # s between two lines in which a pipe hears where the run is


def load(options: argparse.Namespace) -> Study:
    """The study that a command line names, with its changes."""
    from ..study.config import load_study
    from ..study.files import changes_of, study_path

    changes = [changes_of(change) for change in vars(options).get("changes", [])]
    return load_study(study_path(options.study), surface=options.surface, changes=changes)


def baseline_of(options: argparse.Namespace, study: str) -> Path:
    """The file of --baseline, or that of the study."""
    from ..gate import baseline_path

    return options.baseline or baseline_path(results_directory(), study)


def make_plan(
    study: Study, options: argparse.Namespace, *, directory: Path | None = None, command: tuple[str, ...] = ()
) -> Plan:
    """The plan of all cases; in --out or results/runs/NAME by default."""
    from ..study.config import expand
    from ..work import plan as graph_plan

    directory = directory or vars(options).get("out")
    if directory is None:
        directory = results_directory() / "runs" / study.study.name
    cache = vars(options).get("cache") or cache_directory()
    command = command or command_of("run", options)
    fresh = vars(options).get("fresh", False)
    return graph_plan.make_plan(study, expand(study), directory, cache, command, fresh=fresh)


def require_own(plan: Plan, options: argparse.Namespace) -> None:
    """Raises InputError where the directory holds no run, or that of another surface file of the same name."""
    from ..store.plain import StoreError
    from ..store.run_directory import read_plan, refuse_foreign
    from ..work.explain import surfaces

    refuse_foreign(plan.directory)
    if options.surface is None or options.out is not None:
        return
    try:
        there = read_plan(plan.directory)
    except StoreError:
        return
    if (
        "--surface" in there.get("command", [])
        and not surfaces(plan).keys() & there.get("surfaces", {}).keys()
    ):
        raise InputError(
            f"{plan.directory} has the results of another surface of that name; give those of {options.surface} "
            "a directory of their own by --out"
        )


def command_of(verb: str, options: argparse.Namespace) -> tuple[str, ...]:
    """What to type to get the same results again: the words of this command that decide them, without folders."""
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
    """The last name of a path: the others may be a patient's."""
    return Path(path).name or str(path)


def check_files(plan: Plan, cases: Sequence[PlannedCase]) -> None:
    """Read the files of cases that are still to be meshed. Raises StudyError for those that cannot be used."""
    from ..study.config import geometry_error
    from ..study.errors import MeshError

    for mesh in plan.missing_meshes(cases):
        try:
            _ = mesh.expected
        except MeshError as error:
            raise geometry_error(plan.study, error) from error


def run_missing(plan: Plan, options: argparse.Namespace, **how: Any) -> tuple[Run, Path]:
    """Run what is missing of a plan and show how far it is: the run and its report.

    Parameters
    ----------
    how : further `vdmbench.work.run.Options`
    """
    from ..report.rebuild import rebuild
    from ..work.run import Options, run_plan

    with Progress(plan.study.study.name, quiet=options.json) as progress:
        chosen = Options(jobs=options.jobs or usable_processors(), **how)
        return run_plan(plan, plan.study.text, chosen, progress.show, rebuild)


def only_case(plan: Plan, why: str) -> PlannedCase:
    """The case of a study without a sweep. Raises InputError with `why` where there are more."""
    if len(plan.cases) > 1:
        raise InputError(f"{why} a study of one case; leave [sweep] out")
    return plan.cases[0]


def numbered_case(plan: Plan, number: int) -> PlannedCase:
    """The case that --case names, from 1. Raises InputError where there is none."""
    if number > len(plan.cases):
        raise InputError(f"--case {number}: the study has {len(plan.cases)} cases")
    return plan.cases[number - 1]


# --- how far a run is: a bar on a terminal, lines in a pipe, on standard error so that output can be piped ---


class Progress:
    """Pieces done of all, and what was heard of last.

    Parameters
    ----------
    name : of the study, for the case of a study of one
    quiet : whether to show sentences alone
    """

    def __init__(self, name: str, *, quiet: bool) -> None:
        self.name = name
        self.quiet = quiet
        self.bar: Any = None
        self.done = self.total = 0
        self.spoke = time.monotonic()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    def show(self, event: Event) -> None:
        """Show one event of the run; a sentence also where progress is not wanted."""
        if event.kind == "told":
            complain(event.message, OK)
            return
        if event.kind == "begun":
            self.total = event.count
        ended = event.kind in ("done", "failed", "stopped")
        self.done += ended
        if self.quiet:
            return
        place = ": ".join(filter(None, [event.label or self.name, event.message]))
        if sys.stderr.isatty():
            # not sooner: it is a thread, and workers are forked from a process that has no other
            self.bar = self.bar or _bar()
            self.bar.update(self.bar.task_ids[0], description=place, completed=self.done, total=self.total)
        elif ended and event.kind != "stopped":
            self._say(f"{event.kind} {place} ({event.seconds:.1f} s)")
        elif time.monotonic() - self.spoke >= SILENCE:
            self._say(f"at {place}, {self.done} of {self.total} done")

    def _say(self, text: str) -> None:
        self.spoke = time.monotonic()
        tell(text)


def _bar() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    # no time that remains: pieces differ a thousandfold
    columns = (BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn())
    what = TextColumn("{task.description}", markup=False)
    bar = Progress(*columns, what, console=Console(stderr=True), transient=True)
    bar.start()
    bar.add_task("starting", total=None)
    return bar
