"""The answer at the top of the page: five questions, each answered in plain words from the numbers of the run."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from ..measures.case import CaseResult
from ..measures.uncertainty import is_resolved
from ..study.model_name import PARAMETERS, is_vdm
from ..verdict.acceptance import LOST, OPEN, WITHIN
from ..verdict.digest import Digest, ModelSummary, Spread
from ..verdict.formatting import listed, parameter_name, plain, plural, quantity, short_percent, swept_value
from ..verdict.standing import word_of
from .blocks import Answer
from .verdict_load import beyond_small_strain, loads_in_words, value_range

_MOST_VALUES = 4
SURFACE_MODELS = ("vdm-", "mass-spring")


def answers(digest: Digest) -> list[Answer]:
    """What came out. Without anything to compare, one answer that says so."""
    run = digest.run
    asked = len(digest.cases) + len(run.failed) + len(run.missing)
    if not digest.cases:
        text = f"None of the {plural(asked, 'case')} has a result yet, so there is nothing to compare."
        return [Answer("", "", (text,))]
    if digest.reference is None:
        text = (
            "The models were run without a reference, so this page shows what they answer "
            "and not how far they are from the truth."
        )
        return _alone(text, digest)
    rated = {s.name: s.vector for s in digest.summaries if s.name in digest.candidates and s.vector}
    if not rated or digest.focus not in rated:
        text = f"No model has a result at full load to hold against {digest.reference}."
        return _alone(text, digest)
    best = next(s for s in digest.summaries if s.name == digest.focus)
    outside = beyond_small_strain(digest)
    return [
        _good_enough(digest, best, rated, outside),
        _answer("Up to which load?", "", loads_in_words(digest, best.name, outside)),
        _answer("With which formulation and parameters?", "", _parameters(digest, best, rated)),
        _answer("At what cost per frame?", "", _cost(digest, best)),
        _answer("How sure is this?", "", [_resolution(digest, rated[best.name]), *_gaps(digest), _KIND]),
    ]


_KIND = "This is a difference between computations: nothing here was compared with an experiment."


def _alone(text: str, digest: Digest) -> list[Answer]:
    """What there is to say without a comparison, and what is not in it."""
    gaps = _gaps(digest)
    return [Answer("", "", (text,)), *([_answer("How sure is this?", "", gaps)] if gaps else [])]


def _answer(question: str, word: str, sentences: Iterable[str]) -> Answer:
    return Answer(question, word, tuple(sentence for sentence in sentences if sentence))


# --- good enough? ---


def _good_enough(digest: Digest, best: ModelSummary, rated: dict[str, Spread], outside: str) -> Answer:
    question = "Is it good enough?"
    if str(digest.reference).startswith(SURFACE_MODELS):
        rest = f"the reference, {digest.reference}, is a surface model itself: agreement with it is not accuracy."
        return _answer(question, "Not judged", [rest, _accuracy(digest, best, among=len(rated))])
    if outside:
        return _answer(question, "Not judged", [outside, _accuracy(digest, best, among=len(rated))])
    states = [digest.limits.state(case, best.name, case.full_load) for case in digest.cases]
    limit = digest.limits.in_words
    count, within, left, lost = len(states), *map(states.count, (WITHIN, OPEN, LOST))
    beyond = count - within - left - lost
    every = " in every case" if count > 1 else ""
    bare = "" if rated[best.name].measured else " (no error bar)"
    word = word_of(states)
    if within == count:
        rest = f"displacement and deformation error are within {limit}{every}"
    elif left == count:
        rest = f"the reference's own error leaves open whether the model is within {limit}"
    elif beyond == count:
        rest = f"not within {limit}{every.replace('every', 'any')}"
    else:
        parts = [f"within {limit} in {within} of {count} cases"] if within else []
        parts += [f"beyond in {beyond}"] if beyond else []
        parts += [f"undecided in {left}, within the reference's own error"] if left else []
        parts += [f"no answer in {lost}"] if lost else []
        none = "" if within else f"within {limit} in none of {count} cases: "
        rest = f"{none}{listed(parts)}"
    return _answer(
        question,
        word,
        [f"{rest}{bare}.", _accuracy(digest, best, among=len(rated)), _what_decides(digest, states)],
    )


def _what_decides(digest: Digest, states: Sequence[str]) -> str:
    """The swept parameter whose value alone tells the cases within the tolerance from the others."""
    for key in digest.swept_keys:
        inside = {c.swept.get(key) for c, s in zip(digest.cases, states, strict=True) if s == WITHIN}
        outside = {c.swept.get(key) for c, s in zip(digest.cases, states, strict=True) if s != WITHIN}
        if not inside or not outside or inside & outside or None in inside:
            continue
        unit = next((case.swept_units.get(key, "1") for case in digest.cases if key in case.swept), "1")
        values = [v for v in dict.fromkeys(case.swept.get(key) for case in digest.cases) if v in inside]
        shown = [swept_value(v, unit) for v in values if v is not None]
        if len(shown) <= _MOST_VALUES:
            within = f"Within {digest.limits.in_words} are the cases with"
            return f"{within} {parameter_name(key)} = {' or '.join(shown)}."
    return ""


def _with_bar(value: float, bar: float) -> str:
    digits = 3 if 0.1 <= abs(value) < 1.0 else 2  # 11.6 % is read against the tolerance, 12 % would mislead
    shown = f"{plain(100.0 * value, digits)} %"
    return f"{shown} ± {short_percent(bar)}" if math.isfinite(bar) else shown


def _accuracy(digest: Digest, best: ModelSummary, among: int) -> str:
    kind = "VDM models" if all(map(is_vdm, digest.candidates)) else "models"
    subject = f"{best.name}, the best of {among} {kind}," if among > 1 else best.name
    parts: list[str] = []
    for spread, what in ((best.vector, "in surface displacement"), (best.deformation, "in deformation")):
        if spread is None:
            continue
        text = _with_bar(spread.median, spread.median_bar)
        text += f" off {digest.reference} {what}" if not parts else f" {what}, rigid motion taken out of both"
        if spread.cases > 1:
            text += f" (worst case {_with_bar(spread.worst, spread.worst_bar)})"
        parts.append(text)
    answered = _answered(digest, best.vector)
    return f"At full load{f', {answered},' if answered else ''} {subject} is {' and '.join(parts)}."


def _answered(digest: Digest, error: Spread | None) -> str:
    """In how many cases a model has an answer at full load, where it is not all."""
    found, count = error.cases if error is not None else 0, len(digest.cases)
    return f"in the {found} of {plural(count, 'case')} with an answer" if found < count else ""


# --- formulation, cost, certainty ---


def _parameters(digest: Digest, best: ModelSummary, rated: dict[str, Spread]) -> list[str]:
    results = [case.models[best.name] for case in digest.cases if best.name in case.models]
    parts = []
    told: list[str] = []
    for key in PARAMETERS:  # of which a result records those that its model reads
        name, unit = PARAMETERS[key]
        values = [v for result in results if isinstance(v := result.parameters.get(key), int | float)]
        if values:
            told.append(key)
            parts.append(f"{name} = {value_range([float(v) for v in values], unit)}")
    chosen = sorted({key for case in digest.cases for key in _given(case, best.name)} & set(told))
    text = best.name + (f" with {listed(parts)}" if parts else "")
    if parts:
        text += (
            f"; {listed(PARAMETERS[key][0] for key in chosen)} by the study"
            if chosen
            else ", not fitted: by rule from the tissue and the size of the body"
        )
    others = {name: spread for name, spread in rated.items() if name != best.name}
    sentences = [f"{text}."]
    if others:
        many = " (medians)" if len(digest.cases) > 1 else ""
        sentences.append(f"The others: {listed(_short(digest, n, e) for n, e in others.items())}{many}.")
    return sentences


def _given(case: CaseResult, model: str) -> set[str]:
    """VDM parameters that the study sets for a model."""
    own = case.resolved.get("models")
    table = own.get(model) if isinstance(own, dict) else None
    return {*(case.resolved.get("vdm") or {}), *(table or {})}


def _short(digest: Digest, name: str, error: Spread) -> str:
    """A model's median, named unresolved where the reference's own error was measured and is too wide for it."""
    resolved = not error.measured or is_resolved(error.median, error.median_bar)
    text = f"{name} {short_percent(error.median)}{'' if resolved else ' (unresolved)'}"
    return " ".join(filter(None, (text, _answered(digest, error))))


def _cost(digest: Digest, best: ModelSummary) -> list[str]:
    """Against the reference's own model on the same mesh where there is one: a finer mesh costs more by choice."""
    peer = digest.coarse_reference or digest.reference
    reference = next((s for s in digest.summaries if s.name == peer), None)
    if reference is None or not (best.seconds_per_step > 0 and reference.seconds_per_step > 0):
        return []
    text = (
        f"A frame of {best.name} costs {quantity(best.seconds_per_step, 's', 2)} after "
        f"{quantity(best.seconds_setup, 's', 2)} of set-up, one of {peer} "
        f"{quantity(reference.seconds_per_step, 's', 2)} after {quantity(reference.seconds_setup, 's', 2)}"
    )
    if reference.iterative:
        # what it would cost with factors kept was not measured here
        text += ", solved iteratively: with its factors kept a frame of it is shorter (vdmbench bench measures it)."
    else:
        text += f": {_faster(reference.seconds_per_step / best.seconds_per_step)} per frame."
    first = [quantity(s.seconds_setup + s.seconds_per_step, "s", 2) for s in (best, reference)]
    text += f" From a new mesh to the first answer it is {first[0]} against {first[1]}."
    earlier = [s.name for s in (best, reference) if s.earlier_cases]
    late = f"Times of {listed(earlier)} were measured in an earlier run, not beside the others."
    return [text, late if earlier else "", _beaten(digest, best)]


def _faster(ratio: float) -> str:
    if ratio >= 1.5:
        return f"{plain(ratio, 2)} times faster"
    return f"{plain(1 / ratio, 2)} times slower" if ratio <= 1 / 1.5 else "about the same"


def _beaten(digest: Digest, best: ModelSummary) -> str:
    """Models of another kind that are both faster per frame and closer."""
    better = [
        s
        for s in digest.summaries
        if s.name in digest.compared
        and s.name not in digest.candidates
        and s.vector
        and best.vector
        and s.vector.median < best.vector.median
        and s.vector.cases >= best.vector.cases
        and s.seconds_per_step < best.seconds_per_step
    ]
    if not better:
        return ""
    told = listed(
        f"{s.name} ({quantity(s.seconds_per_step, 's', 2)}, {short_percent(s.vector.median)} off, "
        f"{quantity(s.seconds_setup, 's', 2)} of set-up)"
        for s in better
        if s.vector
    )
    return f"Both faster per frame and closer: {told}."


def _resolution(digest: Digest, error: Spread) -> str:
    if not error.measured:
        return (
            f"The error of {digest.reference} itself was not measured, so these figures carry no error bar: "
            "levels = 2 in [uncertainty] measures it."
        )
    bar = f"{digest.reference} itself is uncertain by {short_percent(error.median_bar)}"
    if digest.unusual_levels:
        many = len(digest.cases) > 1
        named = [
            f"{name} in {plural(n, 'case')}" if many else name for name, n in digest.unusual_levels.items()
        ]
        bar += f" (its mesh levels are {listed(named)}: the widest margin was taken)"
    elif digest.order_is_assumed:
        bar += " (from two mesh levels, taken to converge with order 1; levels = 3 shows the order)"
    if error.resolved == error.cases:
        return f"{bar}, at most a tenth of the difference, which is thereby resolved."
    if not error.resolved:
        return (
            f"{bar}, more than a tenth of the difference, which counts as unresolved: "
            "its size is known to that margin only."
        )
    return f"{bar}; the difference is resolved in {error.resolved} of {plural(error.cases, 'case')}."


def _gaps(digest: Digest) -> list[str]:
    """What is not in these numbers: models that stopped, cases without a result."""
    run = digest.run
    stopped = [f"{s.name} in {plural(s.failed_cases, 'case')}" for s in digest.summaries if s.failed_cases]
    sentences = (
        [f"No answer at some load or at all: {listed(stopped)}; the reasons are below."] if stopped else []
    )
    failed = len(run.failed) - run.damaged
    lost = [f"{plural(failed, 'case')} failed"] if failed else []
    lost += [f"{plural(run.damaged, 'case')} whose file is damaged"] if run.damaged else []
    lost += [f"{plural(len(run.missing), 'case')} not run yet"] if run.missing else []
    if lost:
        sentences.append(
            f"Not in these numbers: {listed(lost)}; what is missing may be worse than what is here."
        )
    return sentences
