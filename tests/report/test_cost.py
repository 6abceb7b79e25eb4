"""Times that are not simply those of a solve in this run are marked where they are shown."""

from __future__ import annotations

import dataclasses

import pytest

from tests.report.runs import REFERENCE, make_case, make_run, measured_anew
from vdmbench.machine import processor_name
from vdmbench.measures.case import CaseResult
from vdmbench.report.blocks import note
from vdmbench.report.headline import _table, headline_metrics
from vdmbench.scene.result import FrameTimes
from vdmbench.verdict.digest import ELSEWHERE, ONCE, Digest


def _case(processor: str, **parameters: str) -> CaseResult:
    """A case of two models, the parameters being those of `vdm-m`."""
    case = make_case({"vdm-m": 0.1}, subdivisions=1)
    model = case.models["vdm-m"]
    marked = dataclasses.replace(model, parameters={**model.parameters, **parameters})
    models = {**case.models, "vdm-m": marked}
    return dataclasses.replace(case, models=models, provenance={**case.provenance, "processor": processor})


HERE = processor_name()


@pytest.mark.parametrize(
    ("case", "marks", "of_reference"),
    [
        (_case(HERE), [ONCE], [ONCE]),
        (_case("Abacus 3"), [ELSEWHERE, ONCE], [ELSEWHERE, ONCE]),
        (_case("Abacus 3", measured_on=HERE), [ONCE], [ELSEWHERE, ONCE]),
    ],
)
def test_times_say_when_where_and_how(case: CaseResult, marks: list[str], of_reference: list[str]) -> None:
    shown = make_run([case])
    rows = {row[0].text: "\n".join(cell.detail for cell in row[1:]) for row in _table(Digest(shown)).rows}
    for name, expected in (("vdm-m", marks), (REFERENCE, of_reference)):
        for time in ("seconds_setup", "seconds_per_step"):
            told = headline_metrics(shown)[name][time]
            assert (told["measured"], told["cases"]) == (expected, 1)
        assert ("another machine" in rows[name]) == (ELSEWHERE in expected)
    text = note("times", list(Digest(shown).figures.values())).text
    assert ("another machine, compare" in text) == (ELSEWHERE in [*marks, *of_reference])


def test_frames_that_were_measured_in_turns_stand_for_all_times() -> None:
    case = measured_anew(_case("Abacus 3", solver="iterative"))
    digest = Digest(make_run([case]))
    cost = digest.figures["vdm-m"]
    assert cost.marks == ()
    assert (cost.frame, cost.everywhere) == (4e-4, 8e-4)
    own = case.models["vdm-m"]
    assert own.frames is not None

    def marks(frames: FrameTimes | None) -> tuple[str, ...]:
        models = case.models | {"vdm-m": dataclasses.replace(own, frames=frames)}
        return Digest(make_run([dataclasses.replace(case, models=models)])).figures["vdm-m"].marks

    assert marks(dataclasses.replace(own.frames, processor="Abacus 3")) == (ELSEWHERE,)
    assert marks(None) == (ELSEWHERE, ONCE)
