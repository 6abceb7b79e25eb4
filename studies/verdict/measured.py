"""When and where the times of a model were measured, in the words that stand beside them."""

from __future__ import annotations

from ..machine.processors import processor_name
from ..measures.case import Run

EARLIER, ELSEWHERE, ONCE = "earlier run", "another machine", "one answer"


def measured(run: Run, name: str) -> tuple[str, ...]:
    """What is said of a model's times: nothing where all are of the run that did the others, on this machine."""
    resumed = set(run.plan.get("resumed", ()))  # cases that were done before the last run that did others
    found = set()
    anew = any(model.frames is not None for case in run.cases for model in case.models.values())
    for case in (case for case in run.cases if name in case.models):
        told = case.models[name].parameters
        if (frames := case.models[name].frames) is not None:
            if frames.processor != processor_name():
                found.add(ELSEWHERE)
            continue
        if anew:
            found.add(ONCE)
        if case.hash in resumed or "measured_earlier" in told:
            found.add(EARLIER)
        if told.get("measured_on", case.provenance.get("processor", "")) not in ("", processor_name()):
            found.add(ELSEWHERE)
    return tuple(mark for mark in (EARLIER, ELSEWHERE, ONCE) if mark in found)
