"""When and where the times of a model were measured, in the words that stand beside them."""

from __future__ import annotations

from collections.abc import Collection

from ..machine.processors import processor_name
from ..measures.case import CaseResult, Run

EARLIER, ELSEWHERE = "earlier run", "another machine"


def measured(run: Run, name: str) -> list[str]:
    """What is said of a model's times: nothing where all are of the run that did the others, on this machine."""
    cases = [case for case in run.cases if name in case.models]
    kept = resumed(run)
    marks = {
        EARLIER: any(is_earlier(case, name, kept) for case in cases),
        ELSEWHERE: any(is_elsewhere(case, name) for case in cases),
    }
    return [mark for mark, found in marks.items() if found]


def resumed(run: Run) -> set[str]:
    """Hashes of the cases that were done before the last run that did others."""
    return set(run.plan.get("resumed", ()))


def is_earlier(case: CaseResult, name: str, kept: Collection[str]) -> bool:
    """Whether a result was not measured beside the others; `kept` are the cases that are resumed."""
    return case.hash in kept or "measured_earlier" in case.models[name].parameters


def is_elsewhere(case: CaseResult, name: str) -> bool:
    """Whether a result is known to be measured on another machine than this one."""
    measured_on = case.models[name].parameters.get("measured_on", case.provenance.get("processor", ""))
    return measured_on not in ("", processor_name())
