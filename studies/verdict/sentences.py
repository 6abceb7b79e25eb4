"""The verdict in plain sentences: a reader's questions with their answers, the same wherever they are shown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .acceptance import NO, UNDECIDED, YES
from .formatting import listed, plural, quantity, short_percent
from .inputs_known import inputs_in_words
from .loading import load_in_words
from .verdict import Limit, ModelErrors, Setting, Verdict
from .why_not import exact_percent

GOOD = "Is it good enough?"
WHY = "Why not?"
DO = "What to do?"
MEASURED = "What does the measurement say?"
INPUTS = "Is the error larger than what is not known of the inputs?"
USE = "What to use where?"
LOAD = "Up to which load?"
WITH = "With which formulation and parameters?"
COST = "At what cost?"
SURE = "How sure is this?"
LEAD = ("", GOOD, WHY, DO, MEASURED, INPUTS)  # what decides; a page shows the others further down
_KIND = "These are differences between computations. Nothing here was compared with an experiment."


@dataclass(frozen=True)
class Answer:
    """A question of the reader, a word that answers it where one does, and the sentences that bear it out."""

    question: str
    word: str
    sentences: Sequence[str]


def answers(verdict: Verdict) -> tuple[Answer, ...]:
    """Every question that the verdict has an answer to."""
    if not verdict.word:
        found = [
            Answer("", "", (verdict.not_judged,)),
            _answer(MEASURED, verdict.measured[:1]),
            _answer(SURE, [*verdict.sureness, *verdict.measured[1:], *inputs_in_words(verdict.inputs)]),
        ]
    else:
        found = [
            Answer(GOOD, verdict.word, tuple(_good_enough(verdict))),
            _answer(WHY, [reason.sentence for reason in verdict.why_not]),
            _answer(DO, [verdict.advice]),
            _answer(MEASURED, verdict.measured[:1]),
            _answer(INPUTS, inputs_in_words(verdict.inputs)),
            _answer(USE, _what_to_use(verdict)),
            _answer(LOAD, _up_to(verdict)),
            _answer(WITH, [*_parameters(verdict), *verdict.motion]),
            _answer(COST, _costs(verdict)),
            _answer(SURE, [*verdict.sureness, *(verdict.measured[1:] or (_KIND,))]),
        ]
    return tuple(answer for answer in found if answer.sentences)


def _answer(question: str, sentences: Iterable[str]) -> Answer:
    return Answer(question, "", tuple(sentence for sentence in sentences if sentence))


# --- good enough? ---


def _good_enough(verdict: Verdict) -> list[str]:
    if verdict.not_judged:
        return [verdict.not_judged, _accuracy(verdict), *verdict.reservations]
    return [_summary(verdict), *map(limit_sentence, verdict.limits), *verdict.reservations]


def _summary(verdict: Verdict) -> str:
    among = f", the closest of {verdict.among} {verdict.kind}," if verdict.among > 1 else ""
    bare = "" if any(math.isfinite(limit.bar) for limit in verdict.limits) else " (no error bar)"
    subject, limits = f"{verdict.model}{among}", _limits(verdict)
    if verdict.cases == 1:
        if verdict.word == YES:
            return f"{subject} is within {limits}{bare}."
        if verdict.word == NO:
            return f"{subject} is not within {limits}{bare}."
        return f"{subject} is within {limits} or not: the reference is too uncertain to tell."
    if verdict.word == YES:
        return f"{subject} is within {limits} in all {verdict.cases} cases{bare}."
    if verdict.word == UNDECIDED:
        return f"{subject} is surely within {limits} in none of {verdict.cases} cases."
    only = f": those at {verdict.tells} are not" if verdict.tells and verdict.within else ""
    return f"{subject} is within {limits} in {verdict.within or 'none'} of {verdict.cases} cases{bare}{only}."


def _limits(verdict: Verdict) -> str:
    """`10 %` where both errors have that limit and there is no other, else `its limits`."""
    allowed = {(limit.allowed, limit.unit) for limit in verdict.limits}
    (value, unit) = next(iter(allowed))
    return short_percent(value) if len(allowed) == 1 and unit == "1" else "its limits"


def limit_sentence(limit: Limit) -> str:
    """One limit with its word, the number that decides and what is allowed."""
    name = f"{limit.name[:1].upper()}{limit.name[1:]}"
    if not math.isfinite(limit.value):
        return f"{name}: no answer, {measure(limit.allowed, limit.unit)} allowed."
    bar = f" ± {measure(limit.bar, limit.unit)}" if math.isfinite(limit.bar) else ""
    counts = [
        (limit.within, "within"),
        (limit.undecided, "undecided"),
        (limit.beyond, "beyond"),
        (limit.unanswered, "without an answer"),
    ]
    told = [f"{count} {word}" for count, word in counts if count]
    cases = f"; {listed(told)}" if len(told) > 1 else ""
    several = f" in the worst case ({limit.case}){cases}" if limit.case else ""
    text = f"{measure(limit.value, limit.unit)}{bar} of {measure(limit.allowed, limit.unit)} allowed{several}"
    return f"{name}: {limit.word.lower()}, {text}."


def measure(value: float, unit: str) -> str:
    """A number as it is read against a limit."""
    return exact_percent(value) if unit == "1" else quantity(value, unit)


def _accuracy(verdict: Verdict) -> str:
    return (
        f"{verdict.model} differs from {verdict.reference} by {_both(verdict.errors[0])}."
        if verdict.errors
        else ""
    )


def _both(errors: ModelErrors) -> str:
    parts = [f"{_with_bar(errors.displacement, errors.displacement_bar)} in displacement"]
    if math.isfinite(errors.deformation):
        parts.append(f"{_with_bar(errors.deformation, errors.deformation_bar)} in change of shape")
    return listed(parts)


def _with_bar(value: float, bar: float) -> str:
    return f"{exact_percent(value)} ± {short_percent(bar)}" if math.isfinite(bar) else exact_percent(value)


# --- what to use ---


def _what_to_use(verdict: Verdict) -> list[str]:
    return [
        f"{a.interaction[:1].upper()}{a.interaction[1:]}: {_small(a.sentence)}" for a in verdict.interactions
    ]


def _small(sentence: str) -> str:
    """A sentence after a colon."""
    return f"{sentence[:1].lower()}{sentence[1:]}"


# --- up to which load ---


def _up_to(verdict: Verdict) -> list[str]:
    sentences = [*_reached(verdict), *verdict.growth]
    if verdict.small_strain and verdict.word != "Not judged":
        sentences.append(
            "The reference is linear, so the errors of linear models do not grow with the load. Where small strain "
            'ends, reference = "fem" tells.'
        )
    return sentences


def _reached(verdict: Verdict) -> list[str]:
    up_to = verdict.up_to
    if up_to is None:
        return []
    limits, unit = _limits(verdict), up_to.unit
    tried = f"{load_in_words(up_to.least, unit)} to {load_in_words(up_to.most, unit)}"
    if unit in ("N", "1"):
        tried = f"{up_to.least:.3g} to {load_in_words(up_to.most, unit)}"
    if up_to.loads == 1:
        not_ = "" if up_to.all else "not surely " if up_to.open else "not "
        where = f"{load_in_words(up_to.most, unit)}{_depth(up_to.deepest)}"
        return [f"One load was tried, {where}. There it is {not_}within {limits}."]
    if up_to.none:
        tells = f": the cases at {verdict.tells} are not" if verdict.tells else ""
        surely = "surely " if up_to.open else ""
        return [f"Not {surely}within {limits} at any of the loads tried ({tried}){tells}."]
    reached = f"{load_in_words(up_to.load, unit)}{_depth(up_to.depth)}"
    if up_to.all:
        return [f"Within {limits} up to the largest load tried, {reached}."]
    more = "Beyond that it is undecided" if up_to.open else "Not beyond that"
    return [f"Within {limits} up to {reached}. {more}; tried: {tried}."]


def _depth(depth: float) -> str:
    """Indentation in millimetres, in brackets."""
    return f" ({1e3 * depth:.3g} mm of indentation)" if math.isfinite(depth) else ""


# --- parameters, cost ---


def _parameters(verdict: Verdict) -> list[str]:
    settings = verdict.settings
    parts = [f"{one.name} = {_range(one)}" for one in settings]
    given = [one.name for one in settings if one.given]
    text = f"{verdict.model} with {listed(parts)}" if parts else verdict.model
    if parts and given:
        text += f"; the study sets {listed(given)}"
    elif parts:
        text += ", by rule from the tissue and the size of the body, not fitted"
    sentences = [f"{text}."]
    others = [entry for entry in verdict.errors if entry.model != verdict.model]
    if others:
        many = " (medians)" if verdict.cases > 1 else ""
        sentences.append(
            f"Displacement errors of the others{many}: {listed(_short(verdict, e) for e in others)}."
        )
    return sentences


def _range(setting: Setting) -> str:
    low, high = (quantity(value, setting.unit) for value in (setting.least, setting.most))
    return low if low == high else f"{low} to {high}"


def _short(verdict: Verdict, errors: ModelErrors) -> str:
    notes = [] if errors.resolved else ["unresolved"]
    if errors.cases < verdict.cases:
        notes.append(f"in the {errors.cases} of {plural(verdict.cases, 'case')} with an answer")
    return f"{errors.model} {exact_percent(errors.displacement)}" + (
        f" ({', '.join(notes)})" if notes else ""
    )


def _costs(verdict: Verdict) -> list[str]:
    """The times of the model and of the reference's own model on the same mesh; no ratio: they took no turns."""
    peer = verdict.reference.partition(" ")[0]
    names = [verdict.model, *([peer] if any(c.model == peer for c in verdict.costs) else [verdict.reference])]
    told = []
    for cost in (c for name in names for c in verdict.costs if c.model == name and c.frame > 0.0):
        marks = [*(["solved iteratively"] if cost.iterative else []), *cost.marks]
        set_up = f" after {quantity(cost.set_up, 's', 2)} of set-up" if math.isfinite(cost.set_up) else ""
        marked = f" ({', '.join(marks)})" if marks else ""
        told.append(f"A frame of {cost.model} takes {quantity(cost.frame, 's', 2)}{set_up}{marked}.")
    if any(c.iterative for c in verdict.costs if c.model in names):
        told.append(
            "With its factors kept, a frame of the same elements is shorter: vdmbench bench measures it."
        )
    if len(told) > 1:
        told.append(
            "These were not measured in turns, so their ratio is not told: vdmbench bench measures that."
        )
    return told
