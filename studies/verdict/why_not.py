"""Why a model is not within its limits, told apart by what a study has measured. One function a cause.

A cause is named where it alone takes half of what a limit allows. All figures are of the case that decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, METRICS, VECTOR, History
from ..study.registry import FINITE_STRAIN, is_linear, split
from .acceptance import BEYOND, LOST, OPEN, WITHIN, Acceptance, Criterion
from .digest import Digest, failed_steps
from .formatting import listed, quantity, short_percent, swept_value
from .loading import load_in_words, load_unit, loads_of

MODEL, LEFT_OUT, SMALL_STRAIN, COMPRESSIBILITY, MESH, REFERENCE, TIME, NO_ANSWER = (
    "model",
    "left out",
    "small strain",
    "compressibility",
    "mesh",
    "reference",
    "time",
    "no answer",
)
NOT_TOLD = "not told apart"
HALF = 0.5  # of what a limit allows: from there on a cause is named
SMALL = 0.3  # of the largest load: what a step may carry to be called a small one
LINEAR_ELEMENTS = ("fem-linear", "fem-condensed", "fem-p2", "fem-p1")
POISSON = "tissue.poisson_ratio"


@dataclass(frozen=True)
class Reason:
    """One cause: which, what is said of it, and the figures that show it (shares, SI) by what they are."""

    cause: str
    sentence: str
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Shortfall:
    """A model that is not within its limits in every case, seen in the case that decides."""

    digest: Digest
    model: str

    @property
    def limits(self) -> Acceptance:
        """Those of the study."""
        return self.digest.limits

    @cached_property
    def case(self) -> CaseResult:
        """The case in which the model has an answer and stands worst; any where it has none."""
        shares = [self.limits.share(case, self.model) for case in self.digest.cases]
        return self.digest.cases[
            int(np.argmax([share if math.isfinite(share) else -1.0 for share in shares]))
        ]

    @cached_property
    def broken(self) -> tuple[Criterion, ...]:
        """The limits that it surely or perhaps breaks there, of those that a load decides."""
        step = self.case.full_load
        return tuple(
            c for c in self.limits.of_load.criteria if c.state(self.case, self.model, step) != WITHIN
        )

    def part(self, model: str, step: int | None = None) -> float:
        """How much of what is broken another model, or another step, takes: the largest share of a limit."""
        step = self.case.full_load if step is None else step
        shares = [c.at(self.case, model, step) / c.allowed for c in self.broken]
        return max((share for share in shares if math.isfinite(share)), default=0.0)

    def errors(self, model: str, step: int | None = None) -> dict[str, float]:
        """Displacement error and error in change of shape; NaN where there is none."""
        step = self.case.full_load if step is None else step
        both = self.limits.criteria[:2]
        return {c.key: c.at(self.case, model, step) for c in both}

    @cached_property
    def linear_elements(self) -> str | None:
        """Elements that solve the linear problem and are held against the reference."""
        compared = [name for name in self.digest.compared if name in self.case.models]
        return next((n for base in LINEAR_ELEMENTS for n in compared if n == base != self.model), None)

    @cached_property
    def finite_strain(self) -> bool:
        """Whether the reference follows large displacements."""
        return split(str(self.case.reference))[0] in FINITE_STRAIN


def off(errors: dict[str, float], word: str = " off") -> str:
    """`12.3 % off in displacement and 20.8 % in change of shape`, what is known of it."""
    names = (f"{word} in displacement", " in change of shape")
    return listed(
        f"{exact_percent(value)}{name}"
        for value, name in zip(errors.values(), names, strict=True)
        if math.isfinite(value)
    )


def exact_percent(value: float) -> str:
    """A share as it is read against a limit: 11.6 %, where 12 % would mislead."""
    return f"{round(100.0 * value, 1):g} %" if 0.01 <= value < 1.0 else short_percent(value)


# --- the causes ---


def reasons(digest: Digest, model: str) -> tuple[Reason, ...]:
    """Every cause that this study's figures show; none where the model is within its limits in every case."""
    states = [digest.limits.state(case, model, case.full_load) for case in digest.cases]
    if set(states) == {WITHIN}:
        return ()
    shortfall = Shortfall(digest, model)
    found = tuple(reason for find in CAUSES for reason in find(shortfall))
    if found or not shortfall.broken:
        return found
    return (Reason(NOT_TOLD, _how_to_tell(shortfall)),)


def no_answer(shortfall: Shortfall) -> Iterator[Reason]:
    """Cases in which the model stops before full load, with the first reason that it gives."""
    digest, model = shortfall.digest, shortfall.model
    lost = [
        c for c in digest.cases if digest.limits.state(c, model, c.full_load) == LOST and model in c.models
    ]
    statuses = [c.models[model].status[step] for c in lost for step in failed_steps(c.models[model])[:1]]
    if statuses:
        first = statuses[0]
        cure = f" What helps: {first.remedy}." if first.remedy else ""
        text = f"No answer in {len(lost)} of {len(digest.cases)} cases: {first.message or first.code}.{cure}"
        if len(digest.cases) == 1:
            text = f"No answer: {first.message or first.code}.{cure}"
        yield Reason(NO_ANSWER, text, {"cases": float(len(lost))})


def the_model(shortfall: Shortfall) -> Iterator[Reason]:
    """What the model is off by however small the load: against linear elements, else at the smallest step."""
    model = shortfall.model
    if shortfall.finite_strain and is_linear(model) and shortfall.linear_elements:
        errors, against = _against(shortfall, shortfall.linear_elements), shortfall.linear_elements
        if _share(shortfall, errors) >= HALF:
            text = f"The model: at any load it is {off(errors, '')} away from {against}, which is linear too."
            yield Reason(MODEL, text, errors)
        return
    if not shortfall.finite_strain and is_linear(model):
        other = max(_mesh_part(shortfall), _left_out_part(shortfall))
        if shortfall.part(model) - other >= HALF:
            errors = shortfall.errors(model)
            text = f"The model: it is {off(errors)} at any load, as both it and the reference are linear."
            yield Reason(MODEL, text, errors)
        return
    step = _small_step(shortfall.case)
    if step is not None and shortfall.part(model, step) >= HALF:
        errors = shortfall.errors(model, step)
        text = f"The model: at {_load(shortfall.case, step)}, the smallest load, it is {off(errors)}."
        yield Reason(MODEL, text, errors)


def what_is_left_out(shortfall: Shortfall) -> Iterator[Reason]:
    """Inclusions that the model does not know: elements without them are as far off."""
    elements = _without_inclusions(shortfall)
    if elements is not None and _left_out_part(shortfall) >= HALF:
        errors = shortfall.errors(elements)
        names = listed(entry.name for entry in shortfall.case.study.inclusions or ())
        yield Reason(LEFT_OUT, f"What is left out: {elements} without {names} is {off(errors)} too.", errors)


def small_strain_ended(shortfall: Shortfall) -> Iterator[Reason]:
    """What every linear model is off by at this load: linear elements are as far off, or the error grows."""
    model = shortfall.model
    if not shortfall.finite_strain or not is_linear(model):
        return
    elements, step = shortfall.linear_elements, _small_step(shortfall.case)
    if elements is not None:
        if shortfall.part(elements) - _mesh_part(shortfall) >= HALF:
            errors = shortfall.errors(elements)
            text = f"Small strain has ended: {elements}, linear elements, is {off(errors)} at this load."
            yield Reason(SMALL_STRAIN, text, errors)
    elif step is not None and shortfall.part(model) - shortfall.part(model, step) >= HALF:
        first, last = shortfall.errors(model, step), shortfall.errors(model)
        text = (
            f"Small strain has ended: it is {off(first)} at {_load(shortfall.case, step)}, and {off(last)} at "
            "full load."
        )
        yield Reason(SMALL_STRAIN, text, last)


def compressibility(shortfall: Shortfall) -> Iterator[Reason]:
    """The error grows as Poisson's ratio falls, and only cases at low ratios are not within."""
    digest, model = shortfall.digest, shortfall.model
    shares: dict[float, list[float]] = {}
    inside: dict[float, bool] = {}
    for case in digest.cases:
        ratio = case.swept.get(POISSON)
        if isinstance(ratio, int | float):
            shares.setdefault(float(ratio), []).append(digest.limits.of_load.share(case, model))
            within = digest.limits.of_load.state(case, model, case.full_load) == WITHIN
            inside[float(ratio)] = within and inside.get(float(ratio), True)
    ratios = sorted(shares)
    good = [ratio for ratio in ratios if inside[ratio]]
    bad = [ratio for ratio in ratios if not inside[ratio]]
    medians = [float(np.median(shares[ratio])) for ratio in ratios]
    if not good or not bad or max(bad) > min(good) or np.any(np.diff(medians) >= 0.0):
        return
    failing = listed(swept_value(ratio, "1") for ratio in bad)
    text = (
        f"The tissue: the error grows as Poisson's ratio falls, and only the cases at {failing} are not within. "
        "The less a tissue keeps its volume, the worse the model."
    )
    yield Reason(COMPRESSIBILITY, text, {"worst_ratio": max(bad), "least_ratio": min(good)})


def the_mesh(shortfall: Shortfall) -> Iterator[Reason]:
    """The reference's own elements on the mesh that the model has."""
    coarse = shortfall.digest.coarse_reference
    if coarse is not None and _mesh_part(shortfall) >= HALF:
        errors = shortfall.errors(coarse)
        yield Reason(
            MESH, f"The mesh: {coarse} on the same mesh is {off(errors)} against the refined one.", errors
        )


def the_reference(shortfall: Shortfall) -> Iterator[Reason]:
    """Limits that the reference's own error leaves open."""
    open_ = {
        c.name: c.bar(case)
        for case in shortfall.digest.cases
        for c in shortfall.limits.of_load.criteria
        if shortfall.limits.state(case, shortfall.model, case.full_load)
        == c.state(case, shortfall.model, case.full_load)
        == OPEN
    }
    if not open_:
        return
    units = {c.name: c.unit for c in shortfall.limits.criteria}
    bars = listed(
        f"{_value(bar, units[name])} in {name.removesuffix(' error')}" for name, bar in open_.items()
    )
    text = f"The reference: its own error is up to {bars}, too wide to tell on which side of the limit it is."
    yield Reason(REFERENCE, text, open_)


def the_time(shortfall: Shortfall) -> Iterator[Reason]:
    """A frame that takes longer than is allowed, in the slowest case."""
    for limit in shortfall.limits.criteria:
        if limit.key == "frame_time":
            times = [limit.at(case, shortfall.model, case.full_load) for case in shortfall.digest.cases]
            slowest = max((time for time in times if math.isfinite(time)), default=0.0)
            states = {limit.state(c, shortfall.model, c.full_load) for c in shortfall.digest.cases}
            if BEYOND in states:
                text = f"The time: a frame takes {quantity(slowest, 's', 2)}."
                yield Reason(TIME, text, {limit.key: slowest})
            elif OPEN in states:
                text = (
                    f"The time: {quantity(slowest, 's', 2)} was measured for a frame, on another machine, too few "
                    "times or on both sides of the limit. The same command on an idle machine measures it anew."
                )
                yield Reason(TIME, text, {limit.key: slowest})


# in the order in which they are told
CAUSES: tuple[Callable[[Shortfall], Iterator[Reason]], ...] = (
    no_answer,
    the_model,
    what_is_left_out,
    small_strain_ended,
    compressibility,
    the_mesh,
    the_reference,
    the_time,
)


def _how_to_tell(shortfall: Shortfall) -> str:
    wanted = []
    if shortfall.finite_strain and shortfall.linear_elements is None and is_linear(shortfall.model):
        wanted.append('"fem-linear" among the models')
    if shortfall.finite_strain and _small_step(shortfall.case) is None:
        wanted.append("a small first factor in [load]")
    if shortfall.digest.coarse_reference is None:
        wanted.append("levels = 2 in [uncertainty]")
    text = "No single cause takes half of what is allowed."
    return f"This study does not tell why. It would with {listed(wanted)}." if wanted else text


def _mesh_part(shortfall: Shortfall) -> float:
    coarse = shortfall.digest.coarse_reference
    return shortfall.part(coarse) if coarse is not None else 0.0


def _without_inclusions(shortfall: Shortfall) -> str | None:
    """Elements that leave out the same inclusions as the model does."""
    case = shortfall.case
    homogeneous = case.study.study.homogeneous
    if shortfall.model not in homogeneous or not case.study.inclusions:
        return None
    known = [name for name in homogeneous if name in shortfall.digest.compared and name in case.models]
    return next(
        (name for name in known if split(name)[0] in LINEAR_ELEMENTS and name != shortfall.model), None
    )


def _left_out_part(shortfall: Shortfall) -> float:
    elements = _without_inclusions(shortfall)
    return shortfall.part(elements) if elements is not None else 0.0


def _against(shortfall: Shortfall, other: str) -> dict[str, float]:
    """The errors of the model against another one in the same case, at full load."""
    case, step = shortfall.case, [shortfall.case.full_load]
    surface = shortfall.digest.surfaces[case.hash]
    histories = [
        History(
            case.models[n].displacement[step], case.models[n].reaction_force[step], case.load_factors[step]
        )
        for n in (shortfall.model, other)
    ]
    keys = [c.key for c in shortfall.limits.criteria[:2]]
    values = [float(METRICS[name].function(surface, *histories)[0]) for name in (VECTOR, DEFORMATION)]
    return dict(zip(keys, values, strict=True))


def _share(shortfall: Shortfall, errors: dict[str, float]) -> float:
    """The largest of some errors over their limits, of the limits that are broken; over all where others are."""
    criteria = [
        c for c in shortfall.limits.criteria[:2] if c in shortfall.broken
    ] or shortfall.limits.criteria[:2]
    shares = [errors[c.key] / c.allowed for c in criteria if math.isfinite(errors[c.key])]
    return max(shares, default=0.0)


def _small_step(case: CaseResult) -> int | None:
    """The step of the smallest load, where that is small beside the largest."""
    sizes = np.abs(case.load_factors)
    steps = np.flatnonzero(sizes > 0.0)
    if not len(steps):
        return None
    step = int(steps[np.argmin(sizes[steps])])
    return step if sizes[step] <= SMALL * sizes.max() else None


def _load(case: CaseResult, step: int) -> str:
    unit = load_unit(case) or "1"
    return load_in_words(abs(float(loads_of(case, unit)[step])), unit)


def _value(value: float, unit: str) -> str:
    return exact_percent(value) if unit == "1" else quantity(value, unit, 2)
