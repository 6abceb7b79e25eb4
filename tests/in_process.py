"""The nodes of a plan, done in this process."""

from __future__ import annotations

from collections.abc import Sequence

from vdmbench.graph.engine import Outcome, run_nodes
from vdmbench.graph.local import HerePlaces
from vdmbench.graph.nodes import graph
from vdmbench.graph.plan import Plan, PlannedCase


def outcomes_of(plan: Plan, cases: Sequence[PlannedCase] | None = None, jobs: int = 1) -> list[Outcome]:
    """What becomes of the nodes that these cases need, of all that are missing by default."""
    nodes = graph(plan, plan.cases_to_run() if cases is None else cases, jobs, run=f"{id(plan)}")
    return list(run_nodes(nodes, HerePlaces(), plan.directory / "failed", started=lambda _: None))


def do_cases(plan: Plan, cases: Sequence[PlannedCase] | None = None, jobs: int = 1) -> None:
    """The same where all are to succeed."""
    failed = [outcome for outcome in outcomes_of(plan, cases, jobs) if not outcome.ok]
    assert not failed, failed
