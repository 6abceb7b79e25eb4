"""What a run says: one verdict a family of models, each held against the study's own limits, then what to take.

Page, terminal, JSON and Python take these objects; `words` puts them in sentences.
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

from ..measures.case import CaseResult
from ..measures.metrics import DEFORMATION, VECTOR
from ..measures.uncertainty import CONVERGING, TWO_LEVELS
from ..scene.warnings import scene_warnings
from ..study.registry import FINITE_STRAIN, PARAMETERS, SURFACE, Family, family_of, split
from .acceptance import (
    BEYOND,
    LOST,
    NOT_ASKED,
    NOT_JUDGED,
    OPEN,
    WITHIN,
    WORD,
    Criterion,
    word_of,
)
from .advice import Advice, NextStep, by_interaction, next_step
from .digest import (
    CONTACT,
    DRIFT,
    HAUSDORFF,
    NORMAL,
    Cost,
    Digest,
    Outside,
    Unreached,
    failed_steps,
)
from .formatting import parameter_name, swept_value
from .growth import Growth, PaperBound, growth_of, paper_bound
from .inputs_known import InputsKnown, inputs_known
from .ladders import reading
from .loading import UpTo, up_to
from .why_not import Reason, reasons

_WORST = (BEYOND, OPEN, WITHIN, LOST)  # which case decides: the first of these that a model has
_MOST_VALUES = 4
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")


@dataclass(frozen=True)
class Limit:
    """One limit of [acceptance] and how a model stands against it over the judged cases.

    Attributes
    ----------
    key, name, region : in the study file, in words, and the region that it is restricted to, "" for none
    word : yes, no, undecided or not judged
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
class Lead:
    """The number that leads: the normal error of a model that moves along normals, else the displacement error.

    Attributes
    ----------
    metric, name : which, and in words
    value, bar, worst, worst_bar : median over the judged cases, largest, and the reference's own part in each
    displacement, deformation : the medians of both errors that are limited
    floor : the least displacement error that a motion along normals leaves, NaN for other models
    contact : median displacement error over the loaded nodes, NaN without a contact
    distance : median Hausdorff distance of the deformed surfaces [m]
    drift, reference_drift : medians of the change of volume, and of the reference's own
    """

    metric: str
    name: str
    value: float
    bar: float
    worst: float
    worst_bar: float
    displacement: float
    deformation: float
    floor: float
    contact: float
    distance: float
    drift: float
    reference_drift: float


@dataclass(frozen=True)
class Setting:
    """A parameter of the model: smallest and largest value over the cases, and whether the study sets it."""

    name: str
    least: float
    most: float
    unit: str
    given: bool


@dataclass(frozen=True)
class Map:
    """The words over two swept parameters: family -> a row for each value of `y` of one word for each of `x`.

    A word is "" where there is no case. Values are in SI units.
    """

    x: str
    y: str
    x_unit: str
    y_unit: str
    x_values: tuple[float | str, ...]
    y_values: tuple[float | str, ...]
    words: dict[str, tuple[tuple[str, ...], ...]]


@dataclass(frozen=True)
class Verdict:
    """The answer for one family.

    Attributes
    ----------
    family : see `vdmbench.study.registry.Family`
    word : yes, no, undecided or not judged: that of the worst judged case
    models : those of the family that are compared
    model, closest : the one that decides, which all below is about; the one with the least error, whatever its time
    lead : the number that leads, None where nothing is known
    judged, within, undecided, beyond, unanswered : cases
    worst : name of the judged case that is furthest off by `lead`, "" where there is one only
    tells : the values of one swept parameter that only cases not within have, "" where none tells them
    limits : one entry a limit
    same : whether it has the reference's own numbers to rounding on the same mesh, which tells nothing of accuracy
    why_not : causes, of what is not within
    advice : what to do with this answer
    cost, settings : of the model
    up_to : the load up to which every judged case is within; None where the loads are not known
    growth : its small-strain limits, where the study searched them
    states : hash of each case -> its word
    """

    family: str
    word: str = NOT_JUDGED
    models: tuple[str, ...] = ()
    model: str = ""
    closest: str = ""
    lead: Lead | None = None
    judged: int = 0
    within: int = 0
    undecided: int = 0
    beyond: int = 0
    unanswered: int = 0
    worst: str = ""
    tells: str = ""
    limits: tuple[Limit, ...] = ()
    same: bool = False
    why_not: tuple[Reason, ...] = ()
    advice: NextStep | None = None
    cost: Cost | None = None
    settings: tuple[Setting, ...] = ()
    up_to: UpTo | None = None
    growth: Growth | None = None
    states: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Reservation:
    """What a model says against its own usable answers: a message with its numbers as they are or as ranges."""

    model: str
    message: str
    cases: int


@dataclass(frozen=True)
class Doubt:
    """A doubt about a constraint of the scene, with the first case that raises it."""

    constraint: str
    case: str
    text: str


@dataclass(frozen=True)
class Measured:
    """How far a model is from a measurement: root mean square over that of the data, by unit, and values within."""

    model: str
    shares: dict[str, float]
    within: int
    values: int


@dataclass(frozen=True)
class Sureness:
    """How sure the figures are: the reference's own error in the displacement error of `model`, and its levels.

    Attributes
    ----------
    bar : median, NaN where not measured
    cases, resolved : with that error, and where the bar is at most a tenth of it
    unusual : behaviour of the mesh levels -> cases, where they give no order
    assumed : whether the order is assumed, of two levels
    """

    model: str
    bar: float
    cases: int
    resolved: int
    unusual: dict[str, int]
    assumed: bool


@dataclass(frozen=True)
class Verdicts(Mapping[str, Verdict]):
    """The answers of a run by family, all five in the order of `Family`, and what holds for the whole run.

    Attributes
    ----------
    families : family -> its verdict
    reference : what all is held against, "" for nothing
    cases, lost : with a result; failed, damaged or not run
    not_judged : why nothing at all is judged: one of the four below, "" where something is
    outside, unreached : cases out of the reference's range, and those whose load it did not reach; not counted
    take : what to take for each kind of interaction
    map : the words over two swept parameters, None where others are swept
    twins : model -> the one that it is in every case, under whose name alone it is told
    reservations, doubts : what models and reference say against the answers; what speaks against the scene
    small_strain : whether the reference is a linear one
    leads : of every model that is compared
    rigid : the rigid share of the reference's displacement where that is most of it, else NaN
    paper : where small strain ends, beside the paper's bound
    sure : how sure the figures are
    stopped, failed, damaged, missing : cases in which each model stops; cases without a result, by why
    measured, measured_cases : how far the models that decide are from a measurement, where there is one
    inputs : what is not known of the inputs, beside the error of the first family's model; None where not told
    """

    families: dict[str, Verdict]
    reference: str = ""
    cases: int = 0
    lost: int = 0
    not_judged: str = ""
    outside: tuple[Outside, ...] = ()
    unreached: tuple[Unreached, ...] = ()
    take: tuple[Advice, ...] = ()
    map: Map | None = None
    twins: dict[str, str] = field(default_factory=dict)
    reservations: tuple[Reservation, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    small_strain: bool = False
    leads: dict[str, Lead] = field(default_factory=dict)
    rigid: float = math.nan
    paper: PaperBound | None = None
    sure: Sureness | None = None
    stopped: dict[str, int] = field(default_factory=dict)
    failed: int = 0
    damaged: int = 0
    missing: int = 0
    measured: tuple[Measured, ...] = ()
    measured_cases: int = 0
    inputs: InputsKnown | None = None

    def __getitem__(self, family: str) -> Verdict:
        return self.families[family]

    def __iter__(self) -> Iterator[str]:
        return iter(self.families)

    def __len__(self) -> int:
        return len(self.families)

    @property
    def asked(self) -> list[Verdict]:
        """Those of the families that the study compares."""
        return [one for one in self.families.values() if one.models]

    def as_data(self) -> dict[str, Any]:
        """As plain data, None where a number is not known: `verdicts` by family, the rest in `judgement`."""
        data: dict[str, Any] = _plain(dataclasses.asdict(self))
        return {"verdicts": data.pop("families"), "judgement": data}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@lru_cache(maxsize=1)  # page, terminal and notebook show one run
def verdicts(digest: Digest) -> Verdicts:
    """What comes out of a run."""
    # overflow is no surprise in what a model that broke down left behind
    with np.errstate(all="ignore"):
        return _verdicts(digest)


def _verdicts(digest: Digest) -> Verdicts:
    reference, nothing = digest.reference or "", _why_nothing_is_judged(digest)
    inside = digest.in_range
    unjudged = dict.fromkeys((case.hash for case in digest.cases), NOT_JUDGED)
    found = {}
    for family, models in digest.families.items():
        one = Verdict(family.value, models=models, states=unjudged)
        # a model may have answers in cases out of range alone
        if not nothing and inside.families[family]:
            one = _family(inside, family, unjudged)
        found[family.value] = one
    chosen = [one.model for one in found.values() if one.model]
    focus, run = digest.focus if digest.focus in digest.compared else "", digest.run
    return Verdicts(
        families=found,
        reference=reference,
        cases=len(digest.cases),
        lost=len(run.failed) + len(run.missing),
        not_judged=nothing,
        outside=() if nothing else digest.outside,
        unreached=digest.unreached,
        take=by_interaction(inside) if chosen else (),
        map=_map(digest, found) if chosen else None,
        twins=digest.twins,
        reservations=tuple(_reservations(digest, chosen)),
        doubts=tuple(_doubts(digest)),
        small_strain=bool(reference) and split(reference)[0] not in FINITE_STRAIN,
        leads={name: lead for name in digest.compared if (lead := _lead(digest, name)) is not None},
        rigid=digest.median(reference, "rigid_share") if digest.mostly_rigid else math.nan,
        paper=paper_bound(digest),
        sure=_sureness(digest, focus) if focus else None,
        stopped=digest.stopped,
        failed=len(run.failed) - run.damaged,
        damaged=run.damaged,
        missing=len(run.missing),
        measured=tuple(_measured(digest, chosen)),
        measured_cases=sum(case.measurement is not None for case in digest.cases),
        inputs=inputs_known(digest, focus or ""),
    )


NO_CASE, NO_REFERENCE, NO_RESULT, SURFACE_REFERENCE = (
    "no case",
    "no reference",
    "no result",
    "surface reference",
)


def _why_nothing_is_judged(digest: Digest) -> str:
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
    models, model = digest.families[family], digest.deciding(family)
    states = [digest.limits.state(case, model) for case in digest.cases]
    word, why = word_of(states), reasons(digest, model)
    lead = _lead(digest, model)
    sizes = digest.full_loads(model, lead.metric) if lead is not None else np.zeros(len(digest.cases))
    worst = digest.cases[int(np.argmax(np.nan_to_num(sizes, nan=-1.0)))]
    judged = {case.hash: WORD[state] for case, state in zip(digest.cases, states, strict=True)}
    return Verdict(
        family=family.value,
        word=word,
        models=models,
        model=model,
        closest=min(models, key=lambda name: digest.limits.usual_share(digest.cases, name)),
        lead=lead,
        judged=len(states),
        within=states.count(WITHIN),
        undecided=states.count(OPEN),
        beyond=states.count(BEYOND),
        unanswered=states.count(LOST),
        worst=digest.case_name(worst) if len(unjudged) > 1 else "",
        tells=_what_tells(digest, states),
        limits=tuple(_limit(digest, model, criterion) for criterion in digest.limits.criteria),
        same=digest.same_as_reference(model),
        why_not=why,
        advice=next_step(digest, model, word, why),
        cost=digest.costs[model],
        settings=tuple(_settings(digest, model)),
        up_to=up_to(
            digest.known_loads, [digest.limits.states(case, model, of_load=True) for case in digest.cases]
        ),
        growth=growth_of(digest, model),
        states={**unjudged, **judged},
    )


def _lead(digest: Digest, model: str) -> Lead | None:
    vector, shape = digest.spread(model, VECTOR), digest.spread(model, DEFORMATION)
    if vector is None:
        return None
    metric = digest.leading(model)
    found = digest.spread(model, metric) or vector
    return Lead(
        metric=metric,
        name="normal error" if metric == NORMAL else "displacement error",
        value=found.median,
        bar=found.median_bar,
        worst=found.worst,
        worst_bar=found.worst_bar,
        displacement=vector.median,
        deformation=shape.median if shape is not None else math.nan,
        floor=digest.floor(model),
        contact=digest.median(model, CONTACT),
        distance=digest.median(model, HAUSDORFF),
        drift=digest.median(model, DRIFT),
        reference_drift=digest.median(str(digest.reference), DRIFT),
    )


def _map(digest: Digest, found: Mapping[str, Verdict]) -> Map | None:
    """The words over two swept parameters; None where there are more or fewer."""
    if len(digest.swept_keys) != 2:
        return None
    x, y = digest.swept_keys
    ordered = {
        key: tuple(sorted({case.swept[key] for case in digest.cases if key in case.swept}, key=_in_order))
        for key in (x, y)
    }
    place = {(case.swept.get(x), case.swept.get(y)): case.hash for case in digest.cases}
    words = {
        family: tuple(
            tuple(one.states.get(place.get((a, b), ""), "") for a in ordered[x]) for b in ordered[y]
        )
        for family, one in found.items()
        if one.models
    }
    units = [next((c.swept_units[k] for c in digest.cases if k in c.swept_units), "1") for k in (x, y)]
    return Map(x, y, units[0], units[1], ordered[x], ordered[y], words)


def _in_order(value: float | str) -> tuple[bool, float, str]:
    return (True, 0.0, value) if isinstance(value, str) else (False, float(value), "")


# --- a model over its cases ---


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
        word=word_of(states),
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


def _what_tells(digest: Digest, states: list[int]) -> str:
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


# --- what speaks against it ---


def _doubts(digest: Digest) -> Iterator[Doubt]:
    """What is doubtful about the scenes that were computed: each constraint's, of several cases the first."""
    seen: set[tuple[str | int, ...]] = set()
    same: dict[object, None] = {}
    for case in digest.cases:
        factor = float(abs(case.load_factors).max())
        constraints, tissue = case.study.constraints, case.study.tissue
        surface = digest.surfaces[case.hash]
        # cases that differ in nothing that is looked at raise the same doubts
        key = (id(surface), factor, repr(constraints), repr(tissue), *map(bytes, case.regions.values()))
        if key in same:
            continue
        same[key] = None
        for loc, text in scene_warnings(
            constraints, tissue, case.regions, case.points, case.triangles, factor
        ):
            if loc not in seen:
                seen.add(loc)
                name = constraints[int(loc[1])].name if loc[0] == "constraints" else ".".join(map(str, loc))
                yield Doubt(name, digest.case_name(case), text)


def _reservations(digest: Digest, models: Sequence[str]) -> Iterator[Reservation]:
    """What models and reference say of steps that can be used, and what the numbers of the models say of it.

    Messages of one model that differ in a number are one, with its range.
    """
    found: dict[tuple[str, str], list[tuple[str, ...]]] = {}
    for case in digest.cases:
        for name in dict.fromkeys([*models, str(case.reference)]):
            if (result := case.models.get(name)) is None:
                continue
            messages = [s.message for s in result.status if s.ok and s.message]
            own = reading(case, name) if name in models else None
            if own is not None and not own.ok and not failed_steps(result):
                messages.append(own.message)
            # of a history the last two say most; one that repeats itself with another number says it once
            latest = {_NUMBER.sub("\0", message): message for message in messages[-2:]}
            for skeleton, message in latest.items():
                found.setdefault((name, skeleton), []).append(tuple(_NUMBER.findall(message)))
    for (name, skeleton), numbers in found.items():
        yield Reservation(name, _with_ranges(skeleton, numbers), len(numbers))


def _with_ranges(skeleton: str, numbers: Sequence[tuple[str, ...]]) -> str:
    """A message with each of its numbers as it is, or as the range of those that were said."""
    shown = []
    for values in zip(*numbers, strict=True):
        low, high = min(values, key=float), max(values, key=float)
        shown.append(low if float(low) == float(high) else f"{low} to {high}")
    texts = skeleton.split("\0")
    return "".join(text + number for text, number in zip(texts, [*shown, ""], strict=True))


# --- how sure, and what was measured ---


def _sureness(digest: Digest, model: str) -> Sureness | None:
    spread = digest.spread(model, VECTOR)
    if spread is None:
        return None
    bar = spread.median_bar if spread.measured else math.nan
    names, usual = digest.behaviours, (CONVERGING, TWO_LEVELS)
    unusual = {name: names.count(name) for name in dict.fromkeys(names) if name not in usual}
    return Sureness(model, bar, spread.cases, spread.resolved, unusual, set(names) == {TWO_LEVELS})


def _measured(digest: Digest, models: Sequence[str]) -> Iterator[Measured]:
    """Of the reference and of models that decide in a family; where there is none of them, of all."""
    cases = [case for case in digest.cases if case.measurement is not None]
    names = [name for name in dict.fromkeys((digest.reference or "", *models)) if name] or digest.models
    for name in names:
        parts: dict[str, list[tuple[float, float]]] = {}  # unit -> (E, D)
        within = count = 0
        for found in (case.measurement for case in cases):
            if found is None or name not in found.simulated:
                continue
            for one, error, inside in zip(
                found.quantities, found.error(name), found.within(name), strict=True
            ):
                if np.isfinite(error):
                    within, count = within + int(inside), count + 1
                    if one.value:  # distances of a whole surface have no size of their own
                        parts.setdefault(one.unit, []).append((float(error), one.value))
        if parts:
            norms = {unit: np.linalg.norm(np.array(pairs), axis=0) for unit, pairs in parts.items()}
            yield Measured(
                name, {u: float(error / size) for u, (error, size) in norms.items()}, within, count
            )
