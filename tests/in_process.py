"""What processes of their own do, done in this one: the tasks of a plan."""

from concurrent.futures import Future
from pathlib import Path

from vdmbench.work.plan import Plan
from vdmbench.work.pool import run_tasks
from vdmbench.work.tasks import tasks_of
from vdmbench.work.worker import do_task


class HerePool:
    """This process itself: nothing is started, and nothing stops what does not end or crashes."""

    count = 1

    def submit(self, task: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Pool`."""
        future: Future[str] = Future()
        future.set_result(do_task(task))
        return future


def do_cases(plan: Plan) -> None:
    """All tasks that are missing, which are to succeed."""
    done = run_tasks(tasks_of(plan, plan.cases_to_run()), HerePool(), plan.directory / "failed")
    failed = [(task.label, said) for task, said in done if not said.ok]
    assert not failed, failed
