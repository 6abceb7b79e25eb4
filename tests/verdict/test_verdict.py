"""The verdicts by family, against runs whose errors are known."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from solver_common.solution import Status
from tests.report.runs import (
    REFERENCE,
    asked,
    make_case,
    make_run,
    measured_anew,
    of_metric,
    of_model,
    sweep_run,
)
from vdmbench.cli.output import print_run
from vdmbench.measures.case import CaseResult, Run
from vdmbench.study.config import resolved
from vdmbench.study.registry import family_of
from vdmbench.verdict.acceptance import BEYOND, OPEN, WITHIN
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import Remark, Verdict, verdicts
from vdmbench.verdict.words import told

MODEL = "vdm-vector"


def verdict(run: Run) -> Verdict:
    """The verdict of the model's family."""
    return verdicts(Digest(run))[family_of(MODEL)]


def bars(vector: float, deformation: float | None = None) -> dict[str, float]:
    return {
        "gci:relative_l2_displacement_error": vector,
        "gci:relative_l2_deformation_error": vector if deformation is None else deformation,
    }


@pytest.mark.parametrize(
    ("error", "measured", "state", "word"),
    [
        (0.09, {}, WITHIN, "yes"),
        (0.11, {}, BEYOND, "no"),
        (0.095, bars(0.004), WITHIN, "yes"),
        (0.095, bars(0.006), OPEN, "undecided"),
        (0.095, bars(0.004, 0.006), OPEN, "undecided"),
        (0.105, bars(0.006), OPEN, "undecided"),
        (0.105, bars(0.004), BEYOND, "no"),
    ],
)
def test_the_references_own_error_counts(
    error: float, measured: dict[str, float], state: int, word: str
) -> None:
    case = make_case({MODEL: error}, reference_error=measured, subdivisions=1)
    assert Digest(make_run([case])).standing(MODEL).tolist() == [state]
    assert verdict(make_run([case])).word == word


def swept(*errors: dict[str, float], load: Sequence[float] = (), **others: object) -> Run:
    """A case for each entry, model -> error; NaN where one stops before full load."""
    cases = []
    for k, entry in enumerate(errors):
        stopped = {name: 3 for name, error in entry.items() if math.isnan(error)}
        size = {"load": load[k]} if load else {}
        cases.append(
            make_case(
                entry, label=str(k), swept={"k": float(k)}, stopped=stopped, subdivisions=1, **size, **others
            )  # type: ignore[arg-type]
        )
    return make_run(cases)


def test_each_family_has_its_word_and_none_hides_another() -> None:
    """What stands best in one family says nothing of the others; the page's closer look is at the first."""
    run = swept({"vdm-paper": 0.7, "vdm-vector": 0.2, "vdm-consistent": 0.08, "bem": 0.02, "fem-p2": 0.01})
    found = verdicts(Digest(run))
    assert list(found) == ["vdm-printed", "vdm-derived", "surface-peers", "elements", "engines"]
    assert [one.word for one in found.values()] == ["no", "yes", "yes", "yes", "not judged"]
    assert [one.model for one in found.asked] == ["vdm-paper", "vdm-consistent", "bem", "fem-p2"]
    assert [row["word"] for row in told(found)["rows"]] == ["no", "yes", "yes", "yes"]
    assert Digest(run).focus == "vdm-paper"
    assert found.as_data()["verdicts"]["vdm-printed"]["word"] == "no"


def test_the_word_is_that_of_the_worst_judged_case() -> None:
    assert verdict(swept({MODEL: 0.01}, {MODEL: 0.2})).word == "no"
    lost = verdict(swept({MODEL: 0.01}, {MODEL: math.nan}))
    assert (lost.word, lost.counts["within"], lost.counts["without an answer"]) == ("no", 1, 1)
    open_ = verdict(swept({MODEL: 0.01}, {MODEL: 0.095}, reference_error=bars(0.01)))
    assert (open_.word, open_.counts["within"], open_.counts["undecided"]) == ("undecided", 1, 1)


def test_who_answers_few_cases_does_not_decide() -> None:
    few = {"vdm-consistent": math.nan, MODEL: 0.12}
    assert verdict(swept({"vdm-consistent": 0.03, MODEL: 0.12}, *[few] * 3)).model == MODEL
    # one case lost of four is no reason to look at one that is four times further off
    many = {"vdm-consistent": 0.03, MODEL: 0.12}
    assert verdict(swept({"vdm-consistent": math.nan, MODEL: 0.12}, *[many] * 3)).model == "vdm-consistent"


def test_who_decides_does_so_by_error_alone() -> None:
    """One is 71 % off in 0.4 ms, one 20 % in 0.8 ms, of 10 % and 0.1 ms allowed: time makes none stand better."""
    run = swept({"vdm-consistent": 0.71, MODEL: 0.2})
    found = verdict(make_run(run.cases, acceptance={"frame_time": 1e-4}))
    assert (found.word, found.model) == ("no", MODEL)


def test_one_more_model_never_makes_the_answer_worse() -> None:
    """Errors around the tolerance, bars as wide as they are, models without an answer: drawn, for 1 to 3 cases."""
    rng = np.random.default_rng(17)
    order, names = ["yes", "undecided", "no", "not judged"], ("vdm-vector", "vdm-consistent", "vdm-vector:lu")
    seen = set()
    for _ in range(15):
        cases = [
            make_case(
                dict(zip(names, rng.uniform(0.02, 0.2, 3), strict=True)),
                label=str(k),
                swept={"k": float(k)},
                stopped={name: 3 for name in names if rng.random() < 0.2},
                reference_error=bars(*rng.uniform(0.0, 0.08, 2)),
                subdivisions=0,
            )
            for k in range(rng.integers(1, 4))
        ]
        words = [verdict(make_run([only(case, names[:n]) for case in cases])).word for n in (1, 2, 3)]
        seen |= set(words)
        assert [order.index(w) for w in words] == sorted((order.index(w) for w in words), reverse=True), words
    assert {"yes", "undecided", "no"} <= seen


def only(case: CaseResult, names: Sequence[str]) -> CaseResult:
    """The case with some of its models."""
    left = {REFERENCE, *names}
    return dataclasses.replace(
        case,
        models={name: result for name, result in case.models.items() if name in left},
        metrics={name: found for name, found in case.metrics.items() if name in left},
    )


def test_a_sweep_is_judged_where_its_reference_is_in_range() -> None:
    """The last load moves the body by 17 % of its smallest extent: it alone is not judged."""
    found = verdicts(Digest(swept({MODEL: 0.01}, {MODEL: 0.02}, {MODEL: 0.5}, load=(1.0, 2.0, 8.0))))
    one = found["vdm-derived"]
    assert (one.word, sum(one.counts.values()), one.counts["within"]) == ("yes", 2, 2)
    assert list(one.states.values()) == ["yes", "yes", "not judged"]
    assert [out.name for out in found.outside] == ["2"]
    assert found.outside[0].moved == pytest.approx(0.1713, rel=1e-3)
    assert "2 of 3 cases judged" in told(found)["notes"][0]
    all_out = verdicts(Digest(swept({MODEL: 0.01}, load=(8.0,))))
    assert (all_out["vdm-derived"].word, len(all_out.outside)) == ("not judged", 1)
    assert told(all_out)["notes"][0].endswith('Lower the load, or take study.reference = "fem".')
    sagging = asked(make_case({MODEL: 0.01}, load=8.0), gravity={"acceleration": [0.0, 0.0, -9.81]})
    assert told(verdicts(Digest(make_run([sagging]))))["notes"][0].endswith(
        'that. Take study.reference = "fem".'
    )
    finite = verdict(swept({MODEL: 0.01}, load=(8.0,), reference="fem"))
    assert finite.word == "yes", "finite strain has no such bound"


def with_status(case: CaseResult, model: str, message: str) -> CaseResult:
    """The case with a message at every step of a model."""
    status = tuple(Status("converged", message, "take boundary elements") for _ in case.load_factors)
    return of_model(case, model, status=status)


@pytest.mark.parametrize("model", [MODEL, "fem-linear"])
def test_a_yes_carries_the_reservations_of_model_and_reference(model: str) -> None:
    case = make_case({MODEL: 0.01}, subdivisions=1)
    before = verdicts(Digest(make_run([case]))).reservations
    found = verdicts(Digest(make_run([with_status(case, model, "doubtful")])))
    assert found["vdm-derived"].word == "yes"
    assert set(found.reservations) - set(before) == {Remark(model, "doubtful; take boundary elements", 1)}


def test_what_is_said_of_a_part_of_the_load_names_it() -> None:
    """ "Strained by 95 %" and "by 633 %" stood one below the other, of one model."""
    case = make_case({MODEL: 0.01}, subdivisions=1)
    before = verdicts(Digest(make_run([case]))).reservations
    said = dict(zip(case.load_factors[-2:], ("slightly doubtful", "wrong"), strict=True))
    assert list(said) == [0.75, 1.0]
    status = tuple(Status("converged", said.get(factor, "")) for factor in case.load_factors)
    found = verdicts(Digest(make_run([of_model(case, MODEL, status=status)]))).reservations
    texts = {one.text for one in set(found) - set(before)}
    assert texts == {"at 75 % of the load slightly doubtful", "wrong"}


def test_a_model_that_stops_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    """Its reservation at a smaller load, why it has no answer, and why it stopped were three paragraphs."""
    case = make_case({MODEL: 0.01, "bem": 0.01}, subdivisions=1, stopped={MODEL: 3})
    doubtful = Status("converged", "doubtful")
    status = (doubtful, doubtful, doubtful, case.models[MODEL].status[3])
    run = make_run([of_model(case, MODEL, status=status)])
    assert Remark(MODEL, "at 75 % of the load doubtful", 1) not in verdicts(Digest(run)).reservations
    print_run(run, Path("runs"), Path("runs/report.html"), as_json=False)
    printed = capsys.readouterr().out
    assert printed.count("the volume could not be held") == 1
    assert f"{MODEL}: no answer: the volume could not be held." in printed


def test_answers_that_nothing_judges_have_their_reservations() -> None:
    case = dataclasses.replace(make_case({MODEL: 0.01}, subdivisions=1), reference=None)
    found = verdicts(Digest(make_run([with_status(case, MODEL, "doubtful")])))
    assert found.not_judged
    assert Remark(MODEL, "doubtful; take boundary elements", 1) in found.reservations


def test_a_history_tells_the_load_up_to_which_a_model_is_within() -> None:
    case = make_case({MODEL: 0.05}, subdivisions=3)
    name = "relative_l2_displacement_error"
    # 3.75 %, 7.5 %, 11.25 % and 15 %; half of 0.5 N
    growing = case.load_factors * 0.15
    reached = verdict(make_run([of_metric(case, MODEL, name, growing)])).up_to
    assert (reached.load, reached.unit, reached.all) == (pytest.approx(0.25), "N", False)
    assert reached.depth == pytest.approx(1e-3, rel=0.05)
    gravity = {"acceleration": [0.0, 0.0, -9.81]}
    moved = {"kind": "constrained", "region": "base", "displacement": [0.0, 0.0, 1e-3]}
    one = of_metric(case, MODEL, name, growing)
    for tables, known in (
        ({"gravity": gravity}, False),  # the sag is in the displacement
        ({"gravity": gravity | {"scanned": True}}, True),
        ({"constraints": [*resolved(case.study)["constraints"], moved]}, False),  # and so is its motion
    ):
        depth = verdict(make_run([asked(one, **tables)])).up_to.depth
        assert math.isfinite(depth) == known
    whole, none = (verdict(make_run([make_case({MODEL: e})])).up_to for e in (0.05, 0.2))
    assert (whole.all, none.none) == (True, True)
    assert verdict(make_run([make_case({MODEL: math.nan})])).up_to is None  # it answers at no load


@pytest.mark.parametrize(
    ("run", "why", "said_so"),
    [
        (make_run([]), "no case", "No case has a result yet"),
        (make_run([make_case({MODEL: 0.1}, reference=None, subdivisions=0)]), "no reference", "No model is"),
        (
            make_run([make_case({MODEL: 0.1}, stopped={MODEL: 0}, subdivisions=0)]),
            "no result",
            "No model has",
        ),
        (
            make_run([make_case({"bem": 1e-6}, reference="vdm-paper")]),
            "surface reference",
            "The reference, vdm",
        ),
    ],
    ids=["no case", "no reference", "no answer", "surface reference"],
)
def test_why_nothing_is_judged(run: Run, why: str, said_so: str) -> None:
    found = verdicts(Digest(run))
    assert found.not_judged == why
    assert {one.word for one in found.values()} == {"not judged"}
    assert told(found)["notes"][0].startswith(said_so)


def test_a_reference_whose_error_is_not_measured_is_told_beside_the_words() -> None:
    """They take that error as none, on the terminal too."""
    for known, said_so in ({}, True), (bars(0.01), False):
        run = make_run([make_case({MODEL: 0.2}, reference_error=known, subdivisions=0)])
        notes = told(verdicts(Digest(run)))["notes"]
        assert any("own error is not measured" in note for note in notes) == said_so


def test_a_load_that_no_case_reaches_is_the_one_reason_why_no_model_has_an_error() -> None:
    run = make_run([make_case({MODEL: 0.1}, stopped={REFERENCE: 1, MODEL: 1}, subdivisions=0)])
    first, *_ = told(verdicts(Digest(run)))["notes"]
    assert first.startswith("The load is not reached")


@pytest.mark.parametrize(("also_fixed", "judged"), [(False, True), (True, False)])
def test_a_body_carried_along_with_its_supports_is_judged(also_fixed: bool, judged: bool) -> None:
    case = make_case({MODEL: 0.01}, load=1.0)
    shift = np.array([0.0, 0.03, 0.0])
    ends = {"low": case.points[:, 2] < -0.04, "high": case.points[:, 2] > 0.045}
    constraints = [{"kind": "constrained", "region": "low", "displacement": shift.tolist()}]
    results = {
        name: dataclasses.replace(
            result, displacement=np.where(ends["low"][:, None], 0, result.displacement) + shift
        )
        for name, result in case.models.items()
    }
    if also_fixed:
        constraints.append({"kind": "fixed", "region": "high"})
        results = {
            name: dataclasses.replace(r, displacement=np.where(ends["high"][:, None], 0.0, r.displacement))
            for name, r in results.items()
        }
    constraints += resolved(case.study)["constraints"][1:]  # the base is let go
    case = asked(case, constraints=constraints)
    case = dataclasses.replace(case, models=results, regions={**case.regions, **ends})
    assert verdict(make_run([case])).word == ("yes" if judged else "not judged")


def test_every_limit_has_its_word_and_its_number() -> None:
    limits = {"displacement_error": 0.04, "largest_difference": 2e-4, "frame_time": 5e-4}
    run = make_run([measured_anew(case) for case in sweep_run().cases], acceptance=limits)
    found = {limit.key: limit for limit in verdicts(Digest(run))["vdm-derived"].limits}
    assert list(found) == ["displacement_error", "deformation_error", "largest_difference", "frame_time"]
    assert found["displacement_error"].word == found["frame_time"].word == "no"
    frame, difference = found["frame_time"], found["largest_difference"]
    assert (frame.value, frame.allowed, frame.unit) == (8e-4, 5e-4, "s")
    # 10.6 % of twice 2 mm
    assert difference.value == pytest.approx(0.106 * 0.004, rel=0.02)
