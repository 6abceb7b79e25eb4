"""The decision that a run bears: is a model good enough, why not, what to use, up to which load, at what cost.

Page, terminal, JSON and Python take this object; `sentences` puts it in words.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..measures.case import CaseResult
from ..study.registry import FINITE_STRAIN, PARAMETERS, is_vdm, split
from .acceptance import BEYOND, LOST, NOT_ASKED, OPEN, WITHIN, Criterion, word_of
from .advice import Advice, advice, by_interaction
from .beyond import beyond_small_strain
from .credibility import Evidence, credibility
from .digest import Digest, ModelSummary, Spread, failed_steps
from .doubts import doubts
from .experiment import measured_in_words
from .formatting import listed, parameter_name, plural, short_percent, swept_value
from .growth import limits_in_words
from .inputs_known import InputsKnown, inputs_known
from .ladders import reading
from .motion import motion_in_words
from .up_to import UpTo, up_to
from .why_not import Reason, reasons

NOT_JUDGED = "Not judged"
SURFACE_MODELS = ("vdm-", "mass-spring")
_WORST = (BEYOND, OPEN, WITHIN, LOST)  # which case decides: the first of these that a model has
_MOST_VALUES = 4


@dataclass(frozen=True)
class Limit:
    """One limit of [acceptance] and how the model stands against it.

    Attributes
    ----------
    key, name, region : in the study file, in words, and the region that it is restricted to, "" for none
    word : Yes, In part, Undecided or No
    value, bar : the number that decides, of the worst case, and the reference's own part in it, NaN where not known
    allowed, unit : the most that is accepted
    case : the worst case, "" where there is one only
    within, undecided, beyond, unanswered : cases
    """

    key: str
    name: str
    region: str
    word: str
    value: float
    bar: float
    allowed: float
    unit: str
    case: str
    within: int
    undecided: int
    beyond: int
    unanswered: int


@dataclass(frozen=True)
class ModelErrors:
    """How far a model is off at full load: median over the cases with an answer, its bar, and the worst case."""

    model: str
    displacement: float
    displacement_bar: float
    worst_displacement: float
    deformation: float
    deformation_bar: float
    worst_deformation: float
    cases: int
    resolved: bool  # whether the reference's own error is small enough to call these figures by their size


@dataclass(frozen=True)
class Cost:
    """What a model takes: medians over cases and steps [s], the most memory [B], what stands beside the times."""

    model: str
    set_up: float
    frame: float
    memory: float
    iterative: bool
    marks: tuple[str, ...]


@dataclass(frozen=True)
class Setting:
    """A parameter of the model: smallest and largest value over the cases, and whether the study sets it."""

    name: str
    least: float
    most: float
    unit: str
    given: bool


@dataclass(frozen=True)
class Verdict:
    """The answer of a run.

    Attributes
    ----------
    word : Yes, No, Undecided, In part or Not judged; "" where there is nothing to compare
    model : the form that stands best against the limits, which all below is about; "" for none
    among, kind : how many forms it is the best of, and what they are called
    reference : what it is held against, "" for nothing
    cases, within, lost : with a result; within every limit; failed, damaged or not run
    limits : one entry per limit
    tells : the values of one swept parameter that only cases not within have, "" where none tells them
    why_not : causes, of what is not within
    not_judged : why there is no word, or no judgement
    reservations : what the model, the reference, their numbers or the scene say against the answer
    advice, interactions : what to do; what to use for each kind of interaction
    up_to : the load up to which every case is within; None where the loads are not known or nothing is judged
    growth : the small-strain limits in words, where the study searched them
    small_strain : whether the reference is a linear one
    errors : of every model that is compared, `model` first
    costs : of every model
    settings : the parameters of `model`
    motion : what the reference's motion is made of, and what that costs models that move nodes along normals
    sureness : how sure the figures are, and what is not in them
    measured : how far reference and `model` are from a measurement, where there is one
    credibility : evidence by category, shown, partly or not
    inputs : what is not known of the inputs, beside the error of `model`; None where the study does not tell
    """

    word: str
    model: str = ""
    among: int = 0
    kind: str = ""
    reference: str = ""
    cases: int = 0
    lost: int = 0
    limits: tuple[Limit, ...] = ()
    within: int = 0
    tells: str = ""
    why_not: tuple[Reason, ...] = ()
    not_judged: str = ""
    reservations: tuple[str, ...] = ()
    advice: str = ""
    interactions: tuple[Advice, ...] = ()
    up_to: UpTo | None = None
    growth: tuple[str, ...] = ()
    small_strain: bool = False
    errors: tuple[ModelErrors, ...] = ()
    costs: tuple[Cost, ...] = ()
    settings: tuple[Setting, ...] = ()
    motion: tuple[str, ...] = ()
    sureness: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    inputs: InputsKnown | None = None
    credibility: tuple[Evidence, ...] = ()

    def as_data(self) -> dict[str, Any]:
        """All of it as plain data, None where a number is not known."""
        data: dict[str, Any] = _plain(dataclasses.asdict(self))
        return data


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def verdict(digest: Digest) -> Verdict:
    """What comes out of a run."""
    # overflow is no surprise in what a model that broke down left behind
    with np.errstate(all="ignore"):
        return _verdict(digest)


def _verdict(digest: Digest) -> Verdict:
    run = digest.run
    lost = len(run.failed) + len(run.missing)
    costs = tuple(_cost(summary) for summary in digest.summaries)
    about: dict[str, Any] = {"reference": digest.reference or "", "cases": len(digest.cases), "lost": lost}
    about |= {"costs": costs, "motion": motion_in_words(digest), "sureness": tuple(_gaps(digest))}
    about |= {"measured": measured_in_words(digest, ""), "inputs": inputs_known(digest, "")}
    about["credibility"] = tuple(credibility(digest))
    if not digest.cases:
        return Verdict("", not_judged="No case has a result yet, so there is nothing to compare.", **about)
    if digest.reference is None:
        text = "No model is the reference. The page shows what the models answer, not how far off they are."
        return Verdict("", not_judged=text, **about)
    rated = {s.name: s.vector for s in digest.summaries if s.name in digest.candidates and s.vector}
    best = digest.focus
    if best is None or best not in rated:
        return Verdict(
            "", not_judged=f"No model has a result at full load to hold against {digest.reference}.", **about
        )
    about |= {
        "model": best,
        "measured": measured_in_words(digest, best),
        "inputs": inputs_known(digest, best),
        "among": len(rated),
        "kind": "VDM models" if all(map(is_vdm, digest.candidates)) else "models",
        "growth": tuple(limits_in_words(digest)),
        "small_strain": split(digest.reference)[0] not in FINITE_STRAIN,
        "errors": tuple(_errors(digest)),
        "settings": tuple(_settings(digest, best)),
        "sureness": (_sureness(digest, rated[best]), *about["sureness"]),
        "reservations": (*_reservations(digest, best), *_scene_doubts(digest)),
    }
    if str(digest.reference).startswith(SURFACE_MODELS):
        text = f"The reference, {digest.reference}, is a surface model itself. Agreement with it is not accuracy."
        return Verdict(NOT_JUDGED, not_judged=text, **about)
    if outside := beyond_small_strain(digest):
        return Verdict(NOT_JUDGED, not_judged=outside, **about)
    states = [digest.limits.state(case, best, case.full_load) for case in digest.cases]
    word, why = word_of(states), reasons(digest, best)
    reached = up_to(digest, best)
    return Verdict(
        word,
        limits=tuple(_limit(digest, best, criterion) for criterion in digest.limits.criteria),
        within=states.count(WITHIN),
        tells=_what_tells(digest, states),
        why_not=why,
        advice=advice(digest, best, word, why),
        interactions=by_interaction(digest),
        up_to=reached,
        **about,
    )


def _limit(digest: Digest, model: str, criterion: Criterion) -> Limit:
    """One limit over all cases, with the numbers of the case that stands worst against it."""
    found = [(criterion.state(case, model, case.full_load), case) for case in digest.cases]
    asked = [(state, case) for state, case in found if state != NOT_ASKED]
    states = [state for state, _ in asked]

    def size(case: CaseResult) -> float:
        value = criterion.at(case, model, case.full_load)
        return value if math.isfinite(value) else -math.inf

    deciding = next((state for state in _WORST if state in states), None)
    worst = max((case for state, case in asked if state == deciding), key=size, default=None)
    return Limit(
        key=criterion.key,
        name=criterion.name,
        region=criterion.region,
        word=word_of(states) if states else NOT_JUDGED,
        value=criterion.at(worst, model, worst.full_load) if worst is not None else math.nan,
        bar=criterion.bar(worst) if worst is not None else math.nan,
        allowed=criterion.allowed,
        unit=criterion.unit,
        case=digest.case_name(worst) if worst is not None and len(digest.cases) > 1 else "",
        within=states.count(WITHIN),
        undecided=states.count(OPEN),
        beyond=states.count(BEYOND),
        unanswered=states.count(LOST),
    )


def _errors(digest: Digest) -> list[ModelErrors]:
    found = []
    for summary in digest.summaries:
        vector, deformation = summary.vector, summary.deformation
        if summary.name not in digest.compared or vector is None:
            continue
        shape = deformation or Spread(math.nan, math.nan, math.nan, math.nan, math.nan, 0, 0, 0)
        found.append(
            ModelErrors(
                model=summary.name,
                displacement=vector.median,
                displacement_bar=vector.median_bar,
                worst_displacement=vector.worst,
                deformation=shape.median,
                deformation_bar=shape.median_bar,
                worst_deformation=shape.worst,
                cases=vector.cases,
                resolved=not vector.measured or vector.resolved == vector.cases,
            )
        )
    return sorted(found, key=lambda e: (e.model != digest.focus, max(e.displacement, e.deformation)))


def _cost(summary: ModelSummary) -> Cost:
    return Cost(
        model=summary.name,
        set_up=summary.seconds_setup,
        frame=summary.seconds_per_step,
        memory=summary.peak_bytes,
        iterative=summary.iterative,
        marks=summary.marks,
    )


def _settings(digest: Digest, model: str) -> list[Setting]:
    """The parameters of a model, of which its results record those that it reads."""
    results = [case.models[model] for case in digest.cases if model in case.models]
    given = {key for case in digest.cases for key in _given(case, model)}
    found = []
    for key, (name, unit) in PARAMETERS.items():
        values = [float(v) for r in results if isinstance(v := r.parameters.get(key), int | float)]
        if values:
            found.append(Setting(name, min(values), max(values), unit, key in given))
    return found


def _given(case: CaseResult, model: str) -> set[str]:
    """VDM parameters that the study sets for a model."""
    return {*case.study.vdm_parameters(), *case.study.model_parameters().get(model, {})}


def _what_tells(digest: Digest, states: list[str]) -> str:
    """The swept parameter whose value alone tells the cases within the limits from the others: those not within."""
    for key in digest.swept_keys:
        inside = {c.swept.get(key) for c, s in zip(digest.cases, states, strict=True) if s == WITHIN}
        outside = {c.swept.get(key) for c, s in zip(digest.cases, states, strict=True) if s != WITHIN}
        if not inside or not outside or inside & outside or None in inside | outside:
            continue
        unit = next((case.swept_units.get(key, "1") for case in digest.cases if key in case.swept), "1")
        values = [v for v in dict.fromkeys(case.swept.get(key) for case in digest.cases) if v in outside]
        shown = [swept_value(v, unit) for v in values if v is not None]
        if len(shown) <= _MOST_VALUES:
            return f"{parameter_name(key)} {' or '.join(shown)}"
    return ""


def _reservations(digest: Digest, model: str) -> list[str]:
    """What a model and the reference say of steps that can be used, and what the numbers of the model say of it."""
    found: dict[tuple[str, str], int] = {}
    for case in digest.cases:
        for name in (model, str(case.reference)):
            result = case.models.get(name)
            messages = [s.message for s in result.status if s.ok and s.message] if result is not None else []
            own = reading(case, model) if name == model and result is not None else None
            if own is not None and not own.ok and not failed_steps(case.models[model]):
                messages.append(own.message)
            for message in dict.fromkeys(messages[-2:]):
                found[name, message] = found.get((name, message), 0) + 1
    count = len(digest.cases)
    return [
        f"{name} answers with a reservation{f' in {cases} of {count} cases' if count > 1 else ''}: {message}."
        for (name, message), cases in list(found.items())[:_MOST_VALUES]
    ]


def _scene_doubts(digest: Digest) -> list[str]:
    return [f"The scene is doubtful: {doubt.constraint} {doubt.text}." for doubt in doubts(digest)][
        :_MOST_VALUES
    ]


# --- how sure ---


def _sureness(digest: Digest, error: Spread) -> str:
    if not error.measured:
        return "The reference's own error is not measured. levels = 2 in [uncertainty] measures it."
    text = f"The reference is itself uncertain by {short_percent(error.median_bar)}"
    if digest.unusual_levels:
        many = len(digest.cases) > 1
        named = [f"{n} in {plural(k, 'case')}" if many else n for n, k in digest.unusual_levels.items()]
        text += f", with a wide margin, as its mesh levels are {listed(named)}"
    elif digest.order_is_assumed:
        text += ", if it converges with order 1; levels = 3 shows the order"
    if error.resolved == error.cases:
        return f"{text}. That is at most a tenth of the difference, which counts as resolved."
    if not error.resolved:
        return (
            f"{text}. That is more than a tenth of the difference, whose size is known to that margin only."
        )
    return f"{text}. The difference is resolved in {error.resolved} of {plural(error.cases, 'case')}."


def _gaps(digest: Digest) -> list[str]:
    """What is not in these numbers: models that stopped, cases without a result."""
    run = digest.run
    stopped = [f"{s.name} in {plural(s.failed_cases, 'case')}" for s in digest.summaries if s.failed_cases]
    sentences = [f"No answer at some load or at all: {listed(stopped)}."] if stopped else []
    failed = len(run.failed) - run.damaged
    lost = [f"{plural(failed, 'case')} failed"] if failed else []
    lost += [f"{plural(run.damaged, 'case')} whose file is damaged"] if run.damaged else []
    lost += [f"{plural(len(run.missing), 'case')} not run yet"] if run.missing else []
    if lost:
        sentences.append(f"Not in these numbers: {listed(lost)}. They may be worse than what is here.")
    return sentences
