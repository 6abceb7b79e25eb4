"""The report's table of mean strains: there where a case has fibres, with the numbers of the store."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.example_case import asked
from tests.report.runs import make_case, make_run
from vdmbench.measures.case import CaseResult, MetricSeries
from vdmbench.report.section_measures import anisotropy_of_the_response
from vdmbench.verdict.digest import Digest


def fibrous(strains: dict[str, tuple[float, float, float]]) -> CaseResult:
    """A case with fibres whose models have these mean strains at full load."""
    case = make_case({"vdm-paper": 0.5, "bem": 0.1}, steps=(0.5, 1.0))
    metrics = {
        name: {
            **case.metrics[name],
            **{
                f"mean_strain_{axis}": MetricSeries(np.array([0.5 * value, value]), "1", "", 1)
                for axis, value in zip("xyz", values, strict=True)
            },
        }
        for name, values in strains.items()
    }
    case = asked(case, anisotropy={"fibre_direction": [1, 0, 0], "contrast": 4})
    return dataclasses.replace(case, metrics={**case.metrics, **metrics})


def test_strains_and_their_ratio() -> None:
    case = fibrous(
        {
            "vdm-paper": (0.012, 0.024, -0.036),
            "fem-linear": (0.01, 0.04, -0.05),
            "bem": (np.nan, np.nan, np.nan),
        }
    )
    section = anisotropy_of_the_response(Digest(make_run([case])))
    assert section is not None
    table = section.blocks[0]
    rows = {row[1].text: [cell.text for cell in row[2:]] for row in table.rows}
    assert rows == {
        "vdm-paper": ["+1.20 %", "+2.40 %", "−3.60 %", "0.500"],
        "fem-linear": ["+1.00 %", "+4.00 %", "−5.00 %", "0.250"],
    }
    assert [row[2].value for row in table.rows] == [0.012, 0.01]


def test_nothing_without_fibres() -> None:
    assert anisotropy_of_the_response(Digest(make_run([make_case({"vdm-paper": 0.5})]))) is None
