"""Why a model is not within its limits: each cause on a run that shows it and on one that does not."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from solver_common.solution import Status
from tests.unit.typed_study import asked
from vdmbench.measures.case import CaseResult, MetricSeries, Run
from vdmbench.measures.metrics import DEFORMATION, METRICS, VECTOR, History, evaluate
from vdmbench.study.registry import family_of
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import Verdict, Verdicts, verdicts
from vdmbench.verdict.why_not import (
    COMPRESSIBILITY,
    MESH,
    MODEL,
    NO_ANSWER,
    NOT_TOLD,
    REFERENCE,
    SMALL_STRAIN,
    TIME,
    reasons,
)

from .report_runs import make_case, make_run, measured_anew

STEPS = (0.05, 0.5, 1.0)
OFF_BY = {"gci:relative_l2_displacement_error": 0.01, "gci:relative_l2_deformation_error": 0.01}


def verdict(digest: Digest, model: str = "vdm-vector") -> Verdict:
    """The verdict of a model's family."""
    return verdicts(digest)[family_of(model)]


def causes(run: Run, model: str = "vdm-vector") -> dict[str, str]:
    """Cause -> what is said of it."""
    return {reason.cause: reason.sentence for reason in reasons(Digest(run), model)}


def growing(shares: Mapping[str, Sequence[float]], reference: str = "fem", **others: object) -> CaseResult:
    """A case in which each model's errors at the steps of `STEPS` are those given; both errors alike."""
    case = make_case(dict.fromkeys(shares, 0.0), steps=STEPS, reference=reference, subdivisions=1, **others)  # type: ignore[arg-type]
    surface = Digest(make_run([case])).surfaces[case.hash]
    true = case.models[reference]
    models, metrics = dict(case.models), dict(case.metrics)
    for name, errors in shares.items():
        u = true.displacement * (1.0 + np.array(errors))[:, None, None]
        models[name] = dataclasses.replace(case.models[name], displacement=u)
        history, other = (History(v, true.reaction_force, case.load_factors) for v in (u, true.displacement))
        values = evaluate(surface, history, other)
        metrics[name] = {
            key: MetricSeries(values[key], METRICS[key].unit, METRICS[key].definition, METRICS[key].version)
            for key in (VECTOR, DEFORMATION)
        }
    return dataclasses.replace(case, models=models, metrics=metrics)


def test_what_is_left_out_is_told_by_elements_that_leave_it_out_too() -> None:
    far = growing({"vdm-vector": (0.28,) * 3, "fem-condensed": (0.25,) * 3}, reference="fem-linear")
    assert causes(make_run([far])).keys() == {"model"}
    lump = {
        "inclusions": [{"name": "lump", "group": "a", "youngs_modulus": 1e4}],
        "study": {"name": "ball", "models": [], "homogeneous": ["vdm-vector", "fem-condensed"]},
    }
    told = causes(make_run([asked(far, **lump)]))
    assert told == {
        "left out": "What is left out: fem-condensed without lump is 25 % off in displacement "
        "and 25 % in change of shape too."
    }
    worse = growing({"vdm-vector": (0.4,) * 3, "fem-condensed": (0.25,) * 3}, reference="fem-linear")
    both = causes(make_run([asked(worse, **lump)]))
    assert both.keys() == {"model", "left out"}


def test_the_model_is_told_by_linear_elements() -> None:
    far = growing({"vdm-vector": (0.2, 0.2, 0.21), "fem-linear": (0.001, 0.005, 0.01)})
    told = causes(make_run([far]))
    assert told == {
        MODEL: "The model: at any load it is 19.8 % in displacement and 19.8 % in change of shape away from "
        "fem-linear, which is linear too."
    }
    near = growing({"vdm-vector": (0.02, 0.1, 0.21), "fem-linear": (0.001, 0.1, 0.2)})
    assert MODEL not in causes(make_run([near]))


def test_the_model_is_told_by_its_smallest_load() -> None:
    early = growing({"vdm-vector:nonlinear": (0.2, 0.2, 0.2)})
    assert causes(make_run([early]), "vdm-vector:nonlinear") == {
        MODEL: "The model: at 0.025 N, the smallest load, it is 20 % off in displacement and 20 % in change of "
        "shape."
    }
    late = growing({"vdm-vector:nonlinear": (0.02, 0.1, 0.2)})
    assert MODEL not in causes(make_run([late]), "vdm-vector:nonlinear")


def test_small_strain_has_ended_where_linear_elements_are_as_far_off() -> None:
    """As on the liver at 1 N: the boundary form 12.3 %, linear elements 11.4 %."""
    ended = growing({"vdm-vector": (0.02, 0.06, 0.123), "fem-linear": (0.001, 0.05, 0.114)})
    told = causes(make_run([ended]))
    assert told == {
        SMALL_STRAIN: "Small strain has ended: fem-linear, linear elements, is 11.4 % off in displacement and "
        "11.4 % in change of shape at this load."
    }
    small = growing({"vdm-vector": (0.2, 0.2, 0.2), "fem-linear": (0.001, 0.005, 0.01)})
    assert SMALL_STRAIN not in causes(make_run([small]))


def test_small_strain_has_ended_where_the_error_of_a_linear_model_grows() -> None:
    told = causes(make_run([growing({"vdm-vector": (0.02, 0.1, 0.21)})]))
    assert told[SMALL_STRAIN] == (
        "Small strain has ended: it is 2 % off in displacement and 2 % in change of shape at 0.025 N, and 21 % off "
        "in displacement and 21 % in change of shape at full load."
    )
    assert SMALL_STRAIN not in causes(make_run([growing({"vdm-vector": (0.2, 0.2, 0.21)})]))
    nonlinear = growing({"vdm-vector:nonlinear": (0.02, 0.1, 0.21)})
    assert SMALL_STRAIN not in causes(make_run([nonlinear]), "vdm-vector:nonlinear"), (
        "it follows large displacements"
    )


def advice(*cases: CaseResult, model: str = "vdm-vector") -> str:
    return verdict(Digest(make_run(cases)), model).advice


def test_the_advice_where_small_strain_has_ended_is_the_nonlinear_solver() -> None:
    linear = {"vdm-vector": (0.02, 0.06, 0.123), "fem-linear": (0.001, 0.05, 0.114)}
    assert advice(growing(linear)) == (
        'Add "vdm-vector:nonlinear" to the models, which follows large displacements, or lower the load.'
    )
    worse = linear | {"vdm-vector:nonlinear": (0.15, 0.15, 0.15)}
    assert advice(growing(worse)) == (
        "Lower the load: vdm-vector:nonlinear, which follows large displacements, is 15 % off in displacement and "
        "15 % in change of shape and no better."
    )
    stopped = linear | {"vdm-vector:nonlinear": (0.01, math.nan, math.nan)}
    assert advice(growing(stopped, stopped={"vdm-vector:nonlinear": 1})).startswith(
        "Lower the load: vdm-vector:nonlinear"
    )


def ratios(errors: Mapping[float, float]) -> Run:
    return make_run(
        [
            make_case(
                {"vdm-vector": error},
                label=f"nu {nu}",
                swept={"tissue.poisson_ratio": nu},
                subdivisions=0,
                steps=(1.0,),
            )
            for nu, error in errors.items()
        ]
    )


def test_compressibility_is_told_by_the_cases_that_fail() -> None:
    falling = ratios({0.3: 0.3, 0.45: 0.15, 0.49: 0.06})
    assert causes(falling)[COMPRESSIBILITY] == (
        "The tissue: the error grows as Poisson's ratio falls, and only the cases at 0.3 and 0.45 are not within. "
        "The less a tissue keeps its volume, the worse the model."
    )
    assert (
        verdict(Digest(falling)).advice
        == "Take vdm-vector for Poisson's ratios from 0.49 on. Below, take elements."
    )
    for others in ({0.3: 0.06, 0.49: 0.3}, {0.3: 0.3, 0.49: 0.2}, {0.3: 0.12, 0.4: 0.2, 0.49: 0.06}):
        assert COMPRESSIBILITY not in causes(ratios(others))


def test_a_case_that_fails_at_a_higher_ratio_is_not_the_tissues() -> None:
    """The medians fall, 9.3 % and 8.5 %, and yet it is a case at the higher ratio that is not within."""
    cases = [
        make_case(
            {"vdm-vector": e},
            label=f"{nu} {e}",
            swept={"tissue.poisson_ratio": nu},
            subdivisions=0,
            steps=(1.0,),
        )
        for nu, errors in ((0.3, (0.09, 0.095)), (0.45, (0.05, 0.12)))
        for e in errors
    ]
    assert COMPRESSIBILITY not in causes(make_run(cases))


def test_ratios_without_an_answer_are_no_warning() -> None:
    cases = [
        make_case(
            {"vdm-vector": 0.05},
            label=str(nu),
            swept={"tissue.poisson_ratio": nu},
            stopped={"vdm-vector": 0} if nu < 0.4 else None,
            subdivisions=0,
            steps=(1.0,),
        )
        for nu in (0.3, 0.35, 0.49)
    ]
    assert verdict(Digest(make_run(cases))).word == "no"


def test_what_the_mesh_takes_of_linear_elements_is_not_small_strain() -> None:
    shares = {"vdm-vector": (0.2, 0.2, 0.2), "fem-linear": (0.09, 0.09, 0.1), "fem": (0.09, 0.09, 0.09)}
    told = causes(make_run([growing(shares, reference="fem refined")], reference="fem"))
    assert SMALL_STRAIN not in told
    assert MESH in told


def test_a_body_that_swings_on_its_support_is_not_sent_to_a_solver_with_one_rotation() -> None:
    case = growing({"bem": (0.02, 0.06, 0.123), "fem-linear": (0.001, 0.05, 0.114)})
    for share, word in ((0.5, "Add"), (0.98, "Take elements that follow large displacements")):
        own = case.metrics["fem"]
        rigid = dataclasses.replace(own["rigid_share"], values=np.full(3, share))
        swung = dataclasses.replace(case, metrics={**case.metrics, "fem": {**own, "rigid_share": rigid}})
        assert advice(swung, model="bem").startswith(word)


def test_a_model_that_is_far_off_at_any_load_is_not_sent_to_its_nonlinear_solver() -> None:
    both = growing({"vdm-vector": (0.2, 0.25, 0.3), "fem-linear": (0.001, 0.05, 0.114)})
    assert {MODEL, SMALL_STRAIN} == causes(make_run([both])).keys()
    assert advice(both) == (
        "Take elements that follow large displacements, as the reference does, or a smaller load."
    )


@pytest.mark.parametrize(("coarse", "told"), [(0.08, True), (0.03, False)])
def test_the_mesh_is_told_by_the_references_own_model_on_it(coarse: float, told: bool) -> None:
    case = make_case(
        {"vdm-vector": 0.13, "fem-linear": coarse},
        reference="fem-linear refined",
        subdivisions=0,
        steps=(1.0,),
    )
    run = make_run([case], reference="fem-linear")
    found = causes(run)
    assert (MESH in found) == told
    assert (MODEL in found) != told, "what the mesh does not take, the model does"
    if told:
        assert found[MESH] == (
            "The mesh: fem-linear on the same mesh is 8 % off in displacement and 8 % in change of shape against "
            "the refined one."
        )
        wider = verdict(Digest(run))
        assert (
            wider.advice == "Take a smaller mesh_size: the mesh alone takes half of what is allowed, or more."
        )


def test_the_references_bar_is_told_where_it_decides() -> None:
    open_ = make_case({"vdm-vector": 0.095}, reference_error=OFF_BY | {"levels": 2.0}, subdivisions=0)
    found = verdict(Digest(make_run([open_])))
    assert causes(make_run([open_]))[REFERENCE] == (
        "The reference: its own error is up to 1 % in displacement and 1 % in change of shape, too wide to tell on "
        "which side of the limit it is."
    )
    assert found.advice.startswith("Set levels = 3 in [uncertainty]")
    beyond = make_case({"vdm-vector": 0.2}, reference_error=OFF_BY, subdivisions=0)
    assert REFERENCE not in causes(make_run([beyond]))


def test_no_answer_is_told_with_its_reason() -> None:
    case = make_case({"vdm-vector": 0.01}, stopped={"vdm-vector": 3}, subdivisions=0)
    told = causes(make_run([case]))
    assert told[NO_ANSWER] == (
        "No answer: the volume could not be held. What helps: take smaller load steps."
    )
    assert causes(make_run([make_case({"vdm-vector": 0.01}, subdivisions=0)])) == {}


def test_what_is_not_measured_is_asked_for() -> None:
    bare = make_case({"vdm-vector": 0.2}, reference="fem", steps=(1.0,), subdivisions=0)
    assert causes(make_run([bare])) == {
        NOT_TOLD: 'This study does not tell why. It would with "fem-linear" among the models, a small first factor '
        "in [load] and levels = 2 in [uncertainty]."
    }


def test_a_frame_that_takes_too_long_is_told() -> None:
    case = measured_anew(make_case({"vdm-vector": 0.01, "fem-condensed": 0.02}, subdivisions=0))
    run = make_run([case], acceptance={"frame_time": 3e-4})  # they take 0.4 and 0.8 ms
    assert causes(run) == {TIME: "The time: a frame takes 400 µs."}
    found = verdict(Digest(run))
    assert found.word == "no"
    assert found.advice == "Take a larger mesh_size, which makes a frame shorter, or allow more time."
    moving = next(
        entry for entry in verdicts(Digest(run)).take if entry.interaction.startswith("contacts that move")
    )
    assert moving.sentence == "No surface model answers within 300 µs per frame."
    assert causes(make_run([case], acceptance={"frame_time": 5e-4})) == {}


def test_condensed_elements_say_how_often_they_are_within() -> None:
    cases = [
        make_case({"vdm-vector": 0.3, "fem-condensed": error}, label=str(k), swept={"k": k}, subdivisions=0)
        for k, error in enumerate((0.05, 0.2))
    ]
    resting = verdicts(Digest(make_run(cases))).take[0]
    assert resting.model == "fem-condensed"
    assert resting.sentence.endswith("of set-up), within the limits in 1 of 2 cases.")


# --- a doubtful status ---


def with_message(case: CaseResult, model: str, message: str) -> Verdicts:
    status = tuple(Status("converged", message, "take the boundary form") for _ in case.load_factors)
    doubtful = dataclasses.replace(case.models[model], status=status)
    return verdicts(Digest(make_run([dataclasses.replace(case, models={**case.models, model: doubtful})])))


@pytest.mark.parametrize("model", ["vdm-vector", "fem-linear"])
def test_a_yes_carries_the_reservations_of_model_and_reference(model: str) -> None:
    case = make_case({"vdm-vector": 0.01}, subdivisions=1)
    before = verdicts(Digest(make_run([case]))).reservations
    found = with_message(case, model, "a known bending comes out 109 % wrong")
    assert found["vdm-derived"].word == "yes"
    assert set(found.reservations) - set(before) == {
        f"{model} answers with a reservation: a known bending comes out 109 % wrong.",
    }


def test_a_residual_that_is_no_solution_is_a_reservation() -> None:
    case = make_case({"vdm-vector": 0.01}, subdivisions=1)
    loose = dataclasses.replace(case.models["vdm-vector"], scalars={"relative_residual": np.full(4, 1e-3)})
    found = verdicts(
        Digest(make_run([dataclasses.replace(case, models={**case.models, "vdm-vector": loose})]))
    )
    assert found["vdm-derived"].word == "yes"
    assert any("called converged with a relative residual of 1.0e-03" in told for told in found.reservations)
