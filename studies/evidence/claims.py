"""The nine claims that the paper makes of its model, and the rules by which stored results judge them.

A rule is one decorated function from the digests of the runs that put a claim on trial to its judgement. Thresholds
stand in the rule's own words, so that a reader can disagree with them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..measures.bars import at_full_load, series
from ..measures.case import CaseResult, Limit
from ..measures.metrics import VECTOR
from ..report.blocks import Figure
from ..report.judgement import (
    FAILS,
    HOLDS,
    OPEN,
    WITHIN_LIMITS,
    Change,
    Claim,
    Judge,
    Judgement,
    either_way,
    in_words,
    own_bar,
)
from ..study.registry import REFINED, is_linear, split
from ..verdict.digest import Digest, failed_steps
from ..verdict.formatting import listed, plain, plural, quantity, short_percent
from ..verdict.growth import is_measured, strain_in_words, strain_range, strain_side
from .claim_figures import Line, bars, curves, histories
from .claim_shared import CLOSE, FIT, KEPT, ORDER, SAME, floor_in_words, is_tried, own_error
from .claim_steps import SMALL_STEPS_RULE, WARM_START_RULE, small_steps, warm_start
from .claim_volume import RULE as VOLUME_RULE
from .claim_volume import volume
from .claim_words import ABOUT

CLAIMS: dict[int, Claim] = {}


def _claim(number: int, text: str, rule: str) -> Callable[[Judge], Judge]:
    def register(judge: Judge) -> Judge:
        CLAIMS[number] = Claim(number, text, rule, judge, ABOUT[number])
        return judge

    return register


def on_trial(digests: Sequence[Digest], number: int) -> list[Digest]:
    """The runs whose study puts a claim on trial and that have a finished case."""
    return [d for d in digests if number in d.run.study.study.claims and d.cases]


def _iterative(case: CaseResult, model: str) -> bool:
    return model in case.models and case.models[model].parameters.get("solver") == "iterative"


_claim(1, "Volume is conserved by every solver.", VOLUME_RULE)(volume)


@_claim(
    2,
    "A linear analysis holds for small deformations and strains below 10 %.",
    "Holds where linear elements stay within 5 % of finite strain up to a largest principal strain of 10 % in "
    "every scene, the bar of that strain counted, and the linear VDM is itself within "
    f"{short_percent(CLOSE)} there; within limits where only the first is so: linearising is then harmless, but "
    "the model is off for other reasons; not decided where a strain's bar straddles 10 % or a limit is unresolved.",
)
def _linear(digests: Sequence[Digest]) -> Judgement | None:
    limits: list[Limit] = []
    structural: dict[str, float] = {}
    for case in (case for digest in digests for case in digest.cases):
        if case.small_strain is None:
            continue
        for model, entry in case.small_strain.models.items():
            if model == "fem-linear":
                limits += [lim for lim in entry.limits if is_measured(lim) and lim.threshold <= KEPT]
            elif is_tried(model) and split(model)[1] == "linear":
                structural[model] = max(structural.get(model, 0.0), entry.structural_error)
    found = [lim for lim in limits if lim.state == "found"]
    if not found or not structural:
        return None
    first = min(found, key=lambda lim: strain_range(lim)[0])
    sides = [strain_side(lim) for lim in limits]
    paper = structural.get("vdm-paper", max(structural.values()))
    verdict = FAILS if -1 in sides else OPEN if 0 in sides else HOLDS if paper <= CLOSE else WITHIN_LIMITS
    reason = (
        "Linear elements depart from finite strain by 5 % at a largest principal strain of "
        f"{strain_in_words(first)}{' or more' if len(found) > 1 else ''}. At small loads already, "
        f"{listed(f'{m} is {short_percent(e)} off' for m, e in structural.items())}.{floor_in_words(digests)}"
    )
    figures: tuple[Figure, ...] = ()
    for k, d in enumerate(digests):
        lines = histories(d, VECTOR, [m for m in d.compared if is_tried(m) or m == "fem-linear"])
        drawn = curves(digests[0], lines, "load factor", "displacement error", f"claim2{k}")
        name = f", {d.run.study.study.name}" if len(digests) > 1 else ""
        figures += tuple(replace(figure, title=f"{figure.title}{name}") for figure in drawn)
    return Judgement(verdict, f"{strain_in_words(first)} strain at 5 % departure", reason, figures)


@_claim(
    3,
    "VDM costs an order of magnitude less than FEM.",
    f"Holds where a frame and the set-up of the printed form are both {ORDER:g} times cheaper than those "
    "of linear elements on the same mesh, and a frame also than that of elements condensed to the surface; within "
    "limits where only some of these hold.",
)
def _cost(digests: Sequence[Digest]) -> Judgement | None:
    ratios: dict[str, list[float]] = {"frame": [], "set-up": [], "condensed frame": []}
    cases = [case for digest in digests for case in digest.cases]
    # an iterative solve, chosen where one load is all there is, is no frame: factors would be kept for those
    kept = [case for case in cases if not _iterative(case, "fem-linear")] or cases
    for case in kept:
        vdm, fem, condensed = (case.models.get(name) for name in ("vdm-paper", "fem-linear", "fem-condensed"))
        if vdm is None or fem is None:
            continue
        frame = float(np.nanmedian(vdm.seconds_per_step))
        ratios["frame"].append(float(np.nanmax(fem.seconds_per_step)) / frame)
        ratios["set-up"].append(fem.seconds_setup / vdm.seconds_setup)
        if condensed is not None:
            ratios["condensed frame"].append(float(np.nanmedian(condensed.seconds_per_step)) / frame)
    if not ratios["frame"]:
        return None
    typical = {name: float(np.median(values)) for name, values in ratios.items() if values}
    reached = [ratio >= ORDER for ratio in typical.values()]
    verdict = HOLDS if all(reached) else WITHIN_LIMITS if any(reached) else FAILS
    reason = (
        f"On the same mesh a frame of vdm-paper is {plain(typical['frame'], 2)} times cheaper than a solve of "
        f"linear elements and its set-up {plain(typical['set-up'], 2)} times (medians)."
    )
    if len(kept) < len(cases):
        reason += (
            f" {plural(len(cases) - len(kept), 'case')} in which these were solved iteratively left out."
        )
    if "condensed frame" in typical:
        reason += (
            " Once elements are condensed to the contact's surface, a frame of theirs costs "
            f"{plain(typical['condensed frame'], 2)} times that of vdm-paper, at the accuracy of elements."
        )
    digest = digests[0]
    here = [s for s in digest.summaries if not s.name.endswith(REFINED)]  # on the mesh that all models share
    values = {s.name: s.seconds_per_step for s in here if s.seconds_per_step > 0}
    figure = bars(digest, values, "seconds per frame (median)", "claim3", log=True)
    return Judgement(verdict, f"{plain(typical['frame'], 2)} times per frame", reason, figure)


_claim(4, "At small time-steps VDM gives results like those of FEM.", SMALL_STEPS_RULE)(small_steps)
_claim(5, "Starting from the last solution gives dramatic gains in speed.", WARM_START_RULE)(warm_start)


@_claim(
    6,
    "Density and bulk modulus of blood suffice as parameters.",
    f"Holds where the bulk modulus of blood moves the surface by within {FIT:g} times of the reference; fails "
    "where it does not.",
)
def _blood(digests: Sequence[Digest]) -> Judgement | None:
    points: list[tuple[float, float]] = []
    for case in (case for digest in digests for case in digest.cases):
        modulus, model = case.swept.get("vdm.bulk_modulus"), case.models.get("vdm-paper")
        if case.reference is None or model is None or not isinstance(modulus, int | float):
            continue
        step = case.full_load
        size = [
            float(np.linalg.norm(result.displacement[step], axis=1).max())
            for result in (model, case.models[case.reference])
        ]
        if all(map(math.isfinite, size)) and size[1] > 0:
            points.append((float(modulus), size[0] / size[1]))
    if not points:
        return None
    points.sort()
    modulus, ratio = points[-1]
    verdict = HOLDS if 1 / FIT <= ratio <= FIT else FAILS
    best = min(points, key=lambda point: abs(math.log(point[1])))
    reason = (
        f"With {quantity(modulus, 'Pa')} the largest displacement is {plain(ratio, 2)} of the reference's. It "
        f"comes closest, {plain(best[1], 2)} of it, at {quantity(best[0], 'Pa')}: the modulus that matters is of "
        "the order of the shear modulus of the tissue, which the fluid's compressibility says nothing about."
    )
    line = ("vdm-paper", [p for p, _ in points], [r for _, r in points])
    figure = curves(
        digests[0],
        [line],
        "B = B_ij [Pa]",
        "largest displacement / reference's",
        "claim6",
        log_y=True,
        log_x=True,
        ratio=True,
    )
    number = f"{plain(ratio, 2)} of the reference's displacement{own_error(digests)}"
    return Judgement(verdict, number, reason, figure)


@_claim(
    7,
    "B_i and B_ij control anisotropy.",
    "Holds where fibres change the ratio of the body's mean strains in the same direction as in the reference in "
    "every case and by at least half as much; within limits where the direction agrees and the size does not.",
)
def _anisotropy(digests: Sequence[Digest]) -> Judgement | None:
    agree, sizes = 0, []
    total = 0
    lines: list[Line] = []
    for digest in digests:
        plain_case = next((c for c in digest.cases if _contrast(c) == 1.0), None)
        if plain_case is None or digest.reference is None:
            continue
        along_x = [c for c in digest.cases if _fibres_along_x(c)]
        along_x.sort(key=lambda c: _contrast(c))
        for model in digest.models:
            ratios = [_strain_ratio(case, model) for case in along_x]
            if all(map(math.isfinite, ratios)) and ratios:
                lines.append((model, [_contrast(c) for c in along_x], ratios))
        for case in digest.cases:
            change = {
                m: _strain_ratio(case, m) - _strain_ratio(plain_case, m)
                for m in (digest.reference, "vdm-paper")
            }
            own, true = change["vdm-paper"], change[digest.reference]
            if case is not plain_case and math.isfinite(own) and math.isfinite(true) and abs(true) > KEPT:
                total += 1
                agree += own * true > 0
                sizes.append(own / true)
    if not total:
        return None
    smallest = min(sizes)
    verdict = FAILS if agree < total else HOLDS if smallest >= 0.5 else WITHIN_LIMITS
    reason = (
        f"Fibres change the ratio of mean strains along x and y in the reference's direction in {agree} of {total} "
        f"cases with vdm-paper, by {plain(smallest, 2)} to {plain(max(sizes), 2)} times as much."
    )
    figure = curves(
        digests[0],
        lines,
        "contrast of fibres along x",
        "mean strain x over y",
        "claim7",
        log_x=True,
        ratio=True,
    )
    return Judgement(verdict, f"{agree} of {total} cases in the right direction", reason, figure)


@_claim(
    8,
    "The nonlinear solver handles large strains without much loss of accuracy.",
    f"Holds where the error of every nonlinear form at full load is at most {short_percent(KEPT)} above its error "
    "at the smallest load; within limits where some are, and none stops; not decided where the reference's own "
    "error decides, which counts in either of them as it is at full load. An accuracy that is not lost need not be "
    "good: the error at small loads stands beside it.",
)
def _large_strain(digests: Sequence[Digest]) -> Judgement | None:
    grown: dict[str, Change] = {}
    stopped: list[str] = []
    lines: list[Line] = []
    for digest in digests:
        models = [m for m in digest.compared if is_tried(m) and split(m)[1] == "nonlinear"]
        lines += histories(digest, VECTOR, [*models, *(m for m in digest.compared if m == "fem-linear")])
        for case in digest.cases:
            for model in models:
                values = series(case, model, VECTOR)
                if failed_steps(case.models[model]):
                    stopped.append(model)
                elif values is not None and len(values) > 1:
                    first = int(np.argmin(np.abs(case.load_factors)))
                    found = Change(float(values[first]), float(values[case.full_load]), own_bar(case))
                    grown[model] = max(grown.get(model, found), found, key=lambda change: change.growth)
    if not grown and not stopped:
        return None

    def verdict(way: float) -> str:
        kept = [change.growth - way * 2.0 * change.bar <= KEPT for change in grown.values()]
        return FAILS if stopped or not any(kept) else HOLDS if all(kept) else WITHIN_LIMITS

    reasons, number = [], "no form reaches the full load"
    if grown:
        told = f"From the smallest load to the largest the error goes, for {in_words(grown)}."
        reasons.append(told + floor_in_words(digests))
        worst = float(np.max([change.after - change.before for change in grown.values()]))  # NaN where one is
        number = f"{short_percent(worst)} growth at most{own_error(digests)}"
    if stopped:
        reasons.append(f"{listed(dict.fromkeys(stopped))} did not reach the full load.")
    figure = curves(digests[0], lines, "load factor", "displacement error", "claim8")
    return Judgement(either_way(verdict), number, " ".join(reasons), figure)


@_claim(
    9,
    "The static solve has no stability problems.",
    f"Holds where every solver reaches the direct answer to {SAME:g} in every case; within limits where every "
    "failure is a status of the step and never a wrong number; fails where a converged step is wrong.",
)
def _stability(digests: Sequence[Digest]) -> Judgement | None:
    failures: dict[str, int] = {}
    wrong: dict[str, int] = {}
    total = 0
    for digest in digests:
        for case in digest.cases:
            for model in digest.compared:
                if model not in case.models or not is_linear(model):
                    continue  # another problem than the linear one: a difference is no instability
                total += 1
                error = at_full_load(case, model, VECTOR)
                if failed_steps(case.models[model]):
                    failures[model] = failures.get(model, 0) + 1
                elif not error <= SAME:
                    wrong[model] = wrong.get(model, 0) + 1
    if not total:
        return None
    verdict = FAILS if wrong else WITHIN_LIMITS if failures else HOLDS
    bad = sum(failures.values()) + sum(wrong.values())
    parts = [f"{m} stops in {n}" for m, n in failures.items()] + [
        f"{m} is wrong in {n}" for m, n in wrong.items()
    ]
    reason = f"Of {total} solves {bad} do not reach the direct solver's answer to {SAME:g}" + (
        f": {listed(parts)}." if parts else "."
    )
    values = {m: float(failures.get(m, 0) + wrong.get(m, 0)) for d in digests for m in d.compared}
    figure = bars(digests[0], values, "cases without the right answer", "claim9")
    return Judgement(verdict, f"{bad} of {total} solves", reason, figure)


def _contrast(case: CaseResult) -> float:
    fibres = case.study.anisotropy
    return fibres.contrast if fibres else 1.0


def _fibres_along_x(case: CaseResult) -> bool:
    fibres = case.study.anisotropy
    x, y, z = fibres.fibre_direction if fibres else (0, 0, 0)
    return x != 0 and y == z == 0


def _strain_ratio(case: CaseResult, model: str) -> float:
    """Mean strain of the body along x over that along y, at full load."""
    x, y = (at_full_load(case, model, f"mean_strain_{axis}") for axis in "xy")
    return x / y if y else math.nan
