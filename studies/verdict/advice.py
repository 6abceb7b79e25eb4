"""What to do, and what to use for each kind of interaction, with the figures of this study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..study.registry import Family, all_models, family_of, is_surface, model_names, split
from .acceptance import UNDECIDED, WITHIN, YES, usual_share
from .digest import Digest, ModelSummary
from .formatting import quantity
from .motion import mostly_rigid
from .why_not import COMPRESSIBILITY, MESH, MODEL, REFERENCE, SMALL_STRAIN, TIME, Reason, off

CONDENSED = "fem-condensed"
RESTING, MOVING, CUTTING, EXACT = (
    "a contact that stays on one region",
    "contacts that move, loads everywhere",
    "cutting, where the topology changes",
    "a few per cent needed",
)


@dataclass(frozen=True)
class Advice:
    """What to use for one kind of interaction: the model that this study measured, "" for none, and a sentence."""

    interaction: str
    model: str
    sentence: str


# --- the next step ---


def advice(digest: Digest, model: str, word: str, why: Sequence[Reason]) -> str:
    """One sentence: what to do with this answer."""
    if word == YES:
        better = _better(digest, model)
        return (
            f"Take {_told(digest, better)}. It is closer and faster per frame."
            if better
            else _take(digest, model)
        )
    causes = {reason.cause: reason for reason in why}
    off_anyway = MODEL in causes and _breaks(digest, causes[MODEL])
    if SMALL_STRAIN in causes and not off_anyway:
        return _nonlinear(digest, model)
    if word == UNDECIDED and REFERENCE in causes:
        levels = max((int(case.reference_error.get("levels", 1.0)) for case in digest.cases), default=1)
        return (
            f"Set levels = {levels + 1} in [uncertainty]: a finer reference has a smaller error of its own."
        )
    if COMPRESSIBILITY in causes:
        ratio = causes[COMPRESSIBILITY].numbers["least_ratio"]
        return f"Take {model} for Poisson's ratios from {ratio:g} on. Below, take elements."
    if MESH in causes and not off_anyway:
        return "Take a smaller mesh_size: the mesh alone takes half of what is allowed, or more."
    others = [name for name in digest.compared if name != model and _within(digest, name)]
    if others:
        quick = min(others, key=lambda name: _summary(digest, name).seconds_per_step)
        return f"Take {_told(digest, quick)}. It is within the limits."
    if causes.keys() == {TIME}:
        return "Take a larger mesh_size, which makes a frame shorter, or allow more time."
    if SMALL_STRAIN in causes:
        return "Take elements that follow large displacements, as the reference does, or a smaller load."
    return f"Take elements: {digest.reference} is what the others are held against."


def _breaks(digest: Digest, reason: Reason) -> bool:
    """Whether a cause alone is beyond a limit."""
    return any(reason.numbers.get(c.key, 0.0) > c.allowed for c in digest.limits.criteria)


def _nonlinear(digest: Digest, model: str) -> str:
    """What to do where small strain has ended."""
    partner = f"{split(model)[0]}:nonlinear"
    if partner in digest.compared and math.isfinite(_worst_share(digest, partner)):
        errors = _errors(digest, partner)
        if _worst_share(digest, partner) < _worst_share(digest, model):
            return f"Take {partner}, which follows large displacements: it is {off(errors)} here."
        return (
            f"Lower the load: {partner}, which follows large displacements, is {off(errors)} and no better."
        )
    if partner in digest.models:
        return f"Lower the load: {partner}, which follows large displacements, has no answer at this one."
    if partner not in model_names():
        return "Lower the load, or take nonlinear elements."
    if all_models()[split(model)[0]].turns_as_one and mostly_rigid(digest):
        return (
            "Take elements that follow large displacements, as the reference does, or lower the load: the body "
            f"swings on its support, and the one rotation of {partner} does not follow a bend."
        )
    return f'Add "{partner}" to the models, which follows large displacements, or lower the load.'


# --- by the kind of interaction ---


def by_interaction(digest: Digest) -> tuple[Advice, ...]:
    """The table of answers by what touches the body, each with this study's figures."""
    surface = _answered(digest, filter(is_surface, digest.compared))
    elements = _answered(digest, digest.families[Family.ELEMENTS])
    found = [
        _resting(digest),
        _moving(digest, surface),
        _cutting(digest, surface),
        _exact(digest, surface, elements),
    ]
    return tuple(entry for entry in found if entry is not None)


def _resting(digest: Digest) -> Advice:
    text = "Every linear model costs the same small product per frame. Take elements condensed to that region"
    if CONDENSED in digest.compared and math.isfinite(_worst_share(digest, CONDENSED)):
        return Advice(
            RESTING, CONDENSED, f"{text}: {_told(digest, CONDENSED)}{_how_often(digest, CONDENSED)}."
        )
    return Advice(RESTING, "", f"{text}. Add {CONDENSED} to the models to measure them.")


def _moving(digest: Digest, surface: Sequence[str]) -> Advice | None:
    limit = next((c for c in digest.limits.criteria if c.key == "frame_time"), None)
    quick = [n for n in surface if limit is None or _summary(digest, n).seconds_per_step <= limit.allowed]
    if not surface:
        return None
    if limit is not None and not quick:
        text = f"No surface model answers within {quantity(limit.allowed, 's', 2)} per frame."
        return Advice(MOVING, "", text)
    best = _closest(digest, quick)
    return Advice(MOVING, best, f"Of the surface models the closest is {_told(digest, best)}.")


def _cutting(digest: Digest, surface: Sequence[str]) -> Advice | None:
    """A cut makes a new body: the least set-up, and what the closest form's costs."""
    if not surface:
        return None
    first = min(surface, key=lambda name: _summary(digest, name).seconds_setup)
    names = dict.fromkeys([first, _closest(digest, surface)])
    told = "; ".join(
        f"{name} takes {_set_up(digest, name)} and is {off(_errors(digest, name))}" for name in names
    )
    return Advice(CUTTING, first, f"Each cut needs a new set-up. {told}.")


def _exact(digest: Digest, surface: Sequence[str], elements: Sequence[str]) -> Advice:
    """Elements, unless a surface model is closer than all of them that are not the reference's own numbers."""
    told = [name for name in elements if not digest.same_as_reference(name)]
    best = _closest(digest, [*told, *surface]) if told or surface else ""
    if not elements:
        text = "Take elements; fem-linear on the model's mesh is not among the models compared."
        return Advice(EXACT, "", text)
    if not told:
        own = elements[0]
        return Advice(EXACT, own, f"Take elements: {_told(digest, own)}.")
    if best in surface:
        text = f"Take {_told(digest, best)}. It is closer than the elements on this mesh; finer ones come closer."
        return Advice(EXACT, best, text)
    return Advice(EXACT, best, f"Take elements: {_told(digest, best)}.")


# --- figures ---


def _summary(digest: Digest, name: str) -> ModelSummary:
    return next(s for s in digest.summaries if s.name == name)


def _errors(digest: Digest, name: str) -> dict[str, float]:
    """Median errors over the cases with an answer."""
    summary = _summary(digest, name)
    spreads = (summary.vector, summary.deformation)
    keys = [c.key for c in digest.limits.criteria[:2]]
    return {k: math.nan if s is None else s.median for k, s in zip(keys, spreads, strict=True)}


def _told(digest: Digest, name: str) -> str:
    """A model with its errors and what it costs."""
    errors = off(_errors(digest, name))
    if digest.same_as_reference(name):
        errors = "the reference's own numbers, on its mesh"
    return f"{name} ({', '.join(filter(None, (errors, _cost(digest, name))))})"


def _take(digest: Digest, name: str) -> str:
    """A model with what it costs."""
    return f"Take {': '.join(filter(None, (name, _cost(digest, name))))}."


def _cost(digest: Digest, name: str) -> str:
    """Its time, "" where none was measured."""
    frame = _summary(digest, name).seconds_per_step
    return (
        f"{quantity(frame, 's', 2)} per frame after {_set_up(digest, name)} of set-up" if frame > 0.0 else ""
    )


def _set_up(digest: Digest, name: str) -> str:
    return quantity(_summary(digest, name).seconds_setup, "s", 2)


def _worst_share(digest: Digest, name: str) -> float:
    """The largest of what is limited over its limit in any case; infinite where a case has no answer."""
    return max((digest.limits.of_load.share(case, name) for case in digest.cases), default=math.inf)


def _closest(digest: Digest, names: Iterable[str]) -> str:
    return min(names, key=lambda name: usual_share(digest.cases, name, digest.limits))


def _answered(digest: Digest, names: Iterable[str]) -> list[str]:
    """Models with an answer at full load in more than half of the cases."""
    return [name for name in names if math.isfinite(usual_share(digest.cases, name, digest.limits))]


def _within(digest: Digest, name: str) -> bool:
    states = {digest.limits.state(case, name, case.full_load) for case in digest.cases}
    return states == {WITHIN}


def _how_often(digest: Digest, name: str) -> str:
    """In how many cases a model is within the limits, where it is not all."""
    states = [digest.limits.state(case, name, case.full_load) for case in digest.cases]
    within, count = states.count(WITHIN), len(states)
    if within == count:
        return ""
    return (
        f", within the limits in {within or 'none'} of {count} cases"
        if count > 1
        else ", not within the limits"
    )


def _better(digest: Digest, model: str) -> str | None:
    """A model of another family that is closer and faster per frame, in every case."""
    mine = _summary(digest, model).seconds_per_step
    better = [
        name
        for name in digest.compared
        if family_of(name) is not family_of(model)
        and _worst_share(digest, name) < _worst_share(digest, model)
        and _summary(digest, name).seconds_per_step < mine
    ]
    return _closest(digest, better) if better else None
