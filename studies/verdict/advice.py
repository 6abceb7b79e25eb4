"""What to take: with the answer of a family, and for each kind of interaction, with the figures of this study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from ..measures.metrics import DEFORMATION, VECTOR
from ..study.registry import Family, family_of, is_surface, model_names, split
from .acceptance import FRAME_TIME, UNDECIDED, WITHIN, YES
from .digest import Digest
from .why_not import COMPRESSIBILITY, MESH, MODEL, REFERENCE, SMALL_STRAIN, TIME, Reason

CONDENSED, LINEAR = "fem-condensed", "fem-linear"
RESTING, MOVING, CUTTING, EXACT = (
    "a contact that stays on one region",
    "contacts that move, loads everywhere",
    "cutting, where the topology changes",
    "a few per cent needed",
)


@dataclass(frozen=True)
class Figures:
    """A model with medians over the cases: both errors, a frame and the set-up [s], and cases within the limits.

    `same` where it has the reference's own numbers on its mesh, of which no error tells anything.
    """

    model: str
    displacement: float
    deformation: float
    frame: float
    set_up: float
    same: bool
    within: int
    cases: int


@dataclass(frozen=True)
class Advice:
    """What to take for one kind of interaction: the models that this study measured, the first before others.

    `kind` tells the templates which sentence it is; `allowed` is the limit that none keeps.
    """

    interaction: str
    kind: str
    take: tuple[Figures, ...] = ()
    allowed: float = math.nan

    @property
    def model(self) -> str:
        """The first, "" where none was measured."""
        return self.take[0].model if self.take else ""


@dataclass(frozen=True)
class NextStep:
    """What to do with the answer of a family: `kind` tells the templates which sentence it is."""

    kind: str
    take: Figures | None = None
    value: float = math.nan
    name: str = ""


# --- the next step ---


def next_step(digest: Digest, model: str, word: str, why: Sequence[Reason]) -> NextStep:
    """What to do with this answer."""
    if word == YES:
        better = _better(digest, model)
        return NextStep("better", figures(digest, better)) if better else NextStep("take it")
    causes = {reason.cause: reason for reason in why}
    off_anyway = MODEL in causes and _breaks(digest, causes[MODEL])
    if SMALL_STRAIN in causes and not off_anyway:
        return _nonlinear(digest, model)
    if word == UNDECIDED and REFERENCE in causes:
        levels = max((case.reference_error.get("levels", 1.0) for case in digest.cases), default=1.0)
        return NextStep("levels", value=int(levels) + 1)
    if COMPRESSIBILITY in causes:
        return NextStep("ratios", value=causes[COMPRESSIBILITY].numbers["least_ratio"], name=model)
    if MESH in causes and not off_anyway:
        return NextStep("finer mesh")
    others = [name for name in digest.compared if name != model and _within(digest, name)]
    if others:
        quick = min(others, key=lambda name: digest.costs[name].frame)
        return NextStep("another", figures(digest, quick))
    if causes.keys() == {TIME}:
        return NextStep("coarser mesh")
    if SMALL_STRAIN in causes:
        return NextStep("large elements")
    return NextStep("elements", name=str(digest.reference))


def _breaks(digest: Digest, reason: Reason) -> bool:
    """Whether a cause alone is beyond a limit."""
    return any(reason.numbers.get(c.key, 0.0) > c.allowed for c in digest.limits.criteria)


def _nonlinear(digest: Digest, model: str) -> NextStep:
    """What to do where small strain has ended."""
    partner = f"{split(model)[0]}:nonlinear"
    if partner in digest.compared and math.isfinite(_worst_share(digest, partner)):
        closer = _worst_share(digest, partner) < _worst_share(digest, model)
        return NextStep("take nonlinear" if closer else "nonlinear no better", figures(digest, partner))
    if partner in digest.models:
        return NextStep("nonlinear stops", name=partner)
    if partner not in model_names():
        return NextStep("no nonlinear")
    return NextStep("try nonlinear", name=partner)


# --- by the kind of interaction ---


def by_interaction(digest: Digest) -> tuple[Advice, ...]:
    """What to take by what touches the body."""
    surface = _answered(digest, filter(is_surface, digest.compared))
    elements = _answered(digest, digest.families[Family.ELEMENTS])
    found = [
        _resting(digest),
        *([_moving(digest, surface), _cutting(digest, surface)] if surface else []),
    ]
    return (*found, _exact(digest, surface, elements))


def _resting(digest: Digest) -> Advice:
    """Every linear model costs the same small product per frame there; condensed elements err as linear ones do."""
    for name in (CONDENSED, LINEAR):
        if name in digest.compared and math.isfinite(_worst_share(digest, name)):
            found = figures(digest, name)
            told = found if name == CONDENSED else replace(found, frame=math.nan, set_up=math.nan)
            return Advice(RESTING, "condensed", (told,))
    return Advice(RESTING, "condensed")


def _moving(digest: Digest, surface: Sequence[str]) -> Advice:
    limit = next((c.allowed for c in digest.limits.criteria if c.key == FRAME_TIME), math.inf)
    quick = [n for n in surface if limit == math.inf or digest.costs[n].frame <= limit]
    if not quick:
        return Advice(MOVING, "none quick enough", allowed=limit)
    return Advice(MOVING, "closest surface", (figures(digest, _closest(digest, quick)),))


def _cutting(digest: Digest, surface: Sequence[str]) -> Advice:
    """A cut makes a new body: the least set-up, and what the closest form's costs."""
    first = min(surface, key=lambda name: digest.costs[name].set_up)
    names = dict.fromkeys([first, _closest(digest, surface)])
    return Advice(CUTTING, "set-up", tuple(figures(digest, name) for name in names))


def _exact(digest: Digest, surface: Sequence[str], elements: Sequence[str]) -> Advice:
    """Elements, unless a surface model is closer than all of them that are not the reference's own numbers."""
    if not elements:
        return Advice(EXACT, "elements")
    told = [name for name in elements if not digest.same_as_reference(name)]
    best = _closest(digest, [*told, *surface]) if told else elements[0]
    return Advice(EXACT, "closer surface" if best in surface else "elements", (figures(digest, best),))


# --- figures ---


def figures(digest: Digest, name: str) -> Figures:
    """What is known of a model."""
    cost, limits = digest.costs[name], digest.limits
    return Figures(
        name,
        digest.median(name, VECTOR),
        digest.median(name, DEFORMATION),
        cost.frame,
        cost.set_up,
        digest.same_as_reference(name),
        sum(limits.state(case, name) == WITHIN for case in digest.cases),
        len(digest.cases),
    )


def _worst_share(digest: Digest, name: str) -> float:
    """The largest of what is limited over its limit in any case; infinite where a case has no answer."""
    return max((digest.limits.share(case, name) for case in digest.cases), default=math.inf)


def _closest(digest: Digest, names: Iterable[str]) -> str:
    return min(names, key=lambda name: digest.limits.usual_share(digest.cases, name))


def _answered(digest: Digest, names: Iterable[str]) -> list[str]:
    """Models with an answer at full load in more than half of the cases."""
    return [name for name in names if math.isfinite(digest.limits.usual_share(digest.cases, name))]


def _within(digest: Digest, name: str) -> bool:
    return all(digest.limits.state(case, name) == WITHIN for case in digest.cases)


def _better(digest: Digest, model: str) -> str | None:
    """A model of another family that is closer and faster per frame, in every case."""
    mine = digest.costs[model].frame
    better = [
        name
        for name in digest.compared
        if family_of(name) is not family_of(model)
        and _worst_share(digest, name) < _worst_share(digest, model)
        and digest.costs[name].frame < mine
    ]
    return _closest(digest, better) if better else None
