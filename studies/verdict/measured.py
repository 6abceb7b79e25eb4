"""When and where the times of a model were measured, in the words that stand beside them."""

from __future__ import annotations

from ..machine.processors import processor_name
from ..measures.case import CaseResult, Run

EARLIER, ELSEWHERE = "earlier run", "another machine"


def measured(run: Run, name: str) -> list[str]:
    """What is said of a model's times: nothing where all are of their case's own run, on this machine."""
    cases = [case for case in run.cases if name in case.models]
    here = processor_name()
    marks = {
        EARLIER: any("measured_earlier" in case.models[name].parameters for case in cases),
        ELSEWHERE: any(_processor(case, name) not in ("", here) for case in cases),
    }
    return [mark for mark, found in marks.items() if found]


def _processor(case: CaseResult, name: str) -> str:
    """What a result was measured on; "" where it is not known."""
    return str(case.models[name].parameters.get("measured_on", case.provenance.get("processor", "")))
