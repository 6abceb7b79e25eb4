"""A run with the selections from its frame that verdict, page and terminal share: families, key cases, spreads."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import chain
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array, Index

from ..body.surface_measures import Surface
from ..machine import processor_name
from ..measures.case import CaseResult, Run
from ..measures.frame import frame
from ..measures.metrics import DEFORMATION, VECTOR
from ..measures.uncertainty import reference_bar
from ..scene.result import ModelResult
from ..scene.warnings import MOST_DRIFT, MOST_MOVED, motion_share
from ..study.registry import FINITE_STRAIN, REFINED, Family, family_of, split
from ..study.schema import has_weight
from . import palette
from .acceptance import (
    LOST,
    NOT_ASKED,
    WITHIN,
    WORDS,
    Criterion,
    KnownLoads,
    States,
    criteria,
    known_loads,
    states_of,
    supports,
    time_state,
    word_of,
)

if TYPE_CHECKING:
    from pandas import DataFrame

Number = TypeVar("Number", bound=np.generic)

# place of the reference in the palette; `palette.places` has the others
REFERENCE = -1
SAME_NUMBERS = 1e-6  # relative error below which two models solve the same system
ALONG_NORMALS = 1e-9  # tangential share of the motion, below which a model moves nodes along normals only
NORMAL, CONTACT, HAUSDORFF = "relative_l2_normal_error", "contact_region_error", "hausdorff_distance"
DRIFT = "volume_drift"
# remarks beside a time
ELSEWHERE, ONCE = "another machine", "one answer"


def failed_steps(model: ModelResult) -> list[int]:
    """The steps that failed."""
    return [step for step, status in enumerate(model.status) if not status.ok]


def first_failed(case: CaseResult, model: str) -> list[int]:
    """The first failed step with a load of the study, else the first failed step; [] if none failed.

    Steps with other loads exist where another model stopped.
    """
    failed, own = failed_steps(case.models[model]), case.study.load.history
    return [step for step in failed if case.load_factors[step] in own][:1] or failed[:1]


@dataclass(frozen=True)
class Spread:
    """A measure over the cases that have it: median and worst, each with the error bar of the reference."""

    value: float
    bar: float = math.nan
    worst: float = math.nan
    worst_bar: float = math.nan
    cases: int = 0


def spread_of(values: Array, bars: Array) -> Spread | None:
    """Spread of the finite ones of (C,) values with (C,) error bars; None if there are none."""
    kept = np.isfinite(values)
    if not kept.any():
        return None
    values, bars = values[kept], bars[kept]
    worst = int(np.argmax(np.abs(values)))
    return Spread(
        float(np.median(values)), median_known(bars), float(values[worst]), float(bars[worst]), len(values)
    )


@dataclass(frozen=True)
class Figures:
    """The numbers of a model, medians over the cases; NaN if not known.

    Attributes
    ----------
    lead, value, bar : name of the leading error, its value and its error bar. It is the displacement error, or the
        normal error of a model that moves along normals
    displacement, deformation : displacement error, and error in change of shape [1]
    displacement_bar, deformation_bar : their error bars [1]
    frame, everywhere : time of a frame of the contact, and with all nodes loaded, over meshes and rounds [s]. If
        none was measured, `frame` is the time of a load step
    set_up : time of the set-up [s]
    memory : largest peak memory over the cases [B]
    marks : remarks beside the times, ELSEWHERE and ONCE
    same : whether it has the reference's answers on the same mesh, so that its errors are rounding
    within, cases : number of cases within all limits, and of all cases
    """

    model: str
    lead: str = ""
    value: float = math.nan
    bar: float = math.nan
    displacement: float = math.nan
    displacement_bar: float = math.nan
    deformation: float = math.nan
    deformation_bar: float = math.nan
    frame: float = math.nan
    everywhere: float = math.nan
    set_up: float = math.nan
    memory: float = math.nan
    marks: tuple[str, ...] = ()
    same: bool = False
    within: int = 0
    cases: int = 0

    @property
    def anywhere(self) -> float:
        """Time of a frame with all nodes loaded if that was measured, else of a frame of the contact [s]."""
        return self.everywhere if math.isfinite(self.everywhere) else self.frame


@dataclass(frozen=True)
class Outside:
    """A case with a load outside the range of a small-strain reference."""

    case: str  # its hash
    name: str
    moved: float  # displacement over the body's smallest extent
    drift: float  # volume drift over the volume
    weight: bool  # whether the weight acts, which a lower load does not reduce


@dataclass(frozen=True)
class Unreached:
    """A case whose reference ended before the full load."""

    case: str  # its hash
    name: str
    share: float  # of the full load, as far as the reference came
    why: str


@dataclass(frozen=True)
class Digest:
    """A run and quantities derived from it. It has C cases; the longest load history has S steps."""

    run: Run

    @cached_property
    def cases(self) -> Sequence[CaseResult]:
        """The finished cases."""
        return self.run.cases

    @cached_property
    def place(self) -> dict[str, int]:
        """Hash of each case -> its index."""
        return {case.hash: k for k, case in enumerate(self.cases)}

    @cached_property
    def table(self) -> DataFrame:
        """The frame of the run; see `vdmbench.measures.frame`."""
        return frame(self.run)

    @property
    def _shape(self) -> tuple[int, int]:
        return len(self.cases), max((len(case.load_factors) for case in self.cases), default=0)

    @cached_property
    def _histories(self) -> dict[tuple[str, str], tuple[Array, Array]]:
        """(model, metric) -> (C, S) values and (C,) error bars at full load, NaN if there are none."""
        table, found = self.table, {}
        number, step = table["case"].map(self.place).to_numpy(dtype=int), table["step"].to_numpy(dtype=int)
        value, bar, full = (table[key].to_numpy() for key in ("value", "bar", "full_load"))
        shape = self._shape
        for key, rows in table.groupby(["model", "metric"], sort=False, observed=True).indices.items():
            found[key] = np.full(shape, math.nan), np.full(shape[0], math.nan)
            found[key][0][number[rows], step[rows]] = value[rows]
            rows = rows[full[rows]]
            found[key][1][number[rows]] = bar[rows]
        return found

    def history(self, model: str, metric: str) -> Array:
        """(C, S) a metric at every case and step, NaN if there is none."""
        if (model, metric) in self._histories:
            return self._histories[model, metric][0]
        return np.full(self._shape, math.nan)

    @cached_property
    def full(self) -> Index:
        """(C,) the step of the largest load of each case."""
        return np.array([case.full_load for case in self.cases], dtype=int)

    def full_loads(self, model: str, metric: str) -> Array:
        """(C,) a metric of every case at the step of the largest load, NaN if there is none."""
        return self.history(model, metric)[np.arange(len(self.cases)), self.full]

    def at(self, case: CaseResult, model: str, metric: str) -> float:
        """A metric of a case at the step of its largest load, NaN if there is none."""
        return float(self.full_loads(model, metric)[self.place[case.hash]])

    def bars(self, metric: str) -> Array:
        """(C,) error bar of the reference in a metric of every case, NaN if there is none."""
        return np.array([reference_bar(case.reference_error, metric) for case in self.cases], dtype=float)

    def time_bars(self, model: str) -> Array:
        """(C,) what a busy machine added at most to a model's time of a frame [s], NaN where not measured."""
        results = [case.models.get(model) for case in self.cases]
        return np.array([r.frame_time - r.frame_worked if r is not None else math.nan for r in results])

    def spread(self, model: str, metric: str) -> Spread | None:
        """Spread of a model's metric at full load over all cases; None if no case has it."""
        if (model, metric) not in self._histories:
            return None
        return spread_of(self.full_loads(model, metric), self._histories[model, metric][1])

    def median(self, model: str, metric: str) -> float:
        """Median of a model's metric at full load over the cases that have it; NaN if none has."""
        return median_known(self.full_loads(model, metric))

    # --- models ---

    @cached_property
    def models(self) -> tuple[str, ...]:
        """All models by family, in the order of the study; the reference comes last."""
        asked = [str(name) for name in self.run.study.study.models]
        names = dict.fromkeys([*asked, *(name for case in self.cases for name in case.models)])
        order = list(Family)
        return tuple(sorted(names, key=lambda name: (name == self.reference, order.index(family_of(name)))))

    @cached_property
    def reference(self) -> str | None:
        """The reference of the finished cases, else the study's."""
        found = next((case.reference for case in self.cases if case.reference), None)
        return found or self.run.study.study.reference

    @cached_property
    def compared(self) -> tuple[str, ...]:
        """The models with an error against the reference."""
        return tuple(
            name for name in self.models if name != self.reference and (name, VECTOR) in self._histories
        )

    @cached_property
    def coarse_reference(self) -> str | None:
        """The reference's model on the case's own mesh, if the reference is on a refined mesh; else None."""
        asked = self.run.study.study.reference
        return asked if asked != self.reference and asked in self.compared else None

    @cached_property
    def families(self) -> dict[Family, tuple[str, ...]]:
        """The compared models of each family."""
        return {
            family: tuple(name for name in self.compared if family_of(name) is family) for family in Family
        }

    def same_as_reference(self, model: str) -> bool:
        """Whether a model has the reference's answers to rounding, with the reference on the same mesh."""
        spread = None if str(self.reference).endswith(REFINED) else self.spread(model, VECTOR)
        return spread is not None and spread.worst < SAME_NUMBERS

    def floor(self, model: str) -> float:
        """Least displacement error of models that move nodes along normals: that of the reference's normal part.

        NaN for models that move nodes freely.
        """
        share = self.spread(model, "tangential_share")
        if self.reference is None or share is None or not share.worst < ALONG_NORMALS:
            return math.nan
        return self.median(self.reference, "tangential_share")

    def leading(self, model: str) -> str:
        """The leading metric: the normal error of a model that moves along normals, else the displacement error."""
        return NORMAL if math.isfinite(self.floor(model)) else VECTOR

    # --- against the limits of the study ---

    @cached_property
    def criteria(self) -> tuple[Criterion, ...]:
        """The limits of the study."""
        return criteria(self.run.study)

    def allowed(self, metric: str) -> float:
        """The study's limit of a metric, NaN if there is none."""
        return next((one.allowed for one in self.criteria if one.metric == metric), math.nan)

    def states(self, model: str, one: Criterion) -> States:
        """(C, S) how a model stands against a limit at each step.

        If the reference moves as a rigid body, the error in change of shape is undefined, and its state NOT_ASKED.
        """
        values, answered = self.history(model, one.metric), np.isfinite(self.history(model, VECTOR))
        if not one.of_load:
            times = np.array([time_state(case.models.get(model), one.allowed) for case in self.cases])
            return np.where(answered, times[:, None], LOST).astype(np.int8)
        found = states_of(values, self.bars(one.metric)[:, None], one.allowed)
        if one.metric == DEFORMATION:
            found[~np.isfinite(values) & answered] = NOT_ASKED
        return found

    def worst_states(self, model: str, *, of_load: bool = False) -> States:
        """(C, S) the worst state over the limits; `of_load` leaves out limits that do not depend on the load."""
        chosen = [one for one in self.criteria if one.of_load or not of_load]
        return np.asarray(np.max([self.states(model, one) for one in chosen], axis=0))

    def at_full(self, values: NDArray[Number]) -> NDArray[Number]:
        """(C,) the values at full load, of (C, S)."""
        return values[np.arange(len(self.cases)), self.full]

    @cached_property
    def _standings(self) -> dict[str, tuple[States, Array]]:
        """Compared model -> (C,) worst state and (C,) largest error over its limit, at full load."""
        found = {}
        for name in self.compared:
            shares = [self.full_loads(name, c.metric) / c.allowed for c in self.criteria if c.of_load]
            share = np.where(np.isfinite(shares[0]), np.fmax.reduce(shares), math.inf)
            found[name] = self.at_full(self.worst_states(name)), share
        return found

    def standing(self, model: str) -> States:
        """(C,) worst state of a compared model at full load."""
        return self._standings[model][0]

    def shares(self, model: str) -> Array:
        """(C,) largest error over its limit at full load, without the limit of time; infinite without an answer."""
        return self._standings[model][1]

    def usual_share(self, model: str) -> float:
        """Median of `shares`; infinite if most cases have no answer."""
        return float(np.median(self.shares(model))) if self.cases else math.inf

    def deciding(self, family: Family) -> str:
        """The model that decides for a family: the one with the best word, then with the least median error.

        A word counts time, an error does not. Ties, also of models without an answer in most cases, go to the
        model with the most answers. So a further model never makes the word of its family worse.
        """

        def rank(model: str) -> tuple[float, ...]:
            known = self.shares(model)[np.isfinite(self.shares(model))]
            usual = float(np.median(known)) if len(known) else math.inf
            return WORDS.index(word_of(self.standing(model))), self.usual_share(model), -len(known), usual

        return min(self.families[family], key=rank)

    # --- cases ---

    @cached_property
    def surfaces(self) -> dict[str, Surface]:
        """Hash of each case -> its undeformed surface; cases on the same mesh share one."""
        shared: dict[tuple[bytes, bytes], Surface] = {}
        return {
            case.hash: shared.setdefault(
                (case.points.tobytes(), case.triangles.tobytes()), Surface(case.points, case.triangles)
            )
            for case in self.cases
        }

    @cached_property
    def known_loads(self) -> KnownLoads:
        """The loads of all steps of all cases."""
        return known_loads(self.cases, [self.surfaces[case.hash] for case in self.cases])

    @cached_property
    def outside(self) -> tuple[Outside, ...]:
        """The cases outside the range of a small-strain reference."""
        if self.reference is None or split(self.reference)[0] in FINITE_STRAIN:
            return ()
        found = []
        for case in self.cases:
            if (result := case.models.get(str(case.reference))) is None:
                continue
            extent = self.surfaces[case.hash].smallest_extent
            moved = motion_share(result.displacement[case.full_load], supports(case), extent)
            drift = abs(self.at(case, str(case.reference), DRIFT))
            if moved > MOST_MOVED or drift > MOST_DRIFT:
                weight = has_weight(case.study)
                found.append(Outside(case.hash, self.case_name(case), moved, drift, weight))
        return tuple(found)

    @cached_property
    def unreached(self) -> tuple[Unreached, ...]:
        """The cases whose reference did not reach the full load."""
        found = []
        for case in self.cases:
            if case.reached != case.full_load:
                reached = case.load_factors[case.reached] if case.reached >= 0 else 0.0
                share = abs(float(reached / case.load_factors[case.full_load]))
                why = case.models[str(case.reference)].status[case.full_load].message
                found.append(Unreached(case.hash, self.case_name(case), share, why))
        return tuple(found)

    @cached_property
    def unanswered(self) -> int:
        """Number of cases in which no model has an answer at full load."""
        return sum(
            not any(model.status[case.full_load].ok for model in case.models.values()) for case in self.cases
        )

    @cached_property
    def in_range(self) -> Digest:
        """The digest of the cases that can be judged; itself if all can."""
        beyond = {one.case for one in self.outside} | {one.case for one in self.unreached}
        if not beyond:
            return self
        return Digest(replace(self.run, cases=[case for case in self.cases if case.hash not in beyond]))

    def stopped(self, model: str) -> int:
        """Number of cases in which a step of a model failed."""
        return sum(bool(failed_steps(case.models[model])) for case in self.cases if model in case.models)

    @cached_property
    def swept_keys(self) -> list[str]:
        """The swept parameters with more than one value."""
        keys = dict.fromkeys(key for case in self.cases for key in case.swept)
        return [key for key in keys if len({case.swept.get(key) for case in self.cases}) > 1]

    def unit(self, key: str) -> str:
        """The SI unit of a swept parameter."""
        return next((case.swept_units.get(key, "1") for case in self.cases if key in case.swept), "1")

    @cached_property
    def focus(self) -> str | None:
        """The model that the page shows in detail: the deciding one of the first family that has an answer."""
        digest = self.in_range if self.in_range.compared else self
        deciding = [digest.deciding(family) for family, models in digest.families.items() if models]
        answering = (name for name in deciding if np.isfinite(digest.shares(name)).any())
        others = [*deciding, *(name for name in self.models if name != self.reference)]
        moving = (name for name in others if any(math.isfinite(_largest(case, name)) for case in self.cases))
        return next(chain(answering, moving, others, self.models), None)

    @cached_property
    def key_cases(self) -> list[tuple[str, CaseResult]]:
        """(role, case) of the worst, the median and the best case of the focus model, without repeats.

        Without a reference they are those with the largest, median and smallest displacement.
        """
        if len(self.cases) < 2:
            return [("", case) for case in self.cases]
        by_error = bool(self.compared)
        if by_error:
            sizes = np.abs(self.full_loads(str(self.focus), VECTOR))
        else:
            sizes = np.array([_largest(case, self.focus) for case in self.cases])
        finite = np.isfinite(sizes)
        order = np.argsort(np.where(finite, -sizes, math.inf), kind="stable").tolist()
        finite_only = order[: int(finite.sum())] or order
        roles = ("worst", "median", "best") if by_error else ("largest", "median", "smallest")
        middle = [] if len(finite_only) == 2 else [(roles[1], finite_only[len(finite_only) // 2])]
        seen: dict[int, str] = {}
        for role, k in [(roles[0], finite_only[0]), *middle, (roles[2], finite_only[-1])]:
            seen.setdefault(k, role)
        return [(role, self.cases[k]) for k, role in seen.items()]

    # --- names and looks ---

    def case_name(self, case: CaseResult) -> str:
        """The name of a case on the page."""
        if case.label:
            return case.label
        return "the only case" if len(self.cases) == 1 else f"case {case.hash[:8]}"

    def title(self, role: str, case: CaseResult) -> str:
        """The name of a key case with its role."""
        return f"{role.capitalize()}: {self.case_name(case)}" if role else self.case_name(case)

    @cached_property
    def _places(self) -> dict[str, int]:
        return palette.places(name for name in self.models if name != self.reference)

    def colour(self, model: str) -> int:
        """The model's place in the palette."""
        return REFERENCE if model == self.reference else self._places[model]

    def mark(self, name: str) -> int | None:
        """The place of a model in the palette; None if the run has no such model."""
        return self.colour(name) if name in self.models else None

    # --- numbers ---

    @cached_property
    def figures(self) -> dict[str, Figures]:
        """Model -> its `Figures`."""
        return {name: self._figures(name) for name in self.models}

    def _figures(self, name: str) -> Figures:
        results = [case.models[name] for case in self.cases if name in case.models]
        frames = [result.frames for result in results if result.frames is not None]
        answered = [r for r in results if any(status.ok for status in r.status)]
        lead, moved, bent = (
            self.spread(name, metric) or Spread(math.nan)
            for metric in (self.leading(name), VECTOR, DEFORMATION)
        )
        return Figures(
            model=name,
            lead="normal error" if self.leading(name) == NORMAL else "displacement error",
            value=lead.value,
            bar=lead.bar,
            displacement=moved.value,
            displacement_bar=moved.bar,
            deformation=bent.value,
            deformation_bar=bent.bar,
            frame=frame_of(results),
            everywhere=median_known(*(f.everywhere for f in frames)),
            set_up=median_known(
                *([f.setup for f in frames] or [np.array([r.seconds_setup]) for r in results])
            ),
            memory=float(max((r.peak_bytes for r in answered), default=math.nan)),
            marks=self._marks(name),
            same=name == self.reference or self.same_as_reference(name),
            within=int((self.standing(name) == WITHIN).sum()) if name in self.compared else 0,
            cases=len(self.cases),
        )

    def _marks(self, name: str) -> tuple[str, ...]:
        """Remarks about a model's times; none if all were measured on this machine, in turns with the others."""
        found, here = set(), ("", processor_name())
        for case in (case for case in self.cases if name in case.models):
            frames = case.models[name].frames
            machine = frames.processor if frames is not None else case.provenance.get("processor", "")
            found |= {ONCE} if frames is None else set()
            found |= {ELSEWHERE} if machine not in here else set()
        return tuple(mark for mark in (ELSEWHERE, ONCE) if mark in found)


def _largest(case: CaseResult, model: str | None) -> float:
    """Largest displacement of a model at full load [m], NaN if there is none."""
    result = case.models.get(str(model))
    if result is None:
        return math.nan
    return float(np.linalg.norm(result.displacement[case.full_load], axis=1).max())


def frame_of(results: Sequence[ModelResult]) -> float:
    """Median seconds of a frame of the contact over meshes and rounds; of the load steps if none was measured."""
    frames = [result.frames.contact for result in results if result.frames is not None]
    return median_known(*(frames or [result.seconds_per_step for result in results]))


def median_known(*parts: Array) -> float:
    """Median of the finite numbers in some arrays, NaN if there are none."""
    values = np.concatenate([np.zeros(0), *parts])
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


digest_of = lru_cache(maxsize=1)(Digest)  # page, terminal and notebook show the same run
