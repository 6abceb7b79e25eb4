"""Times that are not simply those of a solve in this run are marked where they are shown."""

from __future__ import annotations

import dataclasses
import re

import pytest

from vdmbench.measures.case import CaseResult
from vdmbench.report.blocks import Figures, Table, Text
from vdmbench.report.headline import headline
from vdmbench.report.section_cost import run_time_against_error
from vdmbench.verdict.digest import Digest

from .report_runs import make_case, make_run

MODELS = ("vdm-vector", "fem-condensed", "fem-coarse")
MARKS = {
    "measured_earlier": ("fem-condensed", "earlier", "Measured earlier: fem-condensed."),
    "solver": (
        "fem-coarse",
        "iterative",
        "Solved iteratively, as suits the few loads of a study: fem-coarse.",
    ),
}


def marked(*keys: str) -> CaseResult:
    case = make_case({model: 0.1 * (k + 1) for k, model in enumerate(MODELS)}, subdivisions=1)
    models = dict(case.models)
    for key in keys:
        name = MARKS[key][0]
        value = "iterative" if key == "solver" else "yes"
        models[name] = dataclasses.replace(models[name], parameters={**models[name].parameters, key: value})
    return dataclasses.replace(case, models=models)


def details(case: CaseResult) -> dict[str, str]:
    """Model -> what stands below its times in the headline table."""
    section = headline(Digest(make_run([case])))
    assert section is not None
    table = section.blocks[0]
    assert isinstance(table, Table)
    places = [k for k, column in enumerate(table.columns) if column.title in ("Set-up", "Per frame")]
    return {row[0].text: " ".join(filter(None, (row[k].detail for k in places))) for row in table.rows}


def notes(case: CaseResult) -> str:
    section = run_time_against_error(Digest(make_run([case])))
    assert section is not None
    return " ".join(block.text for block in section.blocks if isinstance(block, Text))


@pytest.mark.parametrize("key", MARKS)
def test_a_mark_stands_at_its_model_and_is_explained(key: str) -> None:
    name, word, note = MARKS[key]
    told = details(marked(key))
    assert word in told[name]
    assert not any(text for model, text in told.items() if model != name)
    assert note in notes(marked(key))
    assert not any(other in notes(marked(key)) for k, (_, _, other) in MARKS.items() if k != key)


def test_nothing_is_marked_where_everything_was_measured_here() -> None:
    assert not any(details(marked()).values())
    assert not any(note in notes(marked()) for _, _, note in MARKS.values())


def test_the_peers_stand_in_the_figure() -> None:
    section = run_time_against_error(Digest(make_run([marked()])))
    assert section is not None
    (figures,) = (block for block in section.blocks if isinstance(block, Figures))
    for figure in figures.figures:
        told = re.search(r'aria-label="([^"]*)"', str(figure.svg))
        assert told is not None
        for model, error in zip(MODELS, (10, 20, 30), strict=True):
            assert re.search(rf"{model} \S+ \S+ per frame at {error} %", told.group(1))
