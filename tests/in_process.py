"""What processes of their own do, done in this one: the nodes of a plan."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path

from vdmbench.work.engine import Outcome, run_nodes
from vdmbench.work.local import told
from vdmbench.work.nodes import graph
from vdmbench.work.plan import Plan, PlannedCase
from vdmbench.work.worker import Said, run_node


class HerePlaces:
    """One place in this process itself: nothing is started, and nothing stops what does not end or crashes."""

    count = 1

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:  # noqa: ARG002
        """See `Places`."""
        future: Future[str] = Future()
        future.set_result(run_node(node))
        return future

    def failure(self, error: BaseException, log: str) -> Said:
        """See `Places`."""
        return told(error, log)


def outcomes_of(plan: Plan, cases: Sequence[PlannedCase] | None = None, jobs: int = 1) -> list[Outcome]:
    """What becomes of the nodes that these cases need, of all that are missing by default."""
    nodes = graph(plan, plan.cases_to_run() if cases is None else cases, jobs, run=f"{id(plan)}")
    return list(run_nodes(nodes, HerePlaces(), plan.directory / "failed", started=lambda _: None))


def do_cases(plan: Plan, cases: Sequence[PlannedCase] | None = None, jobs: int = 1) -> None:
    """The same where all are to succeed."""
    failed = [outcome for outcome in outcomes_of(plan, cases, jobs) if not outcome.ok]
    assert not failed, failed
