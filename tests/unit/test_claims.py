"""Verdicts on the paper's claims from runs whose numbers are chosen: each rule, on both sides of its threshold."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from tests.command import SMALL_STUDY, vdmbench
from tests.example_case import asked
from tests.report.runs import make_case, make_run
from vdmbench.evidence.claims import CLAIMS
from vdmbench.evidence.claims_page import claims_html, verdict_rows, verdicts, write_claims
from vdmbench.measures.case import CaseResult, Limit, MetricSeries, ModelLimits, Run, SmallStrainLimits
from vdmbench.report.judgement import FAILS, HOLDS, OPEN, WITHIN_LIMITS, Judgement
from vdmbench.study.schema import CLAIMS as HOW_MANY
from vdmbench.verdict.digest import NORMAL


def judged(number: int, *cases: CaseResult) -> Judgement:
    return verdicts([make_run(list(cases), claims=[number])])[number - 1].judgement


def with_metric(case: CaseResult, model: str, values: Mapping[str, float]) -> CaseResult:
    """The case with constant metrics put in."""
    steps = len(case.load_factors)
    entries = {name: MetricSeries(np.full(steps, v), "1", "", 1) for name, v in values.items()}
    metrics = {**case.metrics, model: {**case.metrics.get(model, {}), **entries}}
    return dataclasses.replace(case, metrics=metrics)


def with_models(case: CaseResult, **changes: Mapping[str, object]) -> CaseResult:
    """The case with fields of its models replaced; "__" in a name stands for ":" and "_" for "-"."""
    models = dict(case.models)
    for key, fields in changes.items():
        name = key.replace("__", ":").replace("_", "-")
        models[name] = dataclasses.replace(models[name], **fields)  # type: ignore[arg-type]
    return dataclasses.replace(case, models=models)


@pytest.mark.parametrize(
    ("exact", "linear", "displaced", "verdict"),
    [
        (1e-13, 1e-12, 1e-9, HOLDS),
        (1e-13, 1e-3, 0.03, WITHIN_LIMITS),
        (1e-13, 1e-3, 0.2, FAILS),
        (1e-6, 1e-3, 0.03, FAILS),
    ],
)
def test_volume(exact: float, linear: float, displaced: float, verdict: str) -> None:
    case = make_case({"vdm-paper": 0.1, "vdm-vector:nonlinear": 0.1}, subdivisions=0)
    case = with_metric(case, "vdm-paper", {"volume_drift": linear, "volume_drift_of_displaced": displaced})
    case = with_metric(
        case, "vdm-vector:nonlinear", {"volume_drift": exact, "volume_drift_of_displaced": exact}
    )
    assert judged(1, case).verdict == verdict


def test_of_the_printed_form_no_solver_is_asked_for_the_exact_volume() -> None:
    case = make_case({"vdm-paper:nonlinear": 0.1}, subdivisions=0)
    found = {"volume_drift": 1e-4, "volume_drift_of_displaced": 0.02}
    assert judged(1, with_metric(case, "vdm-paper:nonlinear", found)).verdict == WITHIN_LIMITS


@pytest.mark.parametrize(
    ("small", "verdict"), [(0.03, WITHIN_LIMITS), (0.2, FAILS)], ids=["kept there", "lost there"]
)
def test_a_linear_solver_is_judged_on_volume_up_to_a_strain_of_10_percent(small: float, verdict: str) -> None:
    """Strains of 5, 10, 20 and 40 %: the drift beyond is told, and does not decide."""
    case = make_case({"vdm-paper": 0.1, "vdm-paper:quasi-linear": 0.1}, subdivisions=0)
    case = with_models(
        case, fem_linear={"scalars": {"max_principal_strain": np.array([0.05, 0.1, 0.2, 0.4])}}
    )
    case = with_metric(
        case, "vdm-paper:quasi-linear", {"volume_drift": 1e-3, "volume_drift_of_displaced": 0.01}
    )
    drift = np.array([small / 2, small, 0.3, 0.5])
    entries = {
        "volume_drift": MetricSeries(0.1 * drift, "1", "", 1),
        "volume_drift_of_displaced": MetricSeries(drift, "1", "", 1),
    }
    case = dataclasses.replace(
        case, metrics={**case.metrics, "vdm-paper": {**case.metrics["vdm-paper"], **entries}}
    )
    outcome = judged(1, case)
    assert outcome.verdict == verdict
    beyond = "beyond 10 % strain 50.0 % (vdm-paper)"
    assert outcome.number == f"{100 * small:.3g} % of the displaced volume (vdm-paper); {beyond}".replace(
        "3 %", "3.00 %"
    ).replace("20 %", "20.0 %")
    assert "Beyond, up to a strain of 40 %, it is 50.0 % (vdm-paper)" in outcome.reason


def test_the_quasi_linear_solver_answers_for_its_volume_at_every_load() -> None:
    case = make_case({"vdm-paper:quasi-linear": 0.1}, subdivisions=0)
    case = with_models(case, fem_linear={"scalars": {"max_principal_strain": np.full(4, 0.5)}})
    found = {"volume_drift": 1e-2, "volume_drift_of_displaced": 0.2}
    assert judged(1, with_metric(case, "vdm-paper:quasi-linear", found)).verdict == FAILS
    linear = make_case({"vdm-paper": 0.1}, subdivisions=0)
    linear = with_models(linear, fem_linear={"scalars": {"max_principal_strain": np.full(4, 0.5)}})
    assert judged(1, with_metric(linear, "vdm-paper", found)).verdict == OPEN, "no load of its range"


@pytest.mark.parametrize("rounding", [-1e-13, 0.0, 1e-13])
def test_of_solvers_of_one_system_the_first_is_named(rounding: float) -> None:
    names = ("vdm-paper", "vdm-paper:lu", "vdm-consistent")
    case = make_case(dict.fromkeys(names, 0.1), subdivisions=0)
    for name, drift in zip(names, (0.1, 0.1 * (1.0 + rounding), 0.09), strict=True):
        case = with_metric(case, name, {"volume_drift": drift, "volume_drift_of_displaced": 2.0 * drift})
    outcome = judged(1, case)
    assert outcome.number == "20.0 % of the displaced volume (vdm-paper)"
    assert "to first order only: vdm-paper gains" in outcome.reason


@pytest.mark.parametrize(
    ("strain", "bar", "structural", "verdict"),
    [
        (0.2, 0.1, 0.05, HOLDS),
        (0.2, math.nan, 0.05, HOLDS),
        (0.2, 0.1, 0.5, WITHIN_LIMITS),
        (0.07, 0.1, 0.05, FAILS),
        (0.2, 0.6, 0.05, OPEN),
        (0.07, 0.5, 0.05, OPEN),
    ],
)
def test_linear_analysis(strain: float, bar: float, structural: float, verdict: str) -> None:
    def limits(e0: float) -> ModelLimits:
        return ModelLimits(e0, 0.0, (Limit(0.05, "found", 100.0, 0.01, 0.001, strain, strain_bar=bar),))

    case = make_case({"vdm-paper": structural, "fem-linear": 0.0}, reference="fem", subdivisions=0)
    found = SmallStrainLimits(
        "constraints.finger.pressure", "Pa", {"vdm-paper": limits(structural), "fem-linear": limits(0.0)}
    )
    outcome = judged(2, dataclasses.replace(case, small_strain=found))
    assert outcome.verdict == verdict
    shown = "" if math.isnan(bar) else f" ± {100 * strain * bar:.2g} %"
    assert outcome.number == f"{100 * strain:g} %{shown} strain at 5 % departure"
    assert "The reference itself, moved along normals, is" in outcome.reason
    denied = ModelLimits(0.0, 0.0, (Limit(0.05, "unresolved", 50.0, math.nan, 0.001, 0.05),))
    other = SmallStrainLimits(found.along, "Pa", {"fem-linear": denied})
    judged_both = judged(
        2, dataclasses.replace(case, small_strain=found), dataclasses.replace(case, small_strain=other)
    )
    assert judged_both.verdict == (FAILS if verdict == FAILS else OPEN)


@pytest.mark.parametrize(
    ("frame", "setup", "condensed", "verdict"),
    [(1e-3, 1e-3, 0.1, HOLDS), (1e-3, 1e-3, 1e-3, WITHIN_LIMITS), (0.5, 1.0, 0.5, FAILS)],
)
def test_cost(frame: float, setup: float, condensed: float, verdict: str) -> None:
    case = make_case({"vdm-paper": 0.5, "fem-condensed": 0.0}, subdivisions=0)
    steps = np.ones(4)
    case = with_models(
        case,
        vdm_paper={"seconds_per_step": frame * steps, "seconds_setup": setup},
        fem_condensed={"seconds_per_step": condensed * steps, "seconds_setup": 5.0},
        fem_linear={"seconds_per_step": 1.0 * steps, "seconds_setup": 1.5},
    )
    outcome = judged(3, case)
    assert outcome.verdict == verdict
    assert f"{1 / frame:g} times per frame" == outcome.number


def test_a_refined_reference_is_no_yardstick_of_cost() -> None:
    models = {"vdm-paper": 0.5, "fem-linear": 0.02}
    case = make_case(models, reference="fem-linear refined", subdivisions=0)
    case = with_models(case, fem_linear={"seconds_per_step": 0.1 * np.ones(4)})
    outcome = judged(3, with_models(case, vdm_paper={"seconds_per_step": 1e-3 * np.ones(4)}))
    assert outcome.number == "100 times per frame"
    (figure,) = outcome.figures
    assert "fem-linear" in figure.svg
    assert "refined" not in figure.svg


def test_a_frame_without_kept_factors_is_no_yardstick_of_cost() -> None:
    def case(label: str, seconds: float, solver: str) -> CaseResult:
        steps = np.ones(4)
        return with_models(
            make_case({"vdm-paper": 0.5}, label=label, swept={"k": seconds}, subdivisions=0),
            vdm_paper={"seconds_per_step": 1e-3 * steps},
            fem_linear={"seconds_per_step": seconds * steps, "parameters": {"solver": solver}},
        )

    direct, iterative = case("a", 0.05, "direct"), case("b", 5.0, "iterative")
    outcome = judged(3, direct, iterative)
    assert outcome.number == "50 times per frame"
    assert "1 case in which these were solved iteratively left out." in outcome.reason
    assert judged(3, iterative).number == "5000 times per frame", "there is nothing else"


def in_steps(few: float, many: float, reference_error: dict[str, float] | None = None) -> list[CaseResult]:
    """The same case in 20 steps and in one, with these errors at full load."""
    return [
        make_case(
            {"vdm-paper:quasi-linear": error},
            label=str(n),
            steps=np.linspace(0, 1, n + 1)[1:].tolist(),
            subdivisions=0,
            reference_error=reference_error,
        )
        for n, error in ((20, many), (1, few))
    ]


@pytest.mark.parametrize(
    ("few", "many", "verdict"), [(0.4, 0.05, HOLDS), (0.4, 0.2, WITHIN_LIMITS), (0.4, 0.39, FAILS)]
)
def test_small_steps(few: float, many: float, verdict: str) -> None:
    outcome = judged(4, *in_steps(few, many))
    assert outcome.verdict == verdict
    assert outcome.number == f"{100 * (few - many):.2g} % at most by small steps (bar not measured)"


@pytest.mark.parametrize(
    ("few", "many", "bar", "verdict"),
    [
        (0.4, 0.07, 0.02, HOLDS),
        (0.4, 0.09, 0.02, OPEN),  # close, or only closer
        (0.4, 0.11, 0.02, OPEN),
        (0.4, 0.3, 0.02, WITHIN_LIMITS),
        (0.4, -0.34, 0.02, OPEN),
        (0.4, -0.38, 0.02, OPEN),
        (0.4, -0.3995, 0.02, FAILS),
        (0.4, 0.37, 0.02, FAILS),  # whose answers are too near each other for any reference
        (0.4, 0.3, 0.2, OPEN),
        (0.4, 0.34, 0.05, WITHIN_LIMITS),  # alike: what the reference does to one error it does to the other
    ],
)
def test_small_steps_with_the_reference_s_own_error(
    few: float, many: float, bar: float, verdict: str
) -> None:
    reference_error = {"gci:relative_l2_displacement_error": bar}
    outcome = judged(4, *in_steps(few, many, reference_error))
    assert outcome.verdict == verdict
    assert outcome.number.endswith(f" at most by small steps (reference's own error {100 * bar:g} %)")
    assert f"The answers themselves are {100 * (few - many):.2g} % apart at most." in outcome.reason
    assert "normal component" not in outcome.reason


def test_small_steps_of_a_form_along_normals_are_told_by_its_own_measure() -> None:
    """One step of the incremental solver is along normals, many are along those of the surface on the way."""
    cases = []
    for case, share, normal in zip(in_steps(0.4, 0.3), (0.1, 0.0), (0.15, 0.25), strict=True):
        case = with_metric(case, "vdm-paper:quasi-linear", {"tangential_share": share, NORMAL: normal})
        cases.append(with_metric(case, "fem-linear", {"tangential_share": 0.75}))
    outcome = judged(4, *cases)
    assert "The reference itself, moved along normals, is 75 % off" in outcome.reason
    assert "the error goes, for vdm-paper:quasi-linear from 25 % to 15 %." in outcome.reason


@pytest.mark.parametrize(("gains", "verdict"), [((3, 4), HOLDS), ((1, 4), WITHIN_LIMITS), ((1, 1), FAILS)])
def test_warm_start(gains: tuple[int, int], verdict: str) -> None:
    cases = []
    for n, gain in zip((2, 4), gains, strict=True):
        steps = np.linspace(0, 1, n + 1)[1:].tolist()
        case = make_case(
            {"vdm-paper:bicg": 0.0, "vdm-paper:bicg-cold": 0.0}, label=str(n), steps=steps, subdivisions=0
        )
        warm = np.full(n, 10)
        cases.append(with_models(case, vdm_paper__bicg={"iterations": warm}))
        models = dict(cases[-1].models)
        models["vdm-paper:bicg-cold"] = dataclasses.replace(
            models["vdm-paper:bicg-cold"], iterations=gain * warm
        )
        cases[-1] = dataclasses.replace(cases[-1], models=models)
    outcome = judged(5, *cases)
    assert outcome.verdict == verdict
    assert outcome.number == f"{max(gains)} times fewer at best"


def test_the_gain_of_a_warm_start_is_a_curve_over_the_tolerance() -> None:
    cases = []
    for steps, tolerance, gain in ((2, 1e-3, 3), (2, 1e-8, 1), (4, 1e-3, 4), (4, None, 1)):
        case = make_case(
            {"vdm-paper:bicg": 0.0, "vdm-paper:bicg-cold": 0.0},
            label=f"{steps} {tolerance}",
            steps=np.linspace(0, 1, steps + 1)[1:].tolist(),
            subdivisions=0,
        )
        warm = np.full(steps, 10)
        case = with_models(
            case, vdm_paper__bicg={"iterations": warm}, vdm_paper__bicg_cold={"iterations": gain * warm}
        )
        table = {} if tolerance is None else {"vdm": {"tolerance": tolerance}}
        cases.append(asked(case, **table))
    outcome = judged(5, *cases)
    assert outcome.verdict == WITHIN_LIMITS
    assert (
        "over 2 steps 1 at 10⁻⁸ and 3 at 0.001 and over 4 steps 1 at 10⁻¹⁰ and 4 at 0.001." in outcome.reason
    )
    assert [figure.title for figure in outcome.figures] == [
        f"Cold / warm iterations against tolerance, {steps} load steps" for steps in (4, 2)
    ]


@pytest.mark.parametrize(
    ("bars", "told"),
    [((0.02, 0.05), "reference's own error 5 %"), ((0.02, math.nan), "bar not measured")],
)
@pytest.mark.parametrize(("error", "verdict"), [(0.5, HOLDS), (-0.999, FAILS), (3.0, FAILS)])
def test_blood(error: float, verdict: str, bars: Sequence[float], told: str) -> None:
    cases = [
        make_case(
            {"vdm-paper": own},
            label=f"{modulus}",
            swept={"vdm.bulk_modulus": modulus},
            subdivisions=0,
            reference_error={"gci:relative_l2_displacement_error": bar},
        )
        for own, modulus, bar in zip((error, 0.1), (2.2e9, 1e3), bars, strict=True)
    ]
    outcome = judged(6, *cases)
    assert outcome.verdict == verdict
    assert outcome.number == f"{1 + error:.2g} of the reference's displacement ({told})"


@pytest.mark.parametrize(("own", "verdict"), [(1.6, HOLDS), (1.1, WITHIN_LIMITS), (0.8, FAILS)])
def test_anisotropy(own: float, verdict: str) -> None:
    def case(contrast: float, ratios: Mapping[str, float]) -> CaseResult:
        made = make_case({"vdm-paper": 0.1}, label=f"{contrast}", subdivisions=0)
        for model, ratio in ratios.items():
            made = with_metric(made, model, {"mean_strain_x": ratio, "mean_strain_y": 1.0})
        fibres = {"contrast": contrast, "fibre_direction": [1.0, 0.0, 0.0]}
        return asked(made, anisotropy=fibres)

    # the reference's ratio goes from 1 to 2: the model's own change is from 1 to `own`
    cases = [
        case(1.0, {"vdm-paper": 1.0, "fem-linear": 1.0}),
        case(4.0, {"vdm-paper": own, "fem-linear": 2.0}),
    ]
    assert judged(7, *cases).verdict == verdict


def growing(errors: Mapping[str, tuple[float, float]], stopped: str = "") -> CaseResult:
    """Nonlinear forms by their errors at the smallest and at full load; `stopped` names one that stops before."""
    case = make_case(
        dict.fromkeys(errors, 0.0), reference="fem", subdivisions=0, stopped={stopped: 2} if stopped else None
    )
    metrics = dict(case.metrics)
    for name, (small, large) in errors.items():
        grown = MetricSeries(np.linspace(small, large, 4), "1", "", 1)
        metrics[name] = {**metrics[name], "relative_l2_displacement_error": grown}
    return dataclasses.replace(case, metrics=metrics)


A, B = "vdm-vector:nonlinear", "bem:nonlinear"


@pytest.mark.parametrize(
    ("cases", "verdict", "growth"),
    [
        ([growing({A: (0.2, 0.22)})], HOLDS, "2 %"),
        ([growing({A: (0.2, 0.4)})], FAILS, "20 %"),
        ([growing({A: (0.2, 0.22), B: (0.2, 0.4)})], WITHIN_LIMITS, "20 %"),
        ([growing({A: (0.2, 0.22), B: (0.2, 0.2)}, B)], FAILS, "2 %"),
        # of several cases the one with the largest growth counts, wherever it stands
        ([growing({A: (0.2, 0.4)}), growing({A: (0.2, 0.22)})], FAILS, "20 %"),
        ([growing({A: (0.2, 0.22)}), growing({A: (0.2, 0.4)})], FAILS, "20 %"),
        ([growing({A: (0.2, math.nan)}), growing({A: (0.2, 0.22)})], FAILS, "– %"),
    ],
)
def test_large_strain(cases: list[CaseResult], verdict: str, growth: str) -> None:
    outcome = judged(8, *cases)
    assert outcome.verdict == verdict
    assert outcome.number == f"{growth} growth at most (bar not measured)"


@pytest.mark.parametrize(
    ("errors", "bar", "verdict"),
    [
        ({A: (0.2, 0.22)}, 0.01, HOLDS),
        ({A: (0.2, 0.22)}, 0.02, OPEN),
        ({A: (0.2, 0.28)}, 0.02, OPEN),
        ({A: (0.2, 0.4)}, 0.05, FAILS),
        ({A: (0.2, 0.22), B: (0.2, 0.4)}, 0.02, OPEN),
        # a form that keeps its accuracy and one that loses it decide, whatever a third does
        ({A: (0.2, 0.22), B: (0.2, 0.4), "vdm-paper:nonlinear": (0.7, 0.7)}, 0.02, WITHIN_LIMITS),
    ],
)
def test_large_strain_with_the_reference_s_own_error(
    errors: Mapping[str, tuple[float, float]], bar: float, verdict: str
) -> None:
    case = dataclasses.replace(growing(errors), reference_error={"gci:relative_l2_displacement_error": bar})
    outcome = judged(8, case)
    assert outcome.verdict == verdict
    assert outcome.number.endswith(f" growth at most (reference's own error {100 * bar:g} %)")
    assert "The reference itself, moved along normals, is" in outcome.reason


def test_no_growth_is_told_of_forms_that_all_stop() -> None:
    outcome = judged(8, growing({A: (0.2, 0.2)}, A))
    assert (outcome.verdict, outcome.number) == (FAILS, "no form reaches the full load")
    assert outcome.reason == f"{A} did not reach the full load."


@pytest.mark.parametrize(
    ("error", "stopped", "verdict"), [(1e-9, 4, HOLDS), (1e-9, 2, WITHIN_LIMITS), (1e-3, 4, FAILS)]
)
def test_stability(error: float, stopped: int, verdict: str) -> None:
    case = make_case(
        {"vdm-paper:bicg": error}, reference="vdm-paper", subdivisions=0, stopped={"vdm-paper:bicg": stopped}
    )
    assert judged(9, case).verdict == verdict


def test_a_claim_without_a_study_is_not_decided() -> None:
    found = verdicts([make_run([make_case({"vdm-paper": 0.1}, subdivisions=0)], claims=[])])
    assert {v.judgement.verdict for v in found} == {OPEN}
    assert len(found) == len(CLAIMS) == HOW_MANY
    # a study that names a claim and does not have what its rule reads decides nothing either
    assert judged(5, make_case({"vdm-vector": 0.1}, subdivisions=0)).verdict == OPEN


@pytest.fixture
def runs() -> list[Run]:
    hostile = make_run(
        [growing({A: (0.1, math.nan)}), growing({A: (0.1, 0.11)})],
        claims=[8, 1],
        name="<script>alert(1)</script>",
    )
    blood = make_case({"vdm-paper": -0.9}, swept={"vdm.bulk_modulus": 2.2e9}, subdivisions=0)
    return [hostile, make_run([blood], claims=[6], name="blood")]


def test_the_page_has_every_claim_its_rule_its_figure_and_how_to_reproduce(
    runs: list[Run], tmp_path: Path
) -> None:
    found = write_claims(runs, tmp_path / "claims.html")
    html = (tmp_path / "claims.html").read_text()
    assert html == claims_html(verdicts(runs))
    for number, claim in CLAIMS.items():
        assert f'<section id="claim-{number}"' in html
        words = unescape(html).replace("\u00a0", " ")
        for sentence in (claim.text, claim.rule, *dataclasses.astuple(claim.about)):
            assert sentence in words
    assert html.count('class="plot"') == sum(len(v.judgement.figures) for v in found) >= 2
    assert "vdmbench run blood" in html
    assert "<script>alert" not in html
    assert "default-src &#39;none&#39;" in html or "default-src 'none'" in html
    rows = verdict_rows(found)
    assert rows[5]["study"] == "blood"
    assert rows[5]["verdict"] == FAILS


def test_the_command(tmp_path: Path) -> None:
    study = SMALL_STUDY.replace('name = "small"', 'name = "small"\nclaims = [3]')
    (tmp_path / "small.toml").write_text(study)
    assert vdmbench("run", "small.toml", cwd=tmp_path).returncode == 0
    result = vdmbench("report", "--claims", "results/runs/small", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "results/claims.html").exists()
    assert "not decided" in result.stdout
    assert "times per frame" in result.stdout
    for wrong in (["results/runs/small", "results/runs/small"], ["results/runs/small", "--out", "x.html"]):
        mistake = vdmbench("report", *wrong, cwd=tmp_path)
        assert mistake.returncode == 2
        assert "--claims" in mistake.stderr
    assert vdmbench("report", "--claims", "nowhere", cwd=tmp_path).returncode == 2
