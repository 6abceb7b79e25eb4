"""What processes of their own do, done in this one: the tasks of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path

from vdmbench.work.plan import Plan, PlannedCase
from vdmbench.work.pool import run_tasks
from vdmbench.work.tasks import Task, tasks_of
from vdmbench.work.worker import Said, do_task


class HerePool:
    """This process itself: nothing is started, and nothing stops what does not end or crashes."""

    count = 1

    def submit(self, task: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Pool`."""
        future: Future[str] = Future()
        future.set_result(do_task(task))
        return future


def outcomes_of(plan: Plan, cases: Sequence[PlannedCase] | None = None) -> list[tuple[Task, Said]]:
    """What becomes of the tasks that these cases need, of all that are missing by default."""
    tasks = tasks_of(plan, plan.cases_to_run() if cases is None else cases)
    return list(run_tasks(tasks, HerePool(), plan.directory / "failed"))


def do_cases(plan: Plan, cases: Sequence[PlannedCase] | None = None) -> None:
    """The same where all are to succeed."""
    failed = [(task.label, said) for task, said in outcomes_of(plan, cases) if not said.ok]
    assert not failed, failed
