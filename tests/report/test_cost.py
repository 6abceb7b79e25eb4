"""Times that are not simply those of a solve in this run are marked where they are shown."""

import dataclasses
import json
import re
from html import unescape

import pytest

from tests.report.runs import REFERENCE, make_case, make_run, measured_anew, of_model
from vdmbench.machine import processor_name
from vdmbench.measures.case import CaseResult
from vdmbench.report.blocks import Figures, note
from vdmbench.report.headline import _table, headline_metrics
from vdmbench.report.section_charts import run_time_against_error
from vdmbench.scene.result import FrameTimes
from vdmbench.verdict.digest import ELSEWHERE, ONCE, Digest


def _case(processor: str) -> CaseResult:
    """A case of two models, run on a processor."""
    case = make_case({"vdm-m": 0.1}, subdivisions=1)
    return dataclasses.replace(case, provenance={**case.provenance, "processor": processor})


HERE = processor_name()


@pytest.mark.parametrize(("processor", "marks"), [(HERE, [ONCE]), ("Abacus 3", [ELSEWHERE, ONCE])])
def test_times_say_when_where_and_how(processor: str, marks: list[str]) -> None:
    shown = make_run([_case(processor)])
    rows = {row[0].text: "\n".join(cell.detail for cell in row[1:]) for row in _table(Digest(shown)).rows}
    for name in ("vdm-m", REFERENCE):
        for time in ("seconds_setup", "seconds_per_step"):
            told = headline_metrics(shown)[name][time]
            assert (told["measured"], told["cases"]) == (marks, 1)
        assert ("another machine" in rows[name]) == (ELSEWHERE in marks)
    text = note("times", list(Digest(shown).figures.values())).text
    assert ("another machine, compare" in text) == (ELSEWHERE in marks)


def test_a_line_joins_measured_frames_with_no_time_of_one_answer() -> None:
    """Of the second mesh no frame was measured: a step of its answer is no mark on the line of what was."""
    fine = dataclasses.replace(make_case({"vdm-m": 0.1}, subdivisions=2), hash="cd" * 32)
    for cases, marks in (([measured_anew(_case(HERE)), fine], 1), ([_case(HERE), fine], 2)):
        section = run_time_against_error(Digest(make_run(cases)))
        (chart, *_) = next(block for block in section.blocks if isinstance(block, Figures)).figures
        told = re.search('data-told="([^"]+)"', chart.svg)
        assert len(json.loads(unescape(told[1]))) == marks


def test_frames_that_were_measured_in_turns_stand_for_all_times() -> None:
    case = measured_anew(_case("Abacus 3"))
    digest = Digest(make_run([case]))
    cost = digest.figures["vdm-m"]
    assert cost.marks == ()
    assert (cost.frame, cost.everywhere) == (4e-4, 8e-4)

    def marks(frames: FrameTimes | None) -> tuple[str, ...]:
        return Digest(make_run([of_model(case, "vdm-m", frames=frames)])).figures["vdm-m"].marks

    elsewhere = dataclasses.replace(case.models["vdm-m"].frames, processor="Abacus 3")
    assert marks(elsewhere) == (ELSEWHERE,)
    assert marks(None) == (ELSEWHERE, ONCE)
