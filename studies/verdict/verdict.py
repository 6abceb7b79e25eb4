"""The verdicts of a run: one for each family of models, against the study's limits, and which model to take.

Page, terminal, JSON and Python share these objects; `words` puts them into sentences.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from solver_common.arrays import Array
from solver_common.solution import Status

from ..machine import plain
from ..measures import uncertainty
from ..measures.metrics import VECTOR, full_load_step
from ..scene.warnings import meshing_warnings, scene_warnings
from ..study.registry import FINITE_STRAIN, SURFACE, Family, family_of, split
from .acceptance import (
    BEYOND,
    LOST,
    NOT_ASKED,
    NOT_JUDGED,
    OPEN,
    WITHIN,
    WORD,
    Criterion,
    UpTo,
    counted,
    up_to,
    word_of,
)
from .advice import OF_ALL_CASES, Advice, Reason, Shortfall, by_interaction, reasons
from .digest import Digest, Figures, Outside, Unreached, failed_steps, median_known
from .formatting import short_percent
from .reading import reading

_WORST = (BEYOND, OPEN, WITHIN, LOST)  # the case with the first of these states gives the number
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")


@dataclass(frozen=True, kw_only=True)
class Limit(Criterion):
    """A limit, and how a model stands against it over the judged cases.

    Attributes
    ----------
    word : yes, no, undecided or not judged
    value, bar : value of the worst case and its error bar, NaN if not known
    case : the worst case, "" if there is only one case
    counts : number of cases within, undecided, beyond, and without an answer
    """

    word: str
    value: float
    bar: float
    case: str
    counts: dict[str, int]


@dataclass(frozen=True)
class Verdict:
    """The answer for one family.

    Attributes
    ----------
    family : see `vdmbench.study.registry.Family`
    word : yes, no, undecided or not judged: that of the worst judged case
    models : the compared models of the family
    model : the model that decides; the attributes below are about it
    figures : its numbers; None if no model decides
    counts : number of cases within, undecided, beyond, and without an answer
    limits : one entry for each limit
    why_not : the causes, if it is not within the limits in every case
    seen_in : the case that shows the causes; "" in a study of one case, and if all cases show them
    up_to : the load up to which every judged case is within; None if the loads are not known
    states : hash of each case -> its word
    """

    family: str
    word: str = NOT_JUDGED
    models: tuple[str, ...] = ()
    model: str = ""
    figures: Figures | None = None
    counts: dict[str, int] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    why_not: tuple[Reason, ...] = ()
    seen_in: str = ""
    up_to: UpTo | None = None
    states: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Remark:
    """A warning of a model about its own answers, or a doubt about a constraint.

    Attributes
    ----------
    about : the model, or the constraint
    text : the first text of its kind
    cases : in how many cases it came up
    """

    about: str
    text: str
    cases: int


@dataclass(frozen=True)
class Measured:
    """Of how many measured values a model is within the validation uncertainty."""

    model: str
    within: int
    values: int


@dataclass(frozen=True)
class Sureness:
    """How sure the errors are.

    Attributes
    ----------
    bar : error bar of the displacement error, median over the cases; NaN if not measured
    behaviours : behaviour of the reference's mesh levels -> number of cases
    """

    bar: float
    behaviours: dict[str, int]


@dataclass(frozen=True)
class Verdicts(Mapping[str, Verdict]):
    """The verdicts of a run by family, all five in the order of `Family`, and what holds for the whole run.

    Attributes
    ----------
    families : family -> its verdict
    reference : the reference, "" if there is none
    cases : number of cases with a result
    not_judged : why no family is judged: one of the four words below; "" if one is
    outside, unreached : cases outside the reference's range, and cases whose load it did not reach; neither counts
    take : which model to take for each kind of interaction
    reservations : warnings of models and reference about their answers
    doubts : doubts about the scene
    small_strain : whether the reference is a small-strain model
    sure : how sure the errors are; None if there are none
    measured : the reference and the deciding models, against a measurement if there is one
    """

    families: dict[str, Verdict]
    reference: str = ""
    cases: int = 0
    not_judged: str = ""
    outside: tuple[Outside, ...] = ()
    unreached: tuple[Unreached, ...] = ()
    take: tuple[Advice, ...] = ()
    reservations: tuple[Remark, ...] = ()
    doubts: tuple[Remark, ...] = ()
    small_strain: bool = False
    sure: Sureness | None = None
    measured: tuple[Measured, ...] = ()

    def __getitem__(self, family: str) -> Verdict:
        return self.families[family]

    def __iter__(self) -> Iterator[str]:
        return iter(self.families)

    def __len__(self) -> int:
        return len(self.families)

    @property
    def asked(self) -> list[Verdict]:
        """The verdicts of the families with compared models."""
        return [one for one in self.families.values() if one.models]

    def as_data(self) -> dict[str, Any]:
        """Plain data, with None for unknown numbers: `verdicts` by family, the rest in `judgement`."""
        data = {part.name: plain(getattr(self, part.name)) for part in dataclasses.fields(self)}
        return {"verdicts": data.pop("families"), "judgement": data}


@lru_cache(maxsize=1)  # page, terminal and notebook show the same run
@np.errstate(all="ignore")  # the numbers of a model that broke down may overflow
def verdicts(digest: Digest) -> Verdicts:
    """The verdicts of a run."""
    reference, nothing = digest.reference or "", _why_nothing_is_judged(digest)
    inside = digest.in_range
    unjudged = dict.fromkeys((case.hash for case in digest.cases), NOT_JUDGED)
    found = {}
    for family, models in digest.families.items():
        one = Verdict(family.value, models=models, states=unjudged)
        # a model may have answers only in cases that are not judged
        if not nothing and inside.families[family]:
            one = _family(inside, family, unjudged)
        found[family.value] = one
    chosen = [one.model for one in found.values() if one.model]
    return Verdicts(
        families=found,
        reference=reference,
        cases=len(digest.cases),
        not_judged=nothing,
        outside=() if nothing else digest.outside,
        unreached=digest.unreached,
        take=by_interaction(inside) if chosen else (),
        reservations=tuple(_reservations(digest, chosen)),
        doubts=tuple(_doubts(digest)),
        small_strain=bool(reference) and split(reference)[0] not in FINITE_STRAIN,
        sure=_sureness(digest) if nothing in ("", SURFACE_REFERENCE) else None,
        measured=tuple(_measured(digest, chosen)),
    )


NO_CASE, NO_REFERENCE, NO_RESULT = "no case", "no reference", "no result"
SURFACE_REFERENCE = "surface reference"


def _why_nothing_is_judged(digest: Digest) -> str:
    """One of the four words above; "" if the run can be judged."""
    reference = digest.reference
    if not digest.cases:
        return NO_CASE
    if reference is None:
        return NO_REFERENCE
    if all(digest.spread(name, VECTOR) is None for name in digest.compared):
        return NO_RESULT
    return SURFACE_REFERENCE if family_of(reference) in SURFACE else ""


def _family(digest: Digest, family: Family, unjudged: Mapping[str, str]) -> Verdict:
    """The verdict of a family over the cases in range."""
    model = digest.deciding(family)
    states = digest.standing(model)
    judged = {case.hash: WORD[state] for case, state in zip(digest.cases, states.tolist(), strict=True)}
    causes = reasons(digest, model)
    is_seen = len(digest.cases) > 1 and any(reason.cause not in OF_ALL_CASES for reason in causes)
    return Verdict(
        family=family.value,
        word=word_of(states.tolist()),
        models=digest.families[family],
        model=model,
        figures=digest.figures[model],
        counts=counted(states),
        limits=tuple(_limit(digest, model, one) for one in digest.criteria),
        why_not=causes,
        seen_in=digest.case_name(Shortfall(digest, model).case) if is_seen else "",
        up_to=up_to(digest.known_loads, digest.worst_states(model, of_load=True)),
        states={**unjudged, **judged},
    )


def _limit(digest: Digest, model: str, one: Criterion) -> Limit:
    """One limit over all cases, with the numbers of the case that is worst against it."""
    values = digest.full_loads(model, one.metric)
    bars = digest.bars(one.metric) if one.of_load else digest.time_bars(model)
    states = digest.at_full(digest.states(model, one))
    asked = states[states != NOT_ASKED]
    deciding = next((state for state in _WORST if state in asked), None)
    sizes = np.where((states == deciding) & np.isfinite(values), values, -math.inf)
    worst = int(np.argmax(sizes)) if deciding is not None else None
    return Limit(
        **vars(one),
        word=word_of(asked.tolist()),
        value=float(values[worst]) if worst is not None else math.nan,
        bar=float(bars[worst]) if worst is not None else math.nan,
        case=digest.case_name(digest.cases[worst]) if worst is not None and len(states) > 1 else "",
        counts=counted(asked),
    )


# --- what speaks against it ---


def _doubts(digest: Digest) -> Iterator[Remark]:
    """Doubts about the scenes of the key cases: the first one about each constraint."""
    found: dict[str, list[str]] = {}
    for _, case in digest.key_cases:
        study, factor = case.study, float(abs(case.load_factors).max())
        about = study.constraints, study.tissue, case.regions, case.points, case.triangles, factor
        meshed = meshing_warnings(case.mesh_quality, study.acceptance.displacement_error)
        for loc, text in (*scene_warnings(*about), *meshed):
            of_constraint = loc[0] == "constraints"
            name = study.constraints[int(loc[1])].name if of_constraint else ".".join(map(str, loc))
            found.setdefault(name, []).append(text)
    for name, texts in found.items():
        yield Remark(name, texts[0], len(texts))


def _reservations(digest: Digest, models: Sequence[str]) -> Iterator[Remark]:
    """Warnings of models and reference about converged steps, and of `reading` about the models' numbers.

    If `models` is empty, as when nothing is judged, they are those of all models. Each case gives its last two
    messages. Messages that differ in numbers only count as one, and the first is shown. A message about a part of
    the load says which part.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for case in digest.cases:
        for name in dict.fromkeys([*(models or digest.models), str(case.reference)]):
            if (result := case.models.get(name)) is None:
                continue
            if name != case.reference and not result.status[case.full_load].ok:
                continue  # why it stops is told
            told = _of_steps(case.load_factors, result.status)
            own = reading(case, name) if name in models else None
            if own is not None and not own.ok and not failed_steps(result):
                told.append((own.message, ""))
            # the last two messages of a history matter most
            for skeleton, message in {_NUMBER.sub("", m): at + m for m, at in told[-2:]}.items():
                found.setdefault((name, skeleton), []).append(message)
    for (name, _), messages in found.items():
        yield Remark(name, messages[0], len(messages))


def _of_steps(factors: Array, status: Sequence[Status]) -> list[tuple[str, str]]:
    """(message, words before it) of each converged step with a message; the words name a partial load."""
    full = factors[full_load_step(factors)]
    return [
        (
            "; ".join(filter(None, (one.message, one.remedy))),
            "" if abs(factor) == abs(full) else f"at {short_percent(factor / full)} of the load ",
        )
        for one, factor in zip(status, factors, strict=True)
        if one.ok and one.message
    ]


# --- error bars and measurements ---


def _sureness(digest: Digest) -> Sureness:
    estimates = [uncertainty.stored_estimate(case.reference_error) for case in digest.cases]
    names = [one.behaviour for one in estimates if one is not None]
    behaviours = {name: names.count(name) for name in dict.fromkeys(names)}
    return Sureness(median_known(digest.bars(VECTOR)), behaviours)


def _measured(digest: Digest, models: Sequence[str]) -> Iterator[Measured]:
    """`Measured` of the reference and the deciding models; of all models if there are none of these."""
    found = [case.measurement for case in digest.cases if case.measurement is not None]
    names = [name for name in dict.fromkeys((digest.reference or "", *models)) if name] or digest.models
    for name in names:
        own = [one for one in found if name in one.simulated]
        within = [one.within(name)[np.isfinite(one.error(name))] for one in own]
        if values := sum(map(len, within)):
            yield Measured(name, int(sum(map(np.sum, within))), values)
