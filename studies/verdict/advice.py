"""What to take instead, for each kind of interaction, with the figures of this study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from ..measures.metrics import DEFORMATION, VECTOR
from ..study.registry import Family, is_surface
from .acceptance import FRAME_TIME, WITHIN
from .digest import Digest
from .why_not import LINEAR_ELEMENTS

LINEAR, CONDENSED = LINEAR_ELEMENTS[:2]
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


# --- by the kind of interaction ---


def by_interaction(digest: Digest) -> tuple[Advice, ...]:
    """What to take by what touches the body."""
    surface = _answered(digest, filter(is_surface, digest.compared))
    elements = _answered(digest, digest.families[Family.ELEMENTS])
    moving = [_moving(digest, surface), _cutting(digest, surface)] if surface else []
    return (_resting(digest), *moving, _exact(digest, surface, elements))


def _resting(digest: Digest) -> Advice:
    """Every linear model costs the same small product per frame there; condensed elements err as linear ones do."""
    for name in (CONDENSED, LINEAR):
        if name in digest.compared and math.isfinite(digest.shares(name).max(initial=0.0)):
            found = figures(digest, name)
            told = found if name == CONDENSED else replace(found, frame=math.nan, set_up=math.nan)
            return Advice(RESTING, "condensed", (told,))
    return Advice(RESTING, "condensed")


def _moving(digest: Digest, surface: Sequence[str]) -> Advice:
    limit = next((c.allowed for c in digest.criteria if c.key == FRAME_TIME), math.inf)
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
    return Figures(
        name,
        digest.median(name, VECTOR),
        digest.median(name, DEFORMATION),
        digest.costs[name].frame,
        digest.costs[name].set_up,
        digest.same_as_reference(name),
        int((digest.standing(name) == WITHIN).sum()),
        len(digest.cases),
    )


def _closest(digest: Digest, names: Iterable[str]) -> str:
    return min(names, key=digest.usual_share)


def _answered(digest: Digest, names: Iterable[str]) -> list[str]:
    """Models with an answer at full load in more than half of the cases."""
    return [name for name in names if math.isfinite(digest.usual_share(name))]
