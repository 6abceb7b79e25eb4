"""Why a model is not within its limits, as far as the study's numbers show, and which model to take instead."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..measures.case import CaseResult
from ..study.registry import FINITE_STRAIN, REFINED, Family, is_linear, is_surface, lacks, split
from ..study.schema import extras_for, has_weight
from .acceptance import BEYOND, FRAME_TIME, LOST, OPEN, WITHIN, Criterion
from .digest import Digest, Figures, first_failed, median_known

MODEL, LEFT_OUT, SMALL_STRAIN, MESH = "model", "left out", "small strain", "mesh"
COMPRESSIBILITY = "compressibility"
REFERENCE, TIME, NO_ANSWER, NOT_TOLD = "reference", "time", "no answer", "not told apart"
OF_ALL_CASES = {
    COMPRESSIBILITY,
    REFERENCE,
    TIME,
    NO_ANSWER,
}  # causes seen in all cases; others in the worst case
HALF = 0.5  # share of a limit from which on a cause is named
SMALL = 0.3  # largest load of a small step, over the full load
POISSON = "tissue.poisson_ratio"
LINEAR_ELEMENTS = ("fem-linear", "fem-condensed", "fem-p2", "fem-p1")


@dataclass(frozen=True)
class Reason:
    """One cause of a model that is not within its limits.

    Attributes
    ----------
    cause : one of the names above
    numbers : the figures that show it, by name: shares [1] or SI
    about : what else its sentence needs
    """

    cause: str
    numbers: dict[str, float] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Shortfall:
    """A model that is not within its limits in every case; its errors are those of its worst case."""

    digest: Digest
    model: str

    @cached_property
    def place(self) -> int:
        """Number of the case with the model's worst answer; any case if it has no answer."""
        shares = self.digest.shares(self.model)
        return int(np.argmax(np.where(np.isfinite(shares), shares, -1.0)))

    @property
    def case(self) -> CaseResult:
        """That case."""
        return self.digest.cases[self.place]

    @cached_property
    def broken(self) -> tuple[Criterion, ...]:
        """The limits that depend on the load and that the model breaks there, surely or perhaps."""
        at = self.place, self.case.full_load
        return tuple(
            c for c in self.digest.criteria if c.of_load and self.digest.states(self.model, c)[at] > WITHIN
        )

    def _at(self, model: str, one: Criterion, step: int | None) -> float:
        step = self.case.full_load if step is None else step
        return float(self.digest.history(model, one.metric)[self.place, step])

    def part(self, model: str | None, step: int | None = None) -> float:
        """Largest error over its limit, of the broken limits, of another model or step; 0 if none is known."""
        if model is None:
            return 0.0
        shares = [self._at(model, c, step) / c.allowed for c in self.broken]
        return max((share for share in shares if math.isfinite(share)), default=0.0)

    def errors(self, model: str, step: int | None = None) -> dict[str, float]:
        """Displacement error and error in change of shape at a step, NaN if not known."""
        return {c.key: self._at(model, c, step) for c in self.digest.criteria[:2]}

    def mesh_part(self, step: int | None = None) -> float:
        """Largest error over its limit that the mesh explains, of the broken limits.

        It is what the model estimates for its mesh, else the error of the reference's own model on the same mesh.
        """
        own = [self._at(self.model, c, step) / c.allowed * k for c, k in self.mesh_shares(step).items()]
        return max(own) if own else self.part(self.digest.coarse_reference, step)

    def mesh_shares(self, step: int | None = None) -> dict[Criterion, float]:
        """Broken limit -> share of the model's error, at most 1, that its own estimates of mesh errors explain.

        `mesh_error` estimates displacement errors, `shape_error` both. Empty for a model without these outputs.
        """
        result, at = self.case.models[self.model], self.case.full_load if step is None else step
        moved, largest = self.digest.criteria[0], max(self.errors(self.model, step).values())
        found: dict[Criterion, float] = {}
        for c in self.broken:
            over = {"shape_error": largest} | (
                {"mesh_error": self._at(self.model, c, step)} if c == moved else {}
            )
            shares = [result.scalars[key][at] / over[key] for key in over if key in result.scalars]
            if known := [float(share) for share in shares if math.isfinite(share)]:
                found[c] = min(1.0, max(known))
        return found

    @property
    def has_own_mesh_error(self) -> bool:
        """Whether the model estimates the error of its own mesh; that of elements does not apply to it then."""
        return not {"mesh_error", "shape_error"}.isdisjoint(self.case.models[self.model].scalars)

    @property
    def mesh_is_enough(self) -> bool:
        """Whether the model would keep every broken limit without the mesh's share of its error."""
        own, coarse = self.mesh_shares(), None if self.has_own_mesh_error else self.digest.coarse_reference
        return all(
            self._at(self.model, c, None) * (1.0 - own.get(c, 0.0)) <= c.allowed
            or self._at(self.model, c, None) - self._at(str(coarse), c, None) <= c.allowed
            for c in self.broken
        )

    @cached_property
    def elements(self) -> str | None:
        """The first compared model with linear elements; it may be the model itself."""
        return next((name for name in LINEAR_ELEMENTS if name in self.digest.compared), None)

    @cached_property
    def without_inclusions(self) -> str | None:
        """Compared linear elements that leave out the inclusions, if the model does so too."""
        leave_out = self.case.study.study.homogeneous
        if self.model not in leave_out or not self.case.study.inclusions:
            return None
        known = [n for n in leave_out if n in self.digest.compared and n != self.model]
        return next((name for name in known if split(name)[0] in LINEAR_ELEMENTS), None)

    @cached_property
    def no_nearer(self) -> str | None:
        """The best of the model's nonlinear solvers that were tried, if none improves on the model; else None."""
        tried = [n for n in self.digest.compared if split(n)[0] == split(self.model)[0] and not is_linear(n)]
        nearest = min(tried, key=lambda name: self.part(name) or math.inf, default=None)
        return nearest if nearest and not 0.0 < self.part(nearest) < self.part(self.model) else None

    @cached_property
    def finite_strain(self) -> bool:
        """Whether the reference is a finite-strain model."""
        return split(str(self.case.reference))[0] in FINITE_STRAIN

    @cached_property
    def small_step(self) -> int | None:
        """The step of the smallest load if that is small, else None.

        For a linear model under weight, which acts in full at each step, the displacement must be small too.
        """
        case = self.case
        sizes = np.abs(case.load_factors)
        steps = np.flatnonzero(sizes > 0.0)
        step = int(steps[np.argmin(sizes[steps])]) if len(steps) else 0
        small = bool(0.0 < sizes[step] <= SMALL * sizes.max())
        if small and case.reference and is_linear(self.model) and has_weight(case.study):
            moved = np.linalg.norm(case.models[case.reference].displacement, axis=(1, 2))
            small = bool(moved[step] <= SMALL * moved[case.full_load])
        return step if small else None

    @cached_property
    def load(self) -> dict[str, Any]:
        """The load of the small step and its unit."""
        known = self.digest.known_loads
        found = known.loads[(known.cases == self.place) & (known.steps == (self.small_step or 0))]
        return {"load": float(found[0]) if len(found) else math.nan, "unit": known.unit}


# --- the causes ---


def reasons(digest: Digest, model: str) -> tuple[Reason, ...]:
    """Every cause that the study's figures show; none if the model is within its limits in every case."""
    if set(digest.standing(model).tolist()) == {WITHIN}:
        return ()
    shortfall = Shortfall(digest, model)
    answers = np.isfinite(digest.shares(model)).any()
    found = tuple(reason for find in (CAUSES if answers else (no_answer,)) for reason in find(shortfall))
    return found or ((Reason(NOT_TOLD, about=_what_tells(shortfall)),) if shortfall.broken else ())


def _what_tells(shortfall: Shortfall) -> dict[str, Any]:
    """What could show a cause but is not in the study: linear elements, a small load, a second mesh.

    The first two help only if the error changes with the load, elements only for a linear model. A small load does
    not help under weight, which acts in full beside it.
    """
    digest, linear = shortfall.digest, is_linear(shortfall.model)
    grows = shortfall.finite_strain or not linear
    known = shortfall.elements is not None or _refuses(LINEAR, digest)
    return {
        "elements": LINEAR if grows and linear and not known else None,
        "load": grows and shortfall.small_step is None and not has_weight(shortfall.case.study),
        "levels": digest.coarse_reference is None,
    }


def no_answer(shortfall: Shortfall) -> Iterator[Reason]:
    """The model stops before full load in some cases; with the first message."""
    digest, model = shortfall.digest, shortfall.model
    lost = [digest.cases[k] for k in np.flatnonzero(digest.standing(model) == LOST).tolist()]
    for case in (case for case in lost if model in case.models):
        for step in first_failed(case, model):
            status = case.models[model].status[step]
            told = {"message": status.message or status.code, "remedy": status.remedy}
            about = {"cases": len(digest.cases), "first": digest.case_name(case), **told}
            yield Reason(NO_ANSWER, {"cases": float(len(lost))}, about)
            return


def the_model(shortfall: Shortfall) -> Iterator[Reason]:
    """The model's error at a small load; or, if the load does not matter, what no other cause explains."""
    model, step = shortfall.model, shortfall.small_step
    grows = shortfall.finite_strain or not is_linear(model)
    if grows and step is not None:
        if shortfall.part(model, step) - shortfall.mesh_part(step) >= HALF:
            yield Reason(MODEL, shortfall.errors(model, step), shortfall.load)
        return
    elements = shortfall.elements if grows and is_linear(model) else None
    if grows and elements is None:
        return
    others = max(map(shortfall.part, (shortfall.without_inclusions, elements)))
    if shortfall.part(model) - max(shortfall.mesh_part(), others) >= HALF:
        yield Reason(MODEL, shortfall.errors(model), {"elements": elements} if elements else {})


def what_is_left_out(shortfall: Shortfall) -> Iterator[Reason]:
    """The model leaves out inclusions: elements without them have such an error too."""
    elements = shortfall.without_inclusions
    if elements is not None and shortfall.part(elements) >= HALF:
        names = [entry.name for entry in shortfall.case.study.inclusions or ()]
        yield Reason(LEFT_OUT, shortfall.errors(elements), {"elements": elements, "inclusions": names})


def small_strain_ended(shortfall: Shortfall) -> Iterator[Reason]:
    """The load is beyond small strain: linear elements have such an error too, or the error grows with the load."""
    model, elements, step = shortfall.model, shortfall.elements, shortfall.small_step
    if not shortfall.finite_strain or not is_linear(model):
        return
    helps = {
        "no_nearer": shortfall.no_nearer,
        "lower": step is not None or not has_weight(shortfall.case.study),  # a lower load leaves the weight
    }
    if elements is not None:
        if shortfall.part(elements) - shortfall.part(shortfall.digest.coarse_reference) >= HALF:
            about = {"elements": elements, "itself": elements == model, **helps}
            yield Reason(SMALL_STRAIN, shortfall.errors(elements), about)
    elif step is not None and shortfall.part(model) - shortfall.part(model, step) >= HALF:
        first = shortfall.errors(model, step)
        yield Reason(SMALL_STRAIN, shortfall.errors(model), {"first": first, **shortfall.load, **helps})


def compressibility(shortfall: Shortfall) -> Iterator[Reason]:
    """The error grows as a swept Poisson's ratio falls, and only cases at low ratios break the limits."""
    digest = shortfall.digest
    ratios = np.array([case.swept.get(POISSON, math.nan) for case in digest.cases])
    found = np.unique(ratios[np.isfinite(ratios)])
    within = digest.at_full(digest.worst_states(shortfall.model, of_load=True)) == WITHIN
    good = np.array([within[ratios == one].all() for one in found], dtype=bool)
    medians = [float(np.median(digest.shares(shortfall.model)[ratios == one])) for one in found]
    if (
        good.any()
        and not good.all()
        and np.all(np.diff(good.astype(int)) >= 0)
        and np.all(np.diff(medians) < 0.0)
    ):
        yield Reason(COMPRESSIBILITY, about={"ratios": found[~good].tolist()})


def the_mesh(shortfall: Shortfall) -> Iterator[Reason]:
    """The mesh: the model's own estimate is large; without one, the error of the reference's elements on it."""
    coarse, own = shortfall.digest.coarse_reference, shortfall.mesh_shares()
    helps = {"enough": shortfall.mesh_is_enough}
    if shortfall.mesh_part() < HALF:
        return
    if own:
        yield Reason(MESH, {"share": max(own.values())}, helps)
    elif coarse is not None and not shortfall.has_own_mesh_error:
        yield Reason(MESH, shortfall.errors(coarse), {"elements": coarse, **helps})


def the_reference(shortfall: Shortfall) -> Iterator[Reason]:
    """Limits that the reference's error bar leaves undecided, with the largest bar of each."""
    digest, model = shortfall.digest, shortfall.model
    numbers, units = {}, {}
    for one in (c for c in digest.criteria if c.of_load):
        left_open = (digest.standing(model) == OPEN) & (digest.at_full(digest.states(model, one)) == OPEN)
        if left_open.any():
            numbers[one.name] = float(np.nanmax(digest.bars(one.metric)[left_open]))
            units[one.name] = one.unit
    if numbers:
        yield Reason(REFERENCE, numbers, {"units": units})


def the_time(shortfall: Shortfall) -> Iterator[Reason]:
    """A frame takes too long; with the slowest case, and whether the errors leave room for a coarser mesh."""
    digest, model = shortfall.digest, shortfall.model
    coarser = bool((digest.at_full(digest.worst_states(model, of_load=True)) == WITHIN).all())
    for limit in (c for c in digest.criteria if not c.of_load):
        states = set(digest.at_full(digest.states(model, limit)).tolist())
        if states & {BEYOND, OPEN}:
            times = np.nan_to_num(digest.full_loads(model, limit.metric))
            slowest = int(np.argmax(times))
            worked = float(times[slowest] - digest.time_bars(model)[slowest])
            numbers = {limit.key: float(times[slowest])} | ({"worked": worked} if worked > 0.0 else {})
            yield Reason(TIME, numbers, {"sure": BEYOND in states, "coarser": coarser})


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


LINEAR, CONDENSED = LINEAR_ELEMENTS[:2]
RESTING, MOVING, CUTTING, EXACT = (
    "a contact that stays on one region",
    "contacts that move, loads everywhere",
    "cutting, where the topology changes",
    "a few per cent needed",
)


@dataclass(frozen=True)
class Advice:
    """Which model to take for one kind of interaction.

    Attributes
    ----------
    interaction : the kind, in words
    kind : which sentence the templates take
    take : the model of this study to take; None if there is none
    allowed : limit of the time of a frame [s]; NaN if there is none
    """

    interaction: str
    kind: str
    take: Figures | None = None
    allowed: float = math.nan

    @property
    def model(self) -> str:
        """The model to take, "" if there is none."""
        return self.take.model if self.take else ""


# --- by the kind of interaction ---


def by_interaction(digest: Digest) -> tuple[Advice, ...]:
    """Which model to take for each kind of interaction."""
    surface = _answered(digest, filter(is_surface, digest.compared))
    elements = _answered(digest, digest.families[Family.ELEMENTS])
    moving = [_moving(digest, surface)] if surface else []
    contact = any(part.kind == "contact" for case in digest.cases for part in case.study.constraints)
    resting = [_resting(digest)] if contact and not _refuses(CONDENSED, digest) else []
    return (*resting, *moving, _cutting(digest, (*surface, *elements)), _exact(digest, surface, elements))


def _refuses(name: str, digest: Digest) -> bool:
    """Whether a model, of the study or not, cannot solve one of its scenes."""
    return any(lacks(name, extras_for(name, case.study)) for case in digest.cases)


def _resting(digest: Digest) -> Advice:
    """Condensed elements, with the errors of linear ones if only these were run.

    On one contact region, every linear model costs the same small matrix product per frame.
    """
    apart = CONDENSED in digest.run.study.study.homogeneous  # without the inclusions of fem-linear
    for name in (LINEAR,) if apart else (CONDENSED, LINEAR):
        if name in digest.compared and math.isfinite(digest.shares(name).max(initial=0.0)):
            if digest.usual_share(name) > 1.0:
                return _none(RESTING, digest)
            found = digest.figures[name]
            if name == LINEAR:  # condensed elements have other times
                found = replace(_apart_from_time(digest, name), frame=math.nan, set_up=math.nan)
            return Advice(RESTING, "linear" if apart else "condensed", found)
    return Advice(RESTING, "condensed")


def _moving(digest: Digest, surface: Sequence[str]) -> Advice:
    """The surface model with the least error whose frame is in time: with loads everywhere, if measured."""
    limit, quick = _in_time(digest, _serving(digest, surface))
    if not quick:
        return _none(MOVING, digest, limit)
    closest = digest.figures[min(quick, key=digest.usual_share)]
    return Advice(MOVING, "closest surface", replace(closest, frame=closest.anywhere), allowed=limit)


def _cutting(digest: Digest, names: Sequence[str]) -> Advice:
    """A cut needs a new set-up: the model within all limits that answers first after it, set-up included.

    The reference is one of them if it is on the model's mesh.
    """
    reference = digest.reference
    itself = [reference] if reference and not reference.endswith(REFINED) and _bar(digest) <= 1.0 else []
    limit, quick = _in_time(digest, [*_serving(digest, names), *itself])
    known = [digest.figures[name] for name in quick]
    anew = [replace(one, set_up=one.set_up + one.anywhere, frame=math.nan) for one in known]
    first = min((one for one in anew if math.isfinite(one.set_up)), key=lambda one: one.set_up, default=None)
    if first is None:
        return _none(CUTTING, digest, limit)
    return Advice(CUTTING, "set-up", first, allowed=limit)


def _exact(digest: Digest, surface: Sequence[str], elements: Sequence[str]) -> Advice:
    """Elements, or a surface model that is closer by more than the reference's error bar; else the reference.

    None if no model is within the limits and the reference's error bar is beyond a limit too.
    """
    if not elements and digest.reference == LINEAR:
        return Advice(EXACT, "elements", digest.figures[LINEAR])
    if not elements:
        return Advice(EXACT, "finite strain" if _refuses(LINEAR, digest) else "elements")
    told = [name for name in elements if not digest.same_as_reference(name)]
    bar = _bar(digest)

    def share(name: str) -> float:
        return digest.usual_share(name) + (bar if name in surface else 0.0)

    serving = _serving(digest, (*told, *surface))
    best = min(serving or [*told, *surface], key=share) if told else elements[0]
    reference = digest.reference
    if told and not serving and bar > 1.0:
        return Advice(EXACT, "none known")
    if told and reference is not None and not serving:
        return Advice(EXACT, "reference", digest.figures[reference])
    return Advice(EXACT, "closer surface" if best in surface else "elements", _apart_from_time(digest, best))


def _none(interaction: str, digest: Digest, allowed: float = math.nan) -> Advice:
    """The advice that no model serves."""
    return Advice(interaction, "none" if len(digest.cases) == 1 else "none in the median", allowed=allowed)


def _serving(digest: Digest, names: Iterable[str]) -> list[str]:
    """The models whose median error is within the limits."""
    return [name for name in names if digest.usual_share(name) <= 1.0]


def _in_time(digest: Digest, names: Iterable[str]) -> tuple[float, list[str]]:
    """The limit of a frame [s], NaN if there is none, and the models that keep it with loads everywhere."""
    limit = next((c.allowed for c in digest.criteria if c.key == FRAME_TIME), math.nan)
    return limit, [n for n in names if math.isnan(limit) or digest.figures[n].anywhere <= limit]


def _apart_from_time(digest: Digest, name: str) -> Figures:
    """The numbers of a compared model, with the cases within the limits of the errors alone."""
    within = digest.at_full(digest.worst_states(name, of_load=True)) == WITHIN
    return replace(digest.figures[name], within=int(within.sum()))


def _bar(digest: Digest) -> float:
    """The reference's largest error bar over its limit, medians over the cases; 0 if none was measured."""
    bars = [median_known(digest.bars(one.metric)) / one.allowed for one in digest.criteria if one.of_load]
    return max(filter(math.isfinite, bars), default=0.0)


def _answered(digest: Digest, names: Iterable[str]) -> list[str]:
    """The models with an answer at full load in more than half of the cases."""
    return [name for name in names if math.isfinite(digest.usual_share(name))]
