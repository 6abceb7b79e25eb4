"""The verdicts in plain sentences, the same wherever they are shown: a row a family, what to take, why."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ..scene.warnings import MOST_DRIFT, MOST_MOVED
from ..study.registry import Family
from .formatting import listed, plural, quantity, short_percent
from .inputs_known import inputs_in_words
from .loading import load_in_words
from .verdict import Limit, ModelErrors, Setting, Verdict, Verdicts
from .why_not import exact_percent

TITLES = {
    Family.PRINTED: "VDM as printed",
    Family.DERIVED: "VDM, derived",
    Family.PEERS: "Surface peers",
    Family.ELEMENTS: "Elements",
    Family.ENGINES: "Engines",
}
WHY = "Why not?"
DO = "What to do?"
LIMITS = "Against which limits?"
MEASURED = "What does the measurement say?"
INPUTS = "Is the error larger than what is not known of the inputs?"
LOAD = "Up to which load?"
WITH = "With which parameters?"
COST = "At what cost?"
SURE = "How sure is this?"
FIRST = (WHY, DO, MEASURED, INPUTS)  # what a terminal shows too
_MOST_NAMED = 4  # cases out of range
_KIND = "These are differences between computations. Nothing here was compared with an experiment."


@dataclass(frozen=True)
class Row:
    """The answer for one family: its name in words, the word, and one line with the numbers that decide."""

    family: str
    title: str
    word: str
    text: str


@dataclass(frozen=True)
class Answer:
    """A question of the reader and the sentences that answer it."""

    question: str
    sentences: Sequence[str]


@dataclass(frozen=True)
class Told:
    """All that a run says: a row a family, what holds for all rows, what to take instead, and further answers."""

    rows: tuple[Row, ...]
    notes: tuple[str, ...]
    instead: tuple[str, ...]
    further: tuple[Answer, ...]


def told(verdicts: Verdicts) -> Told:
    """The verdicts in words."""
    judged = [one for one in verdicts.asked if one.model]
    found = [
        _answer(WHY, [f"{one.model}: {_small(r.sentence)}" for one in judged for r in one.why_not]),
        _answer(DO, [f"{one.model}: {_small(one.advice)}" for one in judged if one.advice]),
        _answer(MEASURED, verdicts.measured[:1]),
        _answer(INPUTS, inputs_in_words(verdicts.inputs)),
        _answer(LIMITS, _limits_told(judged)),
        _answer(LOAD, [*(s for one in judged for s in _up_to(one)), *_small_strain(verdicts)]),
        _answer(WITH, [*(_parameters(one) for one in judged), *_others(verdicts), *verdicts.motion]),
        _answer(COST, _costs(verdicts, judged)),
        _answer(SURE, [*verdicts.sureness, *(verdicts.measured[1:] or ([_KIND] if verdicts.errors else []))]),
    ]
    return Told(
        rows=tuple(
            Row(one.family, TITLES[Family(one.family)], one.word, _row(verdicts, one))
            for one in verdicts.asked
        ),
        notes=tuple(filter(None, [verdicts.not_judged, _outside(verdicts), *verdicts.reservations])),
        instead=tuple(
            f"{a.interaction[:1].upper()}{a.interaction[1:]}: {_small(a.sentence)}" for a in verdicts.take
        ),
        further=tuple(answer for answer in found if answer.sentences),
    )


def _answer(question: str, sentences: Iterable[str]) -> Answer:
    return Answer(question, tuple(sentence for sentence in sentences if sentence))


def _small(sentence: str) -> str:
    """A sentence after a colon."""
    first = sentence.split(" ", 1)[0]
    return sentence if first.isupper() and len(first) > 1 else f"{sentence[:1].lower()}{sentence[1:]}"


# --- the rows ---


def _row(verdicts: Verdicts, one: Verdict) -> str:
    """One line: the model that decides, the number that leads, in how many cases it is within, the worst case."""
    if not one.model:
        errors = [e for e in verdicts.errors if e.model in one.models]
        return f"{'; '.join(f'{e.model}: {_both(e)}' for e in errors)}." if errors else ""
    lead, several = one.lead, verdicts.cases > 1
    if one.same:
        return f"{one.model}: the numbers of {verdicts.reference} itself, on its mesh: no test of accuracy."
    if lead is None:
        return f"{one.model}: no answer in {'any case' if several else 'the only case'}."
    beside = [] if math.isnan(lead.floor) else [f"displacement {exact_percent(lead.displacement)}"]
    beside += (
        [f"change of shape {exact_percent(lead.deformation)}"] if math.isfinite(lead.deformation) else []
    )
    beside += [f"least along normals {exact_percent(lead.floor)}"] if math.isfinite(lead.floor) else []
    text = f"{one.model}: {lead.name} {_with_bar(lead.value, lead.bar)}"
    text += f" ({', '.join(beside)})" if beside else ""
    if several:
        text += f"; within {_limits(one)} in {one.within or 'none'} of {plural(one.judged, 'case')}"
        text += f", {one.undecided} undecided" if one.undecided else ""
        text += f"; worst: {one.worst}, {_with_bar(lead.worst, lead.worst_bar)}"
    if over := _over(one):
        text += f"; {over}"
    return f"{text}."


def _over(one: Verdict) -> str:
    """The limits beside those of the two errors that it does not keep, with their numbers."""
    return listed(
        f"{limit.name} {measure(limit.value, limit.unit)} of {measure(limit.allowed, limit.unit)} allowed"
        for limit in one.limits[2:]
        if limit.word != "yes" and math.isfinite(limit.value)
    )


def _outside(verdicts: Verdicts) -> str:
    """Which cases are not judged, and why."""
    out = verdicts.outside
    if not out:
        return ""
    moved, drift = max(one.moved for one in out), max(one.drift for one in out)
    parts = (
        [f"moves the body by up to {short_percent(moved)} of its smallest extent"]
        if moved > MOST_MOVED
        else []
    )
    if drift > MOST_DRIFT:
        parts.append(f"changes the body's volume by up to {short_percent(drift)}")
    which = listed(one.name for one in out[:_MOST_NAMED])
    more = f" and {len(out) - _MOST_NAMED} more" if len(out) > _MOST_NAMED else ""
    where = (
        f" in {len(out)} of {plural(verdicts.cases, 'case')} ({which}{more})" if verdicts.cases > 1 else ""
    )
    count = f"{verdicts.cases - len(out)} of {verdicts.cases} judged. " if verdicts.cases > 1 else ""
    return (
        f"{count}The load {listed(parts)}{where}. The reference holds for small strain and cannot judge that. "
        'Lower the load, or take reference = "fem".'
    )


def _limits(one: Verdict) -> str:
    """`10 %` where both errors have that limit and there is no other, else `its limits`."""
    allowed = {(limit.allowed, limit.unit) for limit in one.limits}
    (value, unit) = next(iter(allowed))
    return short_percent(value) if len(allowed) == 1 and unit == "1" else "its limits"


def _limits_told(judged: Sequence[Verdict]) -> list[str]:
    return [f"{one.model}: {_small(limit_sentence(limit))}" for one in judged for limit in one.limits]


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
    parts = [f"{count} {word}" for count, word in counts if count]
    cases = f"; {listed(parts)}" if len(parts) > 1 else ""
    several = f" in the worst case ({limit.case}){cases}" if limit.case else ""
    text = f"{measure(limit.value, limit.unit)}{bar} of {measure(limit.allowed, limit.unit)} allowed{several}"
    return f"{name}: {limit.word}, {text}."


def measure(value: float, unit: str) -> str:
    """A number as it is read against a limit."""
    return exact_percent(value) if unit == "1" else quantity(value, unit)


def _both(errors: ModelErrors) -> str:
    parts = [f"{_with_bar(errors.displacement, errors.displacement_bar)} away in displacement"]
    if math.isfinite(errors.deformation):
        parts.append(f"{_with_bar(errors.deformation, errors.deformation_bar)} in change of shape")
    return listed(parts)


def _with_bar(value: float, bar: float) -> str:
    return f"{exact_percent(value)} ± {short_percent(bar)}" if math.isfinite(bar) else exact_percent(value)


# --- up to which load ---


def _up_to(one: Verdict) -> list[str]:
    reached = [f"{one.model}: {_small(text)}" for text in _reached(one)]
    return [*reached, one.growth]


def _small_strain(verdicts: Verdicts) -> list[str]:
    if verdicts.small_strain and not verdicts.not_judged:
        return [
            "The reference is linear, so the errors of linear models do not grow with the load. Where small strain "
            'ends, reference = "fem" tells.'
        ]
    return [verdicts.paper]


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


def _parameters(one: Verdict) -> str:
    parts = [f"{setting.name} = {_range(setting)}" for setting in one.settings]
    given = [setting.name for setting in one.settings if setting.given]
    if not parts:
        return ""
    told_by = (
        f"the study sets {listed(given)}" if given else "by rule from tissue and size of the body, not fitted"
    )
    return f"{one.model} with {listed(parts)}; {told_by}."


def _others(verdicts: Verdicts) -> list[str]:
    """The errors of models that decide in no family."""
    chosen = {one.model for one in verdicts.asked}
    others = [entry for entry in verdicts.errors if entry.model not in chosen]
    many = " (medians)" if verdicts.cases > 1 else ""
    return (
        [f"Displacement errors of the others{many}: {listed(_short(verdicts, e) for e in others)}."]
        if others
        else []
    )


def _range(setting: Setting) -> str:
    low, high = (quantity(value, setting.unit) for value in (setting.least, setting.most))
    return low if low == high else f"{low} to {high}"


def _short(verdict: Verdicts, errors: ModelErrors) -> str:
    notes = [] if errors.resolved else ["unresolved"]
    if errors.cases < verdict.cases:
        notes.append(f"in the {errors.cases} of {plural(verdict.cases, 'case')} with an answer")
    return f"{errors.model} {exact_percent(errors.displacement)}" + (
        f" ({', '.join(notes)})" if notes else ""
    )


def _costs(verdicts: Verdicts, judged: Sequence[Verdict]) -> list[str]:
    """The times of the models that decide, and of the reference's own on this mesh; no ratio: none took turns."""
    if not judged:
        return []
    peer = verdicts.reference.partition(" ")[0]
    last = peer if any(c.model == peer for c in verdicts.costs) else verdicts.reference
    names = dict.fromkeys([*(one.model for one in judged), last])
    told = []
    for cost in (c for name in names for c in verdicts.costs if c.model == name and c.frame > 0.0):
        marks = [*(["solved iteratively"] if cost.iterative else []), *cost.marks]
        set_up = f" after {quantity(cost.set_up, 's', 2)} of set-up" if math.isfinite(cost.set_up) else ""
        marked = f" ({', '.join(marks)})" if marks else ""
        told.append(f"A frame of {cost.model} takes {quantity(cost.frame, 's', 2)}{set_up}{marked}.")
    if any(c.iterative for c in verdicts.costs if c.model in names):
        told.append(
            "With its factors kept, a frame of the same elements is shorter: vdmbench bench measures it."
        )
    if len(told) > 1:
        told.append(
            "These were not measured in turns, so their ratio is not told: vdmbench bench measures that."
        )
    return told
