"""README's table of what breaks where: it names the shipped studies' own parameters and solvers."""

from __future__ import annotations

import pytest

from tests.report.runs import make_case, make_run
from tools import marked, stability
from vdmbench.study.config import expand, load_study
from vdmbench.verdict.formatting import parameter_name


def test_the_table_is_about_the_shipped_studies() -> None:
    shown = marked.cells(marked.shown(stability.DOCUMENT, stability.PART))[1:]
    assert shown
    for name in stability.stability_studies():
        study = load_study(stability.CASES / f"{name}.toml")
        cases = expand(study)
        base = cases[0].swept
        keys = {key for case in cases for key, value in case.swept.items() if base.get(key) != value}
        mine = [row for row in shown if row[0] == name]
        assert {row[1] for row in mine} == {parameter_name(key) for key in keys}, (
            f"{name}: run `make evidence WHAT=stability`"
        )
        for _, parameter, _, stand, breaks in mine:
            right, count = (int(number) for number in stand.split(" of "))
            named = set(breaks.split("`")[1::2])
            own = parameter.startswith(("penalty of",))
            assert count == (1 if own else len(study.study.models)), (
                f"{name}: run `make evidence WHAT=stability`"
            )
            assert named <= set(study.study.models)
            assert len(named) == count - right


def ladder_run(*, wrong: float) -> stability.Run:
    """Two solvers along three Poisson ratios: LU stops at the last, or is off by `wrong` there."""
    key = "tissue.poisson_ratio"

    def case(ratio: float, lu: float = 0.0, stopped: dict[str, int] | None = None):
        return make_case(
            {"vdm-paper": 0.0, "vdm-paper:lu": lu},
            label=f"{ratio}",
            swept={key: ratio},
            steps=(1.0,),
            reference=None,
            stopped=stopped,
            subdivisions=0,
        )

    last = case(0.5, lu=wrong) if wrong else case(0.5, stopped={"vdm-paper:lu": 0})
    return make_run([case(0.3), case(0.4), last], sweep="one-at-a-time")


def test_rows_say_who_stands_it_and_who_breaks_down() -> None:
    assert stability.rows(ladder_run(wrong=0.0)) == [
        ["ball", "Poisson ratio", "0.3 to 0.5", "1 of 2", "0.5 (diverged): `vdm-paper:lu`"]
    ]


def test_a_silent_wrong_number_is_not_written_down() -> None:
    with pytest.raises(RuntimeError, match=r"vdm-paper:lu is wrong in silence along tissue\.poisson_ratio"):
        stability.rows(ladder_run(wrong=0.01))
