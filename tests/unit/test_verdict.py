"""The verdict and its answers, against runs whose errors are known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.unit.typed_study import asked, typed_study
from vdmbench.measures.case import CaseResult, Limit, ModelLimits, Run, SmallStrainLimits
from vdmbench.report.headline import headline_rows
from vdmbench.study.config import resolved
from vdmbench.study.fields import targets
from vdmbench.study.registry import PARAMETERS
from vdmbench.verdict.acceptance import BEYOND, LOST, OPEN, WITHIN, acceptance
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.sentences import COST, DO, GOOD, LOAD, SURE, USE, WHY, WITH, answers
from vdmbench.verdict.verdict import verdict

from .report_runs import REFERENCE, make_case, make_run

LINEAR_REFERENCE = (
    "The reference is linear, so the errors of linear models do not grow with the load. Where small strain ends, "
    'reference = "fem" tells.'
)


def told(run: Run) -> dict[str, str]:
    """Question -> answer in one line."""
    return {
        a.question: " ".join([*([f"{a.word}."] if a.word else []), *a.sentences])
        for a in answers(verdict(Digest(run)))
    }


def bars(vector: float, deformation: float | None = None) -> dict[str, float]:
    return {
        "gci:relative_l2_displacement_error": vector,
        "gci:relative_l2_deformation_error": vector if deformation is None else deformation,
    }


def with_parameters(case: CaseResult, model: str, **parameters: float | str) -> CaseResult:
    changed = dataclasses.replace(case.models[model], parameters=parameters)
    return dataclasses.replace(case, models={**case.models, model: changed})


@pytest.mark.parametrize(
    ("error", "measured", "state", "words"),
    [
        (0.09, {}, WITHIN, "Yes. vdm-m is within 10 % (no error bar)."),
        (0.11, {}, BEYOND, "No. vdm-m is not within 10 % (no error bar)."),
        (
            0.095,
            bars(0.004),
            WITHIN,
            "Yes. vdm-m is within 10 %. Displacement error: yes, 9.5 % ± 0.4 % of 10 %",
        ),
        (
            0.095,
            bars(0.006),
            OPEN,
            "Undecided. vdm-m is within 10 % or not: the reference is too uncertain to tell.",
        ),
        (0.095, bars(0.004, 0.006), OPEN, "Undecided. "),
        (0.105, bars(0.006), OPEN, "Undecided. "),
        (0.105, bars(0.004), BEYOND, "No. vdm-m is not within 10 %. "),
    ],
)
def test_the_references_own_error_counts(
    error: float, measured: dict[str, float], state: str, words: str
) -> None:
    case = make_case({"vdm-m": error}, reference_error=measured, subdivisions=1)
    assert acceptance(typed_study()).state(case, "vdm-m", 3) == state
    assert told(make_run([case]))[GOOD].startswith(words)


def test_a_model_that_has_no_answer_is_not_good_enough() -> None:
    case = make_case({"vdm-m": 0.01}, stopped={"vdm-m": 3}, swept={"k": 1.0}, subdivisions=1)
    assert acceptance(typed_study()).state(case, "vdm-m", 3) == LOST
    other = make_case({"vdm-m": 0.01}, swept={"k": 2.0}, subdivisions=1)
    text = told(make_run([case, other]))
    assert text[GOOD].startswith(
        "In part. vdm-m is within 10 % in 1 of 2 cases (no error bar): those at k 1 are not. "
    )
    assert "; 1 within and 1 without an answer. Change of shape: in part, 1 % of 10 %" in text[GOOD]
    assert text[WHY].startswith(
        "No answer in 1 of 2 cases: the volume could not be held. What helps: take smaller load steps."
    )
    assert "No answer at some load or at all: vdm-m in 1 case." in text[SURE]


def partly_answered(*errors: tuple[float, float]) -> Run:
    """vdm-a and vdm-b by case; NaN where one stops before full load."""
    return make_run(
        [
            make_case(
                dict(zip(("vdm-a", "vdm-b"), pair, strict=True)),
                label=str(k),
                swept={"k": float(k)},
                stopped={n: 3 for n, e in zip(("vdm-a", "vdm-b"), pair, strict=True) if math.isnan(e)},
                subdivisions=1,
            )
            for k, pair in enumerate(errors)
        ]
    )


def test_who_answers_few_cases_is_not_the_closest() -> None:
    few = partly_answered((0.03, 0.12), *[(math.nan, 0.12)] * 3)
    assert Digest(few).focus == "vdm-b"
    text = told(few)
    assert text[GOOD].startswith(
        "No. vdm-b, the closest of 2 VDM models, is within 10 % in none of 4 cases (no error bar)."
    )
    assert text[WITH].endswith(
        "Displacement errors of the others (medians): vdm-a 3 % (in the 1 of 4 cases with an answer)."
    )
    names = [row["model"] for row in headline_rows(few)]
    assert names == ["vdm-a (incomplete in 3 cases)", "vdm-b", f"{REFERENCE} (reference)"]
    # one case lost of four is no reason to call one that is four times further off the closest
    assert Digest(partly_answered((math.nan, 0.12), *[(0.03, 0.12)] * 3)).focus == "vdm-a"
    # where none answers half of the cases: who answers most
    assert Digest(partly_answered((0.03, math.nan), *[(math.nan, math.nan)] * 3)).focus == "vdm-a"
    rare = partly_answered((0.03, math.nan), (math.nan, 0.12), (math.nan, 0.12), *[(math.nan, math.nan)] * 3)
    assert Digest(rare).focus == "vdm-b"


def with_deformation(case: CaseResult, **errors: float) -> CaseResult:
    """The case with other deformation errors, by the model's name without `vdm-`."""
    name = "relative_l2_deformation_error"
    metrics = {
        model: entries | {name: dataclasses.replace(entries[name], values=np.full(4, errors[model[4:]]))}
        for model, entries in case.metrics.items()
        if model[4:] in errors
    }
    return dataclasses.replace(case, metrics={**case.metrics, **metrics})


def test_a_form_is_judged_by_the_larger_of_its_errors() -> None:
    """vdm-b displaces better and deforms far worse: it does not turn "undecided" into "no"."""
    alone = make_case({"vdm-a": 0.08}, reference_error=bars(0.01), subdivisions=1)
    both = make_case({"vdm-a": 0.08, "vdm-b": 0.06}, reference_error=bars(0.01), subdivisions=1)
    alone, both = with_deformation(alone, a=0.095), with_deformation(both, a=0.095, b=0.3)
    rest = "is within 10 % or not: the reference is too uncertain to tell."
    assert told(make_run([alone]))[GOOD].startswith(f"Undecided. vdm-a {rest}")
    assert told(make_run([both]))[GOOD].startswith(f"Undecided. vdm-a, the closest of 2 VDM models, {rest}")


def test_who_moves_as_a_rigid_reference_does_is_judged_by_displacement() -> None:
    case = make_case({"vdm-a": 0.04, "vdm-b": 0.06}, subdivisions=1)
    assert Digest(make_run([with_deformation(case, a=math.nan, b=math.nan)])).focus == "vdm-a"


def test_one_more_form_never_makes_the_answer_worse() -> None:
    """Errors around the tolerance, bars as wide as they are, forms without an answer: drawn, for 1 to 3 cases."""
    rng = np.random.default_rng(17)
    order = ["Yes", "In part", "Undecided", "No", ""]  # the last: no answer to judge
    names, seen = ("a", "b", "c"), set()
    for _ in range(150):
        cases = []
        for k in range(rng.integers(1, 4)):
            errors = rng.uniform(0.02, 0.2, (2, 3))
            stopped = {f"vdm-{n}": 3 for n in names if rng.random() < 0.2}
            cases.append(
                with_deformation(
                    make_case(
                        {f"vdm-{n}": e for n, e in zip(names, errors[0], strict=True)},
                        label=str(k),
                        swept={"k": float(k)},
                        stopped=stopped,
                        reference_error=bars(*rng.uniform(0.0, 0.08, 2)),
                        subdivisions=0,
                    ),
                    **dict(zip(names, errors[1], strict=True)),
                )
            )
        words = [verdict(Digest(make_run([only(case, names[:n]) for case in cases]))).word for n in (1, 2, 3)]
        seen |= set(words)
        assert [order.index(w) for w in words] == sorted((order.index(w) for w in words), reverse=True), words
    assert seen == set(order)


def only(case: CaseResult, names: Sequence[str]) -> CaseResult:
    """The case with some of its forms, a to c."""
    left = {REFERENCE, *(f"vdm-{name}" for name in names)}
    return dataclasses.replace(
        case,
        models={name: result for name, result in case.models.items() if name in left},
        metrics={name: found for name, found in case.metrics.items() if name in left},
    )


def test_a_lost_case_is_neither_within_nor_beyond() -> None:
    run = partly_answered((0.2, math.nan), (math.nan, math.nan), (0.3, math.nan))
    assert told(run)[GOOD].startswith(
        "No. vdm-a is within 10 % in none of 3 cases (no error bar). Displacement error: no, 30 % of 10 % allowed "
        "in the worst case (2); 2 beyond and 1 without an answer."
    )


def test_within_in_no_case_is_not_in_part() -> None:
    cases = [
        make_case({"vdm-m": error}, swept={"k": error}, reference_error=bars(0.01), subdivisions=1)
        for error in (0.2, 0.101, 0.3)
    ]
    assert told(make_run(cases))[GOOD].startswith(
        "Undecided. vdm-m is surely within 10 % in none of 3 cases. Displacement error: undecided, 30 % ± 1 % of "
    )


def test_the_parameter_that_decides_is_named_only_if_it_does() -> None:
    def run(errors: Mapping[tuple[float, float], float]) -> Run:
        return make_run(
            [
                make_case(
                    {"vdm-m": e}, label=f"{a} {b}", swept={"tissue.poisson_ratio": a, "b": b}, subdivisions=0
                )
                for (a, b), e in errors.items()
            ]
        )

    decides = run({(0.3, 1.0): 0.2, (0.3, 2.0): 0.3, (0.49, 1.0): 0.05, (0.49, 2.0): 0.06})
    assert "in 2 of 4 cases (no error bar): those at Poisson ratio 0.3 are not." in told(decides)[GOOD]
    mixed = run({(0.3, 1.0): 0.2, (0.3, 2.0): 0.05, (0.49, 1.0): 0.05, (0.49, 2.0): 0.2})
    assert "those at" not in told(mixed)[GOOD]


def test_the_verdict_is_about_vdm_even_where_elements_are_closer() -> None:
    case = make_case({"vdm-a": 0.3, "vdm-b": 0.2, "fem-condensed": 0.01})
    quick = dataclasses.replace(
        case.models["fem-condensed"], seconds_per_step=case.models["vdm-b"].seconds_per_step / 4
    )
    run = make_run([dataclasses.replace(case, models={**case.models, "fem-condensed": quick})])
    text = told(run)
    assert text[GOOD].startswith("No. vdm-b, the closest of 2 VDM models, is not within 10 % (no error bar).")
    assert text[DO].startswith(
        "Take fem-condensed (1 % off in displacement and 1 % in change of shape, 200 µs per frame after 60 ms of "
        "set-up). It is within the limits."
    )


def test_a_yes_names_what_is_closer_and_faster() -> None:
    def advice(frame: float, stopped: Mapping[str, int] | None = None) -> str:
        cases = [
            make_case({"vdm-b": 0.05, "fem-condensed": 0.01}, swept={"k": k}, stopped=s, subdivisions=0)
            for k, s in ((1.0, None), (2.0, stopped))
        ]
        quick = [
            dataclasses.replace(c.models["fem-condensed"], seconds_per_step=np.full(4, frame)) for c in cases
        ]
        return verdict(
            Digest(
                make_run(
                    [
                        dataclasses.replace(c, models={**c.models, "fem-condensed": q})
                        for c, q in zip(cases, quick, strict=True)
                    ]
                )
            )
        ).advice

    assert advice(1e-4).startswith("Take fem-condensed (1 % off ")
    assert advice(1e-4).endswith("It is closer and faster per frame.")
    own = "Take vdm-b: 400 µs per frame after 20 ms of set-up."
    assert advice(1e-3) == own, "closer but slower"
    assert advice(1e-4, {"fem-condensed": 0}) == own, "it has no answer in one of two"


def test_a_history_tells_the_load_up_to_which_a_model_is_within() -> None:
    case = make_case({"vdm-m": 0.05}, subdivisions=3)
    growing = dataclasses.replace(
        case.metrics["vdm-m"]["relative_l2_displacement_error"], values=case.load_factors * 0.15
    )
    metrics = {**case.metrics, "vdm-m": {**case.metrics["vdm-m"], "relative_l2_displacement_error": growing}}
    text = told(make_run([dataclasses.replace(case, metrics=metrics)]))[LOAD]
    # 3.75 %, 7.5 %, 11.25 % and 15 %; half of 0.5 N
    assert text.startswith(
        "Within 10 % up to 0.25 N (1 mm of indentation). Not beyond that; tried: 0.125 to 0.5 N."
    )
    whole = told(make_run([case]))[LOAD]
    assert whole.startswith("Within 10 % up to the largest load tried, 0.5 N (2 mm of indentation).")
    none = told(make_run([make_case({"vdm-m": 0.2}, subdivisions=0)]))[LOAD]
    assert none.startswith("Not within 10 % at any of the loads tried (0.125 to 0.5 N).")


def test_a_swept_load_tells_it_too() -> None:
    def run(errors: list[float], bar: float = math.nan) -> str:
        cases = [
            make_case(
                {"vdm-m": error},
                label=str(k),
                swept={"constraints.finger.force": 0.1 * (k + 1)},
                units={"constraints.finger.force": "N"},
                steps=(1.0,),
                subdivisions=0,
                contact={"force": 0.1 * (k + 1)},
                reference_error=bars(bar),
            )
            for k, error in enumerate(errors)
        ]
        return told(make_run(cases))[LOAD]

    depth = "1.17 mm of indentation"
    up_to = run([0.02, 0.05, 0.2])
    assert up_to.startswith(f"Within 10 % up to 0.2 N ({depth}). Not beyond that; tried: 0.1 to 0.3 N.")
    assert run([0.02, 0.05]).startswith(f"Within 10 % up to the largest load tried, 0.2 N ({depth}).")
    assert run([0.3, 0.05]).startswith(
        "Not within 10 % at any of the loads tried (0.1 to 0.2 N): the cases at force of finger 100 mN are not."
    )
    undecided = "Not surely within 10 % at any of the loads tried (0.1 to 0.2 N)."
    assert run([0.09, 0.08], bar=0.03).startswith(undecided)


def test_the_depth_is_what_every_case_reaches() -> None:
    cases = [
        make_case(
            {"vdm-m": 0.05},
            swept={"k": load},
            load=load,
            contact={"force": 0.5},
            steps=(1.0,),
            subdivisions=0,
        )
        for load in (1.0, 2.0)
    ]
    reached = verdict(Digest(make_run(cases))).up_to
    assert reached is not None
    assert (reached.load, reached.unit, reached.all) == (0.5, "N", True)
    assert_allclose(reached.deepest, 2 * reached.depth, rtol=1e-9, atol=0)


def test_a_load_that_no_case_tells_is_a_share_of_the_full_one() -> None:
    case = make_case({"vdm-m": 0.05}, subdivisions=0)
    second = {"kind": "contact", "region": "base", "force": 0.1}
    entries = [*resolved(case.study)["constraints"], second]
    text = told(make_run([asked(case, constraints=entries)]))[LOAD]
    assert text.startswith("Within 10 % up to the largest load tried, 1 of the full load (")


def test_undecided_everywhere_is_better_than_beyond_somewhere() -> None:
    cases = [
        make_case({"vdm-a": a, "vdm-b": b}, swept={"k": k}, reference_error=bars(0.01), subdivisions=0)
        for k, (a, b) in enumerate(((0.105, 0.095), (0.105, 0.095), (0.105, 0.2)))
    ]
    found = verdict(Digest(make_run(cases)))
    assert (found.word, found.model) == ("Undecided", "vdm-a")


def test_the_small_strain_limits_are_told_too() -> None:
    limit = Limit(0.05, "found", 40.0, 0.01, 0.003, 0.12)
    small = SmallStrainLimits(
        "constraints.finger.pressure", "Pa", {"vdm-m": ModelLimits(0.03, 0.001, (limit,))}
    )
    case = dataclasses.replace(make_case({"vdm-m": 0.2}, reference="fem"), small_strain=small)
    text = told(make_run([case]))[LOAD]
    assert (
        "vdm-m is 3 % ± 0.1 % off at small loads already; it is 5 % further off at 40.0 Pa ± 1 % "
        "(3.00 mm of mean indentation), where it is 8 % ± 0.1 % off."
    ) in text
    assert LINEAR_REFERENCE not in text, "this reference is of finite strain"
    assert LINEAR_REFERENCE in told(make_run([make_case({"vdm-m": 0.2})]))[LOAD]


@pytest.mark.parametrize(
    ("limits", "bar", "told"),
    [
        (
            (
                Limit(0.05, "unresolved", 3.6e3, math.nan, 0.019, 0.8),
                Limit(0.1, "found", 9e3, 0.2, 0.02, 1.0),
            ),
            0.014,
            "vdm-m is 17 % ± 1.4 % off at small loads already; it is 5 % further off at 3.60 kPa on the case's own "
            "mesh, which a finer mesh does not confirm.",
        ),
        (
            (
                Limit(0.05, "beyond", 3.6e3, math.nan, 0.019, 3.8),
                Limit(0.1, "beyond", 3.6e3, math.nan, 0.019, 3.8),
            ),
            math.nan,
            "vdm-m is 17 % off at small loads already; it is less than 5 % further off up to 3.60 kPa, as far as "
            "was looked.",
        ),
        (
            (Limit(0.05, "model-stopped", 3.6e3, math.nan, 0.019, 3.8),),
            0.014,
            "vdm-m is 17 % ± 1.4 % off at small loads already; it is less than 5 % further off up to 3.60 kPa on "
            "the case's own mesh, where its solver stops.",
        ),
        (
            (Limit(0.05, "found", 3.6e3, 0.2, 0.019, 0.5, 0.1, 0.1),),
            0.014,
            "vdm-m is 17 % ± 1.4 % off at small loads already; it is 5 % further off at 3.60 kPa ± 20 % (19.0 mm ± "
            "1.90 mm of mean indentation), where it is 22 % ± 1.4 % off.",
        ),
    ],
)
def test_a_sentence_on_limits_has_the_numbers_of_one_mesh(
    limits: tuple[Limit, ...], bar: float, told: str
) -> None:
    assert told in limits_of([("vdm-m", ModelLimits(0.17, bar, limits))])


@pytest.mark.parametrize(
    ("states", "told"),
    [
        (("found", "found"), "All of these lie above the paper's bound of 10 % strain."),
        (
            ("found", "unresolved"),
            "5 % at a largest principal strain of 12 %. All of these lie above the paper's bound of 10 % strain "
            "and a finer mesh does not confirm 1 more.",
        ),
        (
            ("unresolved", "unresolved"),
            "Where small-strain theory (fem-linear) departs from finite strain is not known: a finer mesh does not "
            "confirm it.",
        ),
    ],
)
def test_a_limit_of_small_strain_that_is_denied_is_not_held_against_the_paper(
    states: tuple[str, str], told: str
) -> None:
    own = ModelLimits(0.17, 0.01, (Limit(0.05, "beyond", 3e3, math.nan, 0.02, 3.8),))
    entries = [
        ("fem-linear", ModelLimits(0.0, 0.0, (Limit(0.05, state, 1e3, math.nan, 0.01, 0.12),)))
        for state in states
    ]
    assert told in limits_of(entries, focus=own)


def limits_of(entries: Sequence[tuple[str, ModelLimits]], focus: ModelLimits | None = None) -> str:
    """What is told of a run of one case for each entry, in which vdm-m is looked at closely."""
    cases = []
    for k, (model, entry) in enumerate(entries):
        found = {model: entry} if focus is None else {model: entry, "vdm-m": focus}
        case = make_case({"vdm-m": 0.2, "fem-linear": 0.5}, label=f"k = {k}", swept={"k": k}, reference="fem")
        small = SmallStrainLimits("constraints.finger.pressure", "Pa", found)
        cases.append(dataclasses.replace(case, small_strain=small))
    return told(make_run(cases))[LOAD]


def test_parameters_that_a_formulation_does_not_read_are_not_told() -> None:
    case = with_parameters(
        make_case({"bem": 0.05}),
        "bem",
        formulation="bem",
        shear_modulus=1667.0,
    )
    text = told(make_run([asked(case, vdm={"bulk_modulus": 700.0})]))[WITH]
    assert text == (
        "bem with shear modulus = 1.67 kPa, by rule from the tissue and the size of the body, not fitted."
    )
    text = told(make_run([asked(case, models={"bem": {"shear_modulus": 1667.0}})]))[WITH]
    assert text == "bem with shear modulus = 1.67 kPa; the study sets shear modulus."


def test_every_number_that_a_study_can_give_has_a_name_and_its_unit() -> None:
    units = {key.removeprefix("vdm."): t.unit for key, t in targets({"vdm": {}}).items() if "vdm." in key}
    del units["rotation"], units["compressibility"]  # words
    assert {key: unit for key, (_, unit) in PARAMETERS.items()} == units


def test_a_run_tells_two_times_and_no_ratio() -> None:
    plain = make_case({"vdm-m": 0.05}, subdivisions=0)
    text = told(make_run([plain]))[COST]
    assert text.startswith(
        "A frame of vdm-m takes 400 µs after 20 ms of set-up. "
        "A frame of fem-linear takes 800 ms after 2.5 s of set-up. "
    )
    assert "times faster" not in text
    assert "factors kept" not in text
    iterative = told(make_run([with_parameters(plain, REFERENCE, solver="iterative")]))[COST]
    assert "takes 800 ms after 2.5 s of set-up (solved iteratively). With its factors kept, " in iterative


def test_times_from_an_earlier_run_or_another_machine_are_marked() -> None:
    plain = make_case({"vdm-m": 0.05}, subdivisions=0)
    earlier = with_parameters(plain, REFERENCE, measured_earlier="yes")
    assert "800 ms after 2.5 s of set-up (earlier run)." in told(make_run([earlier]))[COST]
    elsewhere = with_parameters(plain, "vdm-m", measured_on="an abacus")
    assert "400 µs after 20 ms of set-up (another machine)." in told(make_run([elsewhere]))[COST]
    assert "run)" not in told(make_run([plain]))[COST]


@pytest.mark.parametrize(
    ("measured", "words"),
    [
        (bars(0.003), "at most a tenth of the difference, which counts as resolved."),
        (bars(0.005), "more than a tenth of the difference, whose size is known to that margin only."),
        ({}, "The reference's own error is not measured. levels = 2 in [uncertainty] measures it."),
    ],
)
def test_whether_the_difference_is_resolved(measured: dict[str, float], words: str) -> None:
    run = make_run([make_case({"m": 0.04}, reference_error=measured, subdivisions=0)])
    assert words in told(run)[SURE]


def test_an_order_that_is_assumed_is_named() -> None:
    measured = {**bars(0.003), "difference_01": 0.001}
    cases = [make_case({"m": 0.04}, reference_error=measured, subdivisions=0)]
    assert (
        "by 0.3 %, if it converges with order 1; levels = 3 shows the order." in told(make_run(cases))[SURE]
    )
    third = make_case({"m": 0.04}, reference_error={**measured, "difference_12": 0.004}, subdivisions=0)
    assert "order" not in told(make_run([*cases, third]))[SURE]


def test_levels_that_give_no_order_are_named() -> None:
    def case(second: float) -> CaseResult:
        measured = {**bars(0.003), "difference_01": 0.001, "difference_12": second}
        return make_case({"m": 0.04, "n": 0.02}, reference_error=measured, subdivisions=0)

    one = told(make_run([case(-0.002)]))
    assert "with a wide margin, as its mesh levels are oscillating." in one[SURE]
    assert "the others: m 4 %." in one[WITH]
    several = told(make_run([case(0.001), case(0.004), case(0.0005)]))[SURE]
    assert "with a wide margin, as its mesh levels are diverging in 2 cases." in several
    assert "mesh levels are" not in told(make_run([case(0.004)]))[SURE]


def test_what_is_not_in_the_numbers_is_said() -> None:
    failed = {"hash": "0" * 8, "label": "x", "code": "crash", "message": "m", "remedy": "r"}
    run = make_run([make_case({"m": 0.1}, subdivisions=0)])
    text = told(dataclasses.replace(run, failed=[failed], missing=["a", "b"]))[SURE]
    assert "Not in these numbers: 1 case failed and 2 cases not run yet. They may be worse" in text
    assert "Not in these numbers" not in told(run)[SURE]


def test_without_a_result_or_a_reference() -> None:
    empty = dataclasses.replace(make_run([]), missing=["a", "b"])
    text = told(empty)
    assert text[""] == "No case has a result yet, so there is nothing to compare."
    assert "2 cases not run yet" in text[SURE]
    alone = make_run([make_case({"m": 0.1}, reference=None, subdivisions=0)])
    assert told(alone)[""].startswith("No model is the reference.")
    lost = make_run([make_case({"m": 0.1}, stopped={"m": 0}, subdivisions=0)])
    text = told(lost)
    assert text[""] == "No model has a result at full load to hold against fem-linear."
    assert "m in 1 case" in text[SURE]


@pytest.mark.parametrize("error", [0.01, 0.5])
def test_nothing_is_judged_beyond_small_strain(error: float) -> None:
    def text(load: float, reference: str = REFERENCE) -> dict[str, str]:
        return told(make_run([make_case({"vdm-m": error}, load=load, reference=reference)]))

    case = make_case({"vdm-m": error}, load=8.0)
    moved = np.linalg.norm(case.models[REFERENCE].displacement[-1], axis=1).max()
    share = 100 * moved / np.ptp(case.points, axis=0).min()
    assert 15 < share < 17
    words = (
        f"Not judged. The load moves the body by {share:.0f} % of its smallest extent. The reference holds for "
        'small strain and cannot judge that. Lower the load, or take reference = "fem". vdm-m differs from '
        "fem-linear by "
    )
    assert text(8.0)[GOOD].startswith(words)
    assert not text(8.0).keys() & {WHY, DO, USE, LOAD}
    judged = "Yes. " if error < 0.1 else "No. "
    assert text(4.0)[GOOD].startswith(judged)
    assert text(8.0, "fem")[GOOD].startswith(judged), "finite strain has no such bound"


@pytest.mark.parametrize(("also_fixed", "judged"), [(False, True), (True, False)])
def test_a_body_carried_along_with_its_supports_is_judged(also_fixed: bool, judged: bool) -> None:
    case = make_case({"vdm-m": 0.01}, load=1.0)
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
    assert told(make_run([case]))[GOOD].startswith("Yes. " if judged else "Not judged. ")


def test_a_pull_is_told_by_its_largest_displacement() -> None:
    cases = [
        make_case({"vdm-m": 0.01}, label=str(k), swept={"k": float(k)}, steps=(1.0,), load=load)
        for k, load in enumerate((-0.5, -1.0))
    ]
    assert told(make_run(cases))[LOAD].startswith(
        "Within 10 % up to the largest load tried, 0.5 N (2 mm of indentation)."
    )


def test_nothing_is_judged_where_the_references_volume_is_off() -> None:
    def text(drift: float, other: float) -> str:
        cases = []
        for k, value in enumerate((drift, other)):
            case = make_case({"vdm-m": 0.01}, label=str(k), swept={"k": float(k)}, subdivisions=1)
            own = case.metrics[REFERENCE]["volume_drift"]
            changed = {"volume_drift": dataclasses.replace(own, values=value * case.load_factors)}
            cases.append(dataclasses.replace(case, metrics={**case.metrics, REFERENCE: changed}))
        return told(make_run(cases))[GOOD]

    words = "Not judged. The load changes the body's volume by 6 % in some case. The reference holds"
    assert text(0.01, -0.06).startswith(words)
    assert text(-0.04, 0.04).startswith("Yes. ")


def test_agreement_with_a_surface_model_is_not_called_accuracy() -> None:
    words = told(make_run([make_case({"vdm-b": 1e-6}, reference="vdm-paper")]))[GOOD]
    assert words.startswith("Not judged. The reference, vdm-paper, is a surface model itself. Agreement")
    assert "differs from vdm-paper by 0.0001 %" in words
