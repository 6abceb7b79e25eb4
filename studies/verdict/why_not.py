"""Why a model is not within its limits, told apart by what a study has measured. One function a cause.

A cause is named where it alone takes half of what a limit allows. All figures are of the case that decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, METRICS, VECTOR, History
from ..study.registry import FINITE_STRAIN, is_linear, split
from .acceptance import BEYOND, FRAME_TIME, LOST, OPEN, WITHIN, Acceptance, Criterion
from .digest import Digest, failed_steps
from .loading import load_unit, loads_of

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
    """One cause: which, the figures that show it (shares, SI) by what they are, what else its sentence needs."""

    cause: str
    numbers: dict[str, float] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)


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
        shares = np.array([self.limits.share(case, self.model) for case in self.digest.cases])
        return self.digest.cases[int(np.argmax(np.where(np.isfinite(shares), shares, -1.0)))]

    @cached_property
    def broken(self) -> tuple[Criterion, ...]:
        """The limits that it surely or perhaps breaks there, of those that a load decides."""
        step = self.case.full_load
        return tuple(c for c in self.limits.of_load if c.state(self.case, self.model, step) > WITHIN)

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


# --- the causes ---


def reasons(digest: Digest, model: str) -> tuple[Reason, ...]:
    """Every cause that this study's figures show; none where the model is within its limits in every case."""
    if {digest.limits.state(case, model) for case in digest.cases} == {WITHIN}:
        return ()
    shortfall = Shortfall(digest, model)
    found = tuple(reason for find in CAUSES for reason in find(shortfall))
    return found or ((Reason(NOT_TOLD, about=_how_to_tell(shortfall)),) if shortfall.broken else ())


def no_answer(shortfall: Shortfall) -> Iterator[Reason]:
    """Cases in which the model stops before full load, with the first reason that it gives."""
    digest, model = shortfall.digest, shortfall.model
    lost = [c for c in digest.cases if digest.limits.state(c, model) == LOST and model in c.models]
    statuses = [c.models[model].status[step] for c in lost for step in failed_steps(c.models[model])[:1]]
    if statuses:
        first = statuses[0]
        about = {"cases": len(digest.cases), "message": first.message or first.code, "remedy": first.remedy}
        yield Reason(NO_ANSWER, {"cases": float(len(lost))}, about)


def the_model(shortfall: Shortfall) -> Iterator[Reason]:
    """What the model is off by however small the load: against linear elements, else at the smallest step."""
    model, elements = shortfall.model, shortfall.linear_elements
    if shortfall.finite_strain and is_linear(model) and elements:
        errors = _against(shortfall, elements)
        if _share(shortfall, errors) >= HALF:
            yield Reason(MODEL, errors, {"against": elements})
        return
    if not shortfall.finite_strain and is_linear(model):
        other = max(_mesh_part(shortfall), _left_out_part(shortfall))
        if shortfall.part(model) - other >= HALF:
            yield Reason(MODEL, shortfall.errors(model))
        return
    step = _small_step(shortfall.case)
    if step is not None and shortfall.part(model, step) >= HALF:
        yield Reason(MODEL, shortfall.errors(model, step), _load(shortfall.case, step))


def what_is_left_out(shortfall: Shortfall) -> Iterator[Reason]:
    """Inclusions that the model does not know: elements without them are as far off."""
    elements = _without_inclusions(shortfall)
    if elements is not None and _left_out_part(shortfall) >= HALF:
        names = [entry.name for entry in shortfall.case.study.inclusions or ()]
        yield Reason(LEFT_OUT, shortfall.errors(elements), {"elements": elements, "inclusions": names})


def small_strain_ended(shortfall: Shortfall) -> Iterator[Reason]:
    """What every linear model is off by at this load: linear elements are as far off, or the error grows."""
    model = shortfall.model
    if not shortfall.finite_strain or not is_linear(model):
        return
    elements, step = shortfall.linear_elements, _small_step(shortfall.case)
    if elements is not None:
        if shortfall.part(elements) - _mesh_part(shortfall) >= HALF:
            yield Reason(SMALL_STRAIN, shortfall.errors(elements), {"elements": elements})
    elif step is not None and shortfall.part(model) - shortfall.part(model, step) >= HALF:
        first = shortfall.errors(model, step)
        yield Reason(SMALL_STRAIN, shortfall.errors(model), {"first": first, **_load(shortfall.case, step)})


def compressibility(shortfall: Shortfall) -> Iterator[Reason]:
    """The error grows as Poisson's ratio falls, and only cases at low ratios are not within."""
    digest, model = shortfall.digest, shortfall.model
    shares: dict[float, list[float]] = {}
    inside: dict[float, bool] = {}
    for case in digest.cases:
        ratio = case.swept.get(POISSON)
        if isinstance(ratio, int | float):
            shares.setdefault(float(ratio), []).append(digest.limits.share(case, model))
            within = digest.limits.state(case, model, of_load=True) == WITHIN
            inside[float(ratio)] = within and inside.get(float(ratio), True)
    ratios = sorted(shares)
    good = [ratio for ratio in ratios if inside[ratio]]
    bad = [ratio for ratio in ratios if not inside[ratio]]
    medians = [float(np.median(shares[ratio])) for ratio in ratios]
    if not good or not bad or max(bad) > min(good) or np.any(np.diff(medians) >= 0.0):
        return
    yield Reason(COMPRESSIBILITY, {"worst_ratio": max(bad), "least_ratio": min(good)}, {"ratios": bad})


def the_mesh(shortfall: Shortfall) -> Iterator[Reason]:
    """The reference's own elements on the mesh that the model has."""
    coarse = shortfall.digest.coarse_reference
    if coarse is not None and _mesh_part(shortfall) >= HALF:
        yield Reason(MESH, shortfall.errors(coarse), {"elements": coarse})


def the_reference(shortfall: Shortfall) -> Iterator[Reason]:
    """Limits that the reference's own error leaves open."""
    limits, model = shortfall.limits, shortfall.model
    undecided = [case for case in shortfall.digest.cases if limits.state(case, model) == OPEN]
    found = {
        c.name: (c.bar(case), c.unit)
        for case in undecided
        for c in limits.of_load
        if c.state(case, model, case.full_load) == OPEN
    }
    if found:
        units = {name: unit for name, (_, unit) in found.items()}
        yield Reason(REFERENCE, {name: bar for name, (bar, _) in found.items()}, {"units": units})


def the_time(shortfall: Shortfall) -> Iterator[Reason]:
    """A frame that takes longer than is allowed, in the slowest case."""
    cases, model = shortfall.digest.cases, shortfall.model
    for limit in (c for c in shortfall.limits.criteria if c.key == FRAME_TIME):
        times = [limit.at(case, model, case.full_load) for case in cases]
        slowest = max((time for time in times if math.isfinite(time)), default=0.0)
        states = {limit.state(case, model, case.full_load) for case in cases}
        if states & {BEYOND, OPEN}:
            yield Reason(TIME, {limit.key: slowest}, {"sure": BEYOND in states})


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


def _how_to_tell(shortfall: Shortfall) -> dict[str, Any]:
    """What the study lacks to tell causes apart."""
    finite = shortfall.finite_strain
    wanted = {
        '"fem-linear" among the models': (
            finite and shortfall.linear_elements is None and is_linear(shortfall.model)
        ),
        "a small first factor in [load]": finite and _small_step(shortfall.case) is None,
        "uncertainty.levels = 2": shortfall.digest.coarse_reference is None,
    }
    return {"wanted": [what for what, lacks in wanted.items() if lacks]}


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


def _load(case: CaseResult, step: int) -> dict[str, Any]:
    unit = load_unit(case) or "1"
    return {"load": abs(float(loads_of(case, unit)[step])), "unit": unit}
