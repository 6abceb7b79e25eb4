"""Why a model is not within its limits: each cause on a run that shows it and on one that does not."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest

from tests.report.runs import asked, make_case, make_run, measured_anew, of_model
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.metrics import DEFORMATION, VECTOR, History, evaluate
from vdmbench.verdict.advice import (
    COMPRESSIBILITY,
    CUTTING,
    EXACT,
    LEFT_OUT,
    MESH,
    MODEL,
    NO_ANSWER,
    NOT_TOLD,
    REFERENCE,
    RESTING,
    SMALL_STRAIN,
    TIME,
    Reason,
    by_interaction,
    reasons,
)
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import verdicts
from vdmbench.verdict.words import said

STEPS = (0.05, 0.5, 1.0)
OFF_BY = {"gci:relative_l2_displacement_error": 0.01, "gci:relative_l2_deformation_error": 0.01}


def causes(run: Run, model: str = "vdm-vector") -> dict[str, Reason]:
    """Cause -> its reason."""
    return {reason.cause: reason for reason in reasons(Digest(run), model)}


def growing(shares: Mapping[str, Sequence[float]], reference: str = "fem", **others: object) -> CaseResult:
    """A case in which each model's errors at the steps of `STEPS` are those given; both errors alike."""
    about = {"steps": STEPS, "reference": reference, "subdivisions": 1, **others}
    case = make_case(dict.fromkeys(shares, 0.0), **about)  # type: ignore[arg-type]
    surface = Digest(make_run([case])).surfaces[case.hash]
    true = case.models[reference]
    models, metrics = dict(case.models), dict(case.metrics)
    for name, errors in shares.items():
        u = true.displacement * (1.0 + np.array(errors))[:, None, None]
        models[name] = dataclasses.replace(case.models[name], displacement=u)
        history, other = (History(v, true.reaction_force, case.load_factors) for v in (u, true.displacement))
        values = evaluate(surface, history, other)
        metrics[name] = {key: values[key] for key in (VECTOR, DEFORMATION)}
    return dataclasses.replace(case, models=models, metrics=metrics)


def told(run: Run, model: str = "vdm-vector") -> dict[str, str]:
    """Cause -> its sentence."""
    return {cause: " ".join(said("why", reason)) for cause, reason in causes(run, model).items()}


def both(reason: Reason) -> tuple[float, float]:
    """The errors of a reason."""
    return reason.numbers["displacement_error"], reason.numbers["deformation_error"]


def test_what_is_left_out_is_told_by_elements_that_leave_it_out_too() -> None:
    far = growing({"vdm-vector": (0.28,) * 3, "fem-condensed": (0.25,) * 3}, reference="fem-linear")
    assert causes(make_run([far])).keys() == {MODEL}
    lump = {
        "inclusions": [{"name": "lump", "group": "a", "youngs_modulus": 1e4}],
        "study": {"name": "ball", "models": [], "homogeneous": ["vdm-vector", "fem-condensed"]},
    }
    found = causes(make_run([asked(far, **lump)]))
    assert found.keys() == {LEFT_OUT}
    assert both(found[LEFT_OUT]) == pytest.approx((0.25, 0.25), rel=1e-9)
    assert "fem-condensed without lump is 25 % off" in told(make_run([asked(far, **lump)]))[LEFT_OUT]
    worse = growing({"vdm-vector": (0.4,) * 3, "fem-condensed": (0.25,) * 3}, reference="fem-linear")
    assert causes(make_run([asked(worse, **lump)])).keys() == {MODEL, LEFT_OUT}


def test_the_model_is_told_by_linear_elements_where_no_load_is_small() -> None:
    far = growing({"vdm-vector": (0.2, 0.2, 0.21), "fem-linear": (0.001, 0.005, 0.01)}, steps=(0.8, 0.9, 1.0))
    found = causes(make_run([far]))
    assert found.keys() == {MODEL}
    assert both(found[MODEL]) == pytest.approx((0.21, 0.21), rel=1e-9)
    assert found[MODEL].about == {"elements": "fem-linear"}
    near = growing({"vdm-vector": (0.1, 0.1, 0.21), "fem-linear": (0.1, 0.1, 0.2)}, steps=(0.8, 0.9, 1.0))
    assert causes(make_run([near])).keys() == {SMALL_STRAIN}


def test_the_model_is_told_by_its_smallest_load() -> None:
    early = make_run([growing({"vdm-vector:nonlinear": (0.2, 0.2, 0.2)})])
    assert told(early, "vdm-vector:nonlinear") == {
        MODEL: "the model: at 0.025 N, the smallest load, it is 20 % off in displacement and 20 % in change of "
        "shape."
    }
    late = growing({"vdm-vector:nonlinear": (0.02, 0.1, 0.2)})
    assert MODEL not in causes(make_run([late]), "vdm-vector:nonlinear")
    twice = growing({"vdm-vector:nonlinear": (0.2, 0.2, 0.2)}, steps=(0.5, 1.0, 2.0))
    assert MODEL in causes(make_run([twice]), "vdm-vector:nonlinear"), "small beside the largest load"


def test_a_model_without_an_answer_has_no_cause_of_an_error_and_is_not_looked_at_closely() -> None:
    errors = {"vdm-vector": 0.5, "fem-linear": 0.4}
    far = make_case(errors, reference="fem", stopped={"vdm-vector": 0})
    assert causes(make_run([far])).keys() == {NO_ANSWER}
    assert Digest(make_run([far])).focus == "fem-linear"
    assert Digest(make_run([make_case(errors, reference="fem")])).focus == "vdm-vector"
    none = make_case(errors, reference="fem", stopped=dict.fromkeys(errors, 0))
    assert Digest(make_run([none])).focus == "vdm-vector"


@pytest.mark.parametrize(
    ("errors", "fails"),
    [
        ([(0.3, 0.3), (0.45, 0.15), (0.49, 0.06)], [0.3, 0.45]),
        ([(0.3, 0.06), (0.49, 0.3)], None),
        ([(0.3, 0.3), (0.49, 0.2)], None),
        ([(0.3, 0.12), (0.4, 0.2), (0.49, 0.06)], None),
        # the medians fall, 9.3 % and 8.5 %, and yet it is a case at the higher ratio that is not within
        ([(0.3, 0.09), (0.3, 0.095), (0.45, 0.05), (0.45, 0.12)], None),
    ],
)
def test_compressibility_is_told_by_the_cases_that_fail(
    errors: list[tuple[float, float]], fails: list[float] | None
) -> None:
    """(Poisson's ratio, error) of each case."""
    about: dict[str, Any] = {"subdivisions": 0, "steps": (1.0,)}
    run = make_run(
        [
            make_case({"vdm-vector": error}, label=f"{k}", swept={"tissue.poisson_ratio": nu}, **about)
            for k, (nu, error) in enumerate(errors)
        ]
    )
    found = causes(run)
    assert (found[COMPRESSIBILITY].about == {"ratios": fails}) if fails else COMPRESSIBILITY not in found
    if fails:
        assert "the cases at 0.3 and 0.45 are not within" in told(run)[COMPRESSIBILITY]


def test_small_strain_has_ended_where_linear_elements_are_as_far_off() -> None:
    """As on the liver at 1 N: boundary elements 12.3 %, linear elements 11.4 %."""
    ended = growing({"vdm-vector": (0.02, 0.06, 0.123), "fem-linear": (0.001, 0.05, 0.114)})
    found = causes(make_run([ended]))
    assert found.keys() == {SMALL_STRAIN}
    assert both(found[SMALL_STRAIN]) == pytest.approx((0.114, 0.114), rel=1e-9)
    itself = growing({"fem-linear": (0.2, 0.2, 0.2)}, steps=(0.8, 0.9, 1.0))
    assert causes(make_run([itself]), "fem-linear").keys() == {SMALL_STRAIN}
    small = growing({"vdm-vector": (0.2, 0.2, 0.2), "fem-linear": (0.001, 0.005, 0.01)})
    assert SMALL_STRAIN not in causes(make_run([small]))


def test_small_strain_has_ended_where_the_error_of_a_linear_model_grows() -> None:
    found = causes(make_run([growing({"vdm-vector": (0.02, 0.1, 0.21)})]))[SMALL_STRAIN]
    assert both(found) == pytest.approx((0.21, 0.21), rel=1e-9)
    assert found.about["first"]["displacement_error"] == pytest.approx(0.02, rel=1e-9)
    assert found.about["load"] == pytest.approx(0.025)
    assert SMALL_STRAIN not in causes(make_run([growing({"vdm-vector": (0.2, 0.2, 0.21)})]))
    nonlinear = growing({"vdm-vector:nonlinear": (0.02, 0.1, 0.21)})
    assert SMALL_STRAIN not in causes(make_run([nonlinear]), "vdm-vector:nonlinear"), "it follows"


def test_where_small_strain_has_ended_the_nonlinear_solver_decides_if_it_is_better() -> None:
    linear = {"vdm-vector": (0.02, 0.06, 0.123), "fem-linear": (0.001, 0.05, 0.114)}
    alone = growing(linear)
    assert told(make_run([alone]))[SMALL_STRAIN].endswith(
        "A nonlinear solver or a lower load takes that away."
    )
    itself = told(make_run([alone]), "fem-linear")[SMALL_STRAIN]
    assert itself.startswith("small strain has ended: it is 11.4 % off")
    better = linear | {"vdm-vector:nonlinear": (0.01, 0.02, 0.03)}
    decided = verdicts(Digest(make_run([growing(better)])))["vdm-derived"]
    assert (decided.word, decided.model) == ("yes", "vdm-vector:nonlinear")
    worse = linear | {"vdm-vector:nonlinear": (0.02, 0.07, 0.15)}
    advised = told(make_run([growing(worse)]))[SMALL_STRAIN]
    assert advised.endswith("A lower load takes that away; vdm-vector:nonlinear does not here.")
    lost = growing(worse)
    errors = {key: np.array([0.02, np.nan, np.nan]) for key in lost.metrics["vdm-vector:nonlinear"]}
    lost = dataclasses.replace(lost, metrics={**lost.metrics, "vdm-vector:nonlinear": errors})
    assert told(make_run([lost]))[SMALL_STRAIN] == advised, "without an answer it takes nothing away either"


def test_a_model_that_is_far_off_at_any_load_says_so_beside_small_strain() -> None:
    far = growing({"vdm-vector": (0.2, 0.25, 0.3), "fem-linear": (0.001, 0.05, 0.114)})
    assert causes(make_run([far])).keys() == {MODEL, SMALL_STRAIN}


def test_a_load_beside_a_weight_is_small_only_where_it_moves_little() -> None:
    far = growing({"vdm-vector": (0.2, 0.25, 0.3), "fem-linear": (0.2, 0.25, 0.29)})
    weighed = asked(far, gravity={"acceleration": [0.0, 0.0, -9.81]})
    assert causes(make_run([weighed])).keys() == {MODEL, SMALL_STRAIN}, "it moves in proportion to the load"
    true = far.models["fem"]
    models = {**weighed.models, "fem": dataclasses.replace(true, displacement=true.displacement[[2, 2, 2]])}
    sagged = dataclasses.replace(weighed, models=models)
    assert causes(make_run([sagged])).keys() == {SMALL_STRAIN}, "the weight moves it at any load"
    assert told(make_run([weighed]))[SMALL_STRAIN].endswith(
        "A nonlinear solver or a lower load takes that away."
    )
    assert told(make_run([sagged]))[SMALL_STRAIN].endswith("A nonlinear solver takes that away.")


def test_what_the_mesh_takes_of_linear_elements_is_not_small_strain() -> None:
    shares = {"vdm-vector": (0.2, 0.2, 0.2), "fem-linear": (0.09, 0.09, 0.1), "fem": (0.09, 0.09, 0.09)}
    found = causes(make_run([growing(shares, reference="fem refined")], reference="fem"))
    assert SMALL_STRAIN not in found
    assert MESH in found


@pytest.mark.parametrize(("coarse", "by_mesh"), [(0.08, True), (0.03, False)])
def test_the_mesh_is_told_by_the_references_own_model_on_it(coarse: float, by_mesh: bool) -> None:
    errors = {"vdm-vector": 0.13, "fem-linear": coarse}
    case = make_case(errors, reference="fem-linear refined", subdivisions=0, steps=(1.0,))
    found = causes(make_run([case], reference="fem-linear"))
    assert (MESH in found) == by_mesh
    assert (MODEL in found) != by_mesh, "what the mesh does not take, the model does"
    if by_mesh:
        assert both(found[MESH]) == pytest.approx((0.08, 0.08), rel=1e-9)


@pytest.mark.parametrize(
    ("scalar", "left", "kinds"),
    [
        ("mesh_error", 0.15, {MESH}),
        ("shape_error", 0.15, {MESH}),
        ("mesh_error", 0.01, {MODEL}),
        ("", 0.15, {MODEL}),
    ],
)
@pytest.mark.parametrize("reference", ["fem", "fem-linear"])  # by the smallest load, or at any
def test_the_mesh_is_told_by_what_the_model_says_that_it_leaves_open(
    scalar: str, left: float, kinds: set[str], reference: str
) -> None:
    far = growing({"bem": (0.13, 0.13, 0.13)}, reference=reference)
    own = dataclasses.replace(far.models["bem"], scalars={scalar: np.full(3, left)} if scalar else {})
    found = causes(make_run([dataclasses.replace(far, models={**far.models, "bem": own})]), "bem")
    assert found.keys() == kinds
    if MESH in kinds:
        assert found[MESH].numbers == {"share": 1.0}


@pytest.mark.parametrize(("scalar", "kinds"), [("mesh_error", {MODEL}), ("shape_error", {MESH})])
def test_what_the_mesh_leaves_of_displacements_explains_no_change_of_shape(
    scalar: str, kinds: set[str]
) -> None:
    far = growing({"bem": (0.05, 0.05, 0.05)}, reference="fem-linear")
    own = dataclasses.replace(far.models["bem"], scalars={scalar: np.full(3, 0.5)})
    errors = {**far.metrics["bem"], DEFORMATION: np.full(3, 0.5)}
    case = dataclasses.replace(far, models={**far.models, "bem": own}, metrics={**far.metrics, "bem": errors})
    assert causes(make_run([case]), "bem").keys() == kinds


@pytest.mark.parametrize(
    ("scalars", "kinds"),
    [
        ({"mesh_error": 0.10}, {MESH}),
        ({"mesh_error": 0.01}, {MODEL}),  # in displacement; of the shape the model says nothing
        ({"mesh_error": 0.01, "shape_error": 0.01}, {MODEL}),
        ({}, {MESH}),
    ],
)
def test_a_model_that_knows_its_mesh_is_told_nothing_of_the_mesh_of_elements(
    scalars: dict[str, float], kinds: set[str]
) -> None:
    """Of boundary elements 7 % off, 10 % by their own estimate, was told that elements are 27.7 % off."""
    errors = {"bem:nonlinear": (0.13,) * 3, "fem": (0.277,) * 3}
    far = growing(errors, reference="fem refined")
    own = {key: np.full(3, value) for key, value in scalars.items()}
    run = make_run([of_model(far, "bem:nonlinear", scalars=own)], reference="fem")
    found = told(run, "bem:nonlinear")
    assert found.keys() == kinds
    assert ("27.7 %" in str(found)) is (not scalars)


def test_the_references_bar_is_told_where_it_decides() -> None:
    open_ = make_case({"vdm-vector": 0.095}, reference_error=OFF_BY | {"levels": 2.0}, subdivisions=0)
    assert causes(make_run([open_]))[REFERENCE].numbers == {
        "displacement error": 0.01,
        "change of shape": 0.01,
    }
    beyond = make_case({"vdm-vector": 0.2}, reference_error=OFF_BY, subdivisions=0)
    assert REFERENCE not in causes(make_run([beyond]))


def test_linear_elements_are_not_advised_where_they_do_not_take_the_scene() -> None:
    far = growing({"vdm-vector": (0.3,) * 3}, steps=(0.8, 0.9, 1.0))
    scanned = asked(far, gravity={"acceleration": [0.0, 0.0, -9.81], "scanned": True})
    for case, linear in ((far, True), (scanned, False)):
        run = make_run([case])
        assert ("fem-linear" in told(run)[NOT_TOLD]) is linear
        (exact,) = (advice for advice in by_interaction(Digest(run)) if advice.interaction == EXACT)
        assert ("fem-linear" in " ".join(said("take", exact))) is linear


def test_of_what_no_cause_is_seen_only_what_the_study_has_not_is_said_to_tell_more() -> None:
    def shown(model: str, *, reference: str = "fem", weight: bool = False) -> str:
        far = growing({model: (0.3,) * 3}, steps=(0.8, 0.9, 1.0), reference=reference)
        case = asked(far, gravity={"acceleration": [0.0, 0.0, -9.81]}) if weight else far
        return told(make_run([case]), model)[NOT_TOLD].partition("More is told by ")[2]

    end = "uncertainty.levels = 2."
    elements, load = "fem-linear among the models", "a small first factor in [load]"
    assert shown("vdm-vector") == f"{elements}, {load} and {end}"
    assert shown("vdm-vector", weight=True) == f"{elements} and {end}", (
        "a weight is no smaller beside a small load"
    )
    # linear elements tell nothing of a nonlinear model
    assert shown("bem:nonlinear") == shown("bem:nonlinear", reference="fem-linear") == f"{load} and {end}"
    assert shown("bem:nonlinear", weight=True) == end


def test_a_reference_of_linear_elements_is_not_missed_among_the_models() -> None:
    for reference, text in (
        ("fem-linear", "fem-linear: the reference's own numbers, on its mesh"),
        ("fem", "elements; fem-linear on the model's mesh is not among the models compared"),
    ):
        run = make_run([make_case({"bem": 0.02}, reference=reference, subdivisions=0)])
        assert said("take", by_interaction(Digest(run))[-1]) == [text]


def test_nobody_is_told_to_take_a_model_that_is_not_within_the_limits() -> None:
    """A model in time was named though it was 706 % off; another for the shortest set-up."""
    near = measured_anew(make_case({"vdm-paper": 7.06, "bem": 0.02}, reference="fem", subdivisions=0))
    far = measured_anew(make_case({"vdm-paper": 7.06, "fem-linear": 0.5}, reference="fem", subdivisions=0))

    def taken(case: CaseResult, limit: float) -> list[str]:
        return [
            one.model for one in by_interaction(Digest(make_run([case], acceptance={"frame_time": limit})))
        ]

    assert taken(near, 2e-3) == ["", "bem", "bem", ""]
    assert taken(near, 1e-3) == ["", "", "", ""], "loads everywhere take bem 1.6 ms, the other 0.8"
    assert taken(far, 1e-3) == ["", "", "", "fem"]
    run = make_run([far], acceptance={"frame_time": 1e-3})
    resting, moving, cutting, _ = ("".join(said("take", one)) for one in by_interaction(Digest(run)))
    none = "no surface model is within the limits"
    assert resting == "linear elements are not within the limits"
    in_time = "and answered loads everywhere within 1.0 ms"
    assert (moving, cutting) == (f"{none} {in_time}", f"no model is within the limits {in_time}")
    half = make_case({"vdm-paper": 0.09, "fem-linear": 0.09}, reference="fem", subdivisions=0)
    _, moving, *_ = by_interaction(Digest(make_run([dataclasses.replace(half, hash="half"), far])))
    assert said("take", moving) == [f"{none} in the median"]
    exact = by_interaction(Digest(make_run([dataclasses.replace(far, hash="far"), far])))[-1]
    assert said("take", exact) == [
        "fem, the reference: no other model here is within the limits in the median"
    ]


def test_a_reference_whose_own_error_is_beyond_the_limits_is_not_one_to_take() -> None:
    for bar, taken in (
        (0.09, "fem, the reference: no other model here is within the limits"),
        (0.11, "no model here, and the reference's own error is beyond the limits too: "),
    ):
        error = {"gci:relative_l2_displacement_error": bar}
        case = make_case(
            {"bem": 0.5, "fem-linear": 0.5}, reference="fem", reference_error=error, subdivisions=0
        )
        assert "".join(said("take", by_interaction(Digest(make_run([case])))[-1])).startswith(taken)


def test_a_mesh_that_is_too_coarse_is_not_to_be_made_larger_for_its_time() -> None:
    errors = {"vdm-vector": 0.13, "fem-linear": 0.08}
    case = measured_anew(make_case(errors, reference="fem-linear refined", subdivisions=0))
    found = told(make_run([case], reference="fem-linear", acceptance={"frame_time": 3e-4}))
    assert found.keys() == {MESH, TIME}
    assert "A smaller geometry.mesh_size" in found[MESH]
    assert found[TIME].endswith(
        "; a busy machine makes it longer. Allow more: a larger geometry.mesh_size would add to the errors."
    )


@pytest.mark.parametrize(("error", "enough"), [(0.17, True), (0.19, False)])
def test_a_finer_mesh_is_advised_where_without_the_mesh_the_limits_are_kept(
    error: float, enough: bool
) -> None:
    """The mesh takes 8 % of which 10 are allowed; of what is 98 % off a finer one takes nothing away."""
    case = make_case(
        {"vdm-vector": error, "fem-linear": 0.08}, reference="fem-linear refined", subdivisions=0
    )
    found = told(make_run([case], reference="fem-linear"))[MESH]
    assert ("A smaller geometry.mesh_size takes that away." in found) is enough
    far = growing({"bem": (0.2, 0.2, 0.2)}, reference="fem-linear")
    for left, own in ((0.12, True), (0.08, False)):
        case = of_model(far, "bem", scalars={"shape_error": np.full(3, left)})
        assert ("A smaller" in told(make_run([case]), "bem")[MESH]) is own


def test_a_frame_that_takes_too_long_is_told() -> None:
    case = measured_anew(make_case({"vdm-vector": 0.01, "fem-condensed": 0.02}, subdivisions=0))
    run = make_run([case], acceptance={"frame_time": 3e-4})  # they take 0.4 and 0.8 ms
    assert causes(run) == {
        TIME: Reason(TIME, {"frame_time": pytest.approx(4e-4)}, {"sure": True, "coarser": True})
    }
    found = verdicts(Digest(run))
    assert found["vdm-derived"].word == "no"
    moving = found.take[1]
    assert (moving.kind, moving.allowed, moving.model) == ("none", 3e-4, "")
    assert causes(make_run([case], acceptance={"frame_time": 5e-4})) == {}


def test_cases_within_at_some_load_are_not_said_to_be_within_at_none() -> None:
    def reached(*cases: CaseResult) -> str:
        (text,) = said("reached", verdicts(Digest(make_run(cases)))["vdm-derived"])
        return text.partition(" (")[0]

    near, far, falling = (growing({"vdm-vector": e}) for e in ((0.02,) * 3, (0.2,) * 3, (0.2, 0.1, 0.05)))
    assert reached(far) == "not within 10 % at any load tried"
    assert reached(far, dataclasses.replace(near, hash="near")) == (
        "not within 10 % in every case even at the smallest of the loads tried"
    )
    assert reached(falling) == "not within 10 % even at the smallest of the loads tried"


def test_the_case_in_which_a_cause_was_seen_is_named_and_none_of_what_is_told_of_all_cases() -> None:
    near, far = (
        dataclasses.replace(
            measured_anew(make_case({"vdm-vector": off}, subdivisions=0)), hash=name, label=name
        )
        for name, off in (("near", 0.02), ("far", 0.2))
    )
    assert verdicts(Digest(make_run([near, far])))["vdm-derived"].seen_in == "far"
    assert verdicts(Digest(make_run([far])))["vdm-derived"].seen_in == ""
    slow = make_run(
        [near, dataclasses.replace(near, hash="same", label="same")], acceptance={"frame_time": 3e-4}
    )
    assert causes(slow).keys() == {TIME}, "the longest of all cases"
    assert verdicts(Digest(slow))["vdm-derived"].seen_in == ""


def test_the_time_of_a_cut_is_the_set_up_with_the_first_answer_and_no_frame_of_the_contact() -> None:
    case = measured_anew(make_case({"bem": 0.02}, reference="fem", subdivisions=0))
    frames = case.models["bem"].frames
    assert frames is not None
    cutting = verdicts(Digest(make_run([case]))).take[2]
    taken = cutting.take
    assert taken is not None
    assert taken.set_up == pytest.approx(np.median(frames.setup) + np.median(frames.everywhere), rel=1e-9)
    assert np.isnan(taken.frame)
    (text,) = said("instead", cutting)
    assert "per frame" not in text


@pytest.mark.parametrize(
    ("errors", "limit", "model"),
    [
        ({"fem-linear": 0.02, "bem": 0.02}, None, "fem-linear"),  # set up in 20 ms, bem in 40
        ({"bem": 0.02, "fem-linear": 0.02}, None, "bem"),
        ({"fem-linear": 0.2, "bem": 0.02}, None, "bem"),
        ({"bem": 0.2, "vdm-vector": 0.02}, None, "vdm-vector"),
        ({"bem": 0.2}, None, "fem"),  # the reference, in 2.5 s
        ({"fem-linear": 0.02}, 1e-3, "fem-linear"),
        ({"fem-linear": 0.02}, 5e-4, ""),  # loads everywhere in 0.8 ms
    ],
)
def test_a_cut_is_served_by_the_model_of_any_family_that_answers_first_within_all_limits(
    errors: dict[str, float], limit: float | None, model: str
) -> None:
    """Boundary elements of 33 ms a frame were named under a limit of 5 ms; elements, which set up sooner, never."""
    case = measured_anew(make_case(errors, reference="fem", subdivisions=0))
    acceptance = {} if limit is None else {"frame_time": limit}
    cutting = by_interaction(Digest(make_run([case], acceptance=acceptance)))[-2]
    assert (cutting.interaction, cutting.model) == (CUTTING, model)


def test_a_reference_on_finer_meshes_serves_no_cut() -> None:
    case = measured_anew(make_case({"bem": 0.2}, reference="fem refined", subdivisions=0))
    assert by_interaction(Digest(make_run([case], reference="fem")))[-2].model == ""


@pytest.mark.parametrize("error", [0.085, 0.095])
def test_a_model_that_is_not_surely_within_the_limits_is_named_as_such_and_with_the_references_bar(
    error: float,
) -> None:
    """Elements of 4.8 %, undecided by the reference's own 6 %, were what a few per cent need."""
    errors = {"bem": error, "fem-linear": error}
    case = measured_anew(make_case(errors, reference="fem", reference_error=OFF_BY, subdivisions=0))
    for one in by_interaction(Digest(make_run([case]))):
        (text,) = said("instead", one)
        assert ("not surely within the limits" in text) is (error > 0.09)
        assert f"{100 * error:g} % ± 1 % off in displacement and {100 * error:g} % ± 1 % in change of" in text
    row = verdicts(Digest(make_run([case])))["elements"]
    assert f"change of shape {100 * error:g} % ± 1 %" in said("row", row, verdicts(Digest(make_run([case]))))


def test_condensed_elements_that_leave_out_a_lump_say_nothing_of_linear_ones_that_know_it() -> None:
    """Of a study with a tumour: "linear elements are not within the limits", and fem-linear was in all cases."""
    errors = {"fem-condensed": 0.3, "fem-linear": 0.02}
    case = make_case(errors, reference="fem", subdivisions=0)
    run = make_run([case])
    assert said("take", by_interaction(Digest(run))[0]) == ["linear elements are not within the limits"]
    info = run.study.study.model_copy(update={"homogeneous": ("fem-condensed",)})
    run = dataclasses.replace(run, study=run.study.model_copy(update={"study": info}))
    resting = by_interaction(Digest(run))[0]
    assert (resting.model, resting.kind) == ("fem-linear", "linear")
    assert said("take", resting) == ["elements condensed to that region; as far off as fem-linear"]


def test_a_contact_that_stays_is_no_row_of_a_study_without_a_contact() -> None:
    case = make_case({"bem": 0.02, "fem-linear": 0.02}, reference="fem", subdivisions=0)
    assert by_interaction(Digest(make_run([case])))[0].interaction == RESTING
    alone = asked(case, constraints=[{"kind": "fixed", "region": "base"}])
    found = [one.interaction for one in by_interaction(Digest(make_run([alone])))]
    assert RESTING not in found
    assert found[-1] == EXACT


def test_condensed_elements_are_not_advised_for_what_they_refuse() -> None:
    pushed = {"kind": "indenter", "depth": 1e-3, "shape": "sphere", "radius": 0.01}
    for contact, kinds in ((None, ["condensed"]), (pushed, [])):
        case = make_case({"fem-linear": 0.02}, reference="fem", contact=contact, subdivisions=0)
        found = verdicts(Digest(make_run([case]))).take
        assert [one.kind for one in found if one.kind == "condensed"] == kinds


@pytest.mark.parametrize(
    ("surface", "elements", "model"),
    [(0.035, 0.04, "fem-linear"), (0.035, 0.2, "bem"), (0.098, 0.104, "bem"), (0.3, 0.2, "fem")],
)
def test_elements_serve_a_few_per_cent_unless_a_surface_model_is_surely_closer(
    surface: float, elements: float, model: str
) -> None:
    """3.5 and 4 % are one where the reference itself is 1 % off; what is not within the limits serves nobody."""
    errors = {"bem": surface, "fem-linear": elements}
    case = make_case(errors, reference="fem", reference_error=OFF_BY, subdivisions=0)
    assert verdicts(Digest(make_run([case]))).take[-1].model == model


def test_condensed_elements_are_as_good_as_linear_ones_whose_frames_take_too_long() -> None:
    case = measured_anew(make_case({"vdm-vector": 0.2, "fem-linear": 0.02}, reference="fem", subdivisions=0))
    for limit in ({}, {"frame_time": 1e-6}):
        resting = verdicts(Digest(make_run([case], acceptance=limit))).take[0]
        assert (resting.kind, resting.model) == ("condensed", "fem-linear")
        assert resting.take is not None
        assert resting.take.within == 1
