"""A run and the selections of its frame that verdict, page and terminal share: families, key cases, spreads."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from solver_common.arrays import Array

from ..body.surface_measures import Surface
from ..machine import processor_name
from ..measures import uncertainty
from ..measures.bars import reference_bar
from ..measures.case import CaseResult, Run
from ..measures.frame import at_full_load, frame
from ..measures.metrics import DEFORMATION, VECTOR
from ..scene.result import ModelResult
from ..scene.warnings import MOST_DRIFT, MOST_MOVED, motion_share
from ..study.registry import FINITE_STRAIN, REFINED, Family, family_of, split
from . import palette
from .acceptance import Acceptance, acceptance
from .loading import KnownLoads, known_loads, supports

if TYPE_CHECKING:
    from pandas import DataFrame

# place of the reference in the palette; see `palette.places` for the others
REFERENCE = -1
SAME_NUMBERS = 1e-6  # of the displacement: less is rounding between two ways to solve one system
ALONG_NORMALS = 1e-9  # of its motion that a model of the normal component has in the surface
NORMAL, CONTACT, HAUSDORFF = "relative_l2_normal_error", "contact_region_error", "hausdorff_distance"
DRIFT = "volume_drift"
SPARSE, WHOLE = "bem-sparse", "bem"
# what stands beside a time
EARLIER, ELSEWHERE, ONCE = "earlier run", "another machine", "one answer"


def failed_steps(model: ModelResult) -> list[int]:
    """Steps that cannot be used."""
    return [step for step, status in enumerate(model.status) if not status.ok]


def _has_answer(model: ModelResult) -> bool:
    return any(status.ok for status in model.status)


@dataclass(frozen=True)
class Spread:
    """A measure over the cases that have it, each value with the reference's own error in that case."""

    median: float
    median_bar: float
    worst: float
    worst_bar: float
    best: float
    cases: int
    measured: int  # cases whose reference error is known
    resolved: int  # of these, cases in which it is small enough

    @property
    def verdict(self) -> str:
        """ "resolved", "unresolved", "partly resolved" or "not measured"."""
        if not self.measured:
            return "not measured"
        if self.resolved == self.cases:
            return "resolved"
        return f"resolved in {self.resolved} of {self.cases}" if self.resolved else "unresolved"


def spread_of(values: Array, bars: Array) -> Spread | None:
    """Spread of (C,) values, each with the reference's error; without those not finite, None if none is left."""
    kept = np.isfinite(values)
    if not kept.any():
        return None
    values, bars = values[kept], bars[kept]
    sizes = np.abs(values)
    worst = int(np.argmax(sizes))
    known = np.isfinite(bars)
    return Spread(
        median=float(np.median(values)),
        median_bar=float(np.median(bars[known])) if known.any() else math.nan,
        worst=float(values[worst]),
        worst_bar=float(bars[worst]),
        best=float(values[np.argmin(sizes)]),
        cases=len(values),
        measured=int(known.sum()),
        resolved=sum(map(uncertainty.is_resolved, values.tolist(), bars.tolist())),
    )


@dataclass(frozen=True)
class Cost:
    """What a model takes: medians over cases and steps [s], the most memory [B], what stands beside the times.

    `frame` is of the contact, over meshes and rounds; without measured frames over steps. `marks` are EARLIER,
    ELSEWHERE, ONCE; `iterative` tells whether an iterative solver was chosen in any case.
    """

    model: str
    set_up: float
    frame: float
    memory: float
    iterative: bool
    marks: tuple[str, ...]


@dataclass(frozen=True)
class Outside:
    """A case whose load a small-strain reference cannot judge: shares of the body's smallest extent and volume."""

    case: str
    name: str
    moved: float
    drift: float


@dataclass(frozen=True)
class Unreached:
    """A case whose reference ended before the full load: the share that it reached, and why it ended."""

    case: str
    name: str
    share: float
    why: str


@dataclass(frozen=True)
class Digest:
    """A run with what follows from it."""

    run: Run

    @cached_property
    def cases(self) -> Sequence[CaseResult]:
        """The finished cases."""
        return self.run.cases

    @cached_property
    def table(self) -> DataFrame:
        """The frame of the run; see `vdmbench.measures.frame`."""
        return frame(self.run)

    @cached_property
    def _columns(self) -> dict[tuple[str, str], tuple[Array, Array]]:
        """(model, metric) -> (C,) values of the cases at full load and (C,) their bars; NaN where there is none."""
        full, count = at_full_load(self.table), len(self.cases)
        place, found = self.place, {}
        for key, rows in full.groupby(["model", "metric"], sort=False, observed=True):
            at = rows["case"].map(place).to_numpy()
            found[key] = np.full(count, math.nan), np.full(count, math.nan)
            for column, name in zip(found[key], ("value", "bar"), strict=True):
                column[at] = rows[name]
        return found

    @cached_property
    def limits(self) -> Acceptance:
        """How far off a model may be."""
        return acceptance(self.run.study)

    def allowed(self, metric: str) -> float:
        """What the study accepts of a metric; NaN where it limits another."""
        vector, deformation = self.limits.criteria[:2]
        return {VECTOR: vector.allowed, DEFORMATION: deformation.allowed}.get(metric, math.nan)

    @cached_property
    def surfaces(self) -> dict[str, Surface]:
        """Hash of each case -> its undeformed surface; cases on the same mesh share one, measured once."""
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
        return known_loads(self.cases, {key: surface.normals for key, surface in self.surfaces.items()})

    @cached_property
    def models(self) -> tuple[str, ...]:
        """All models by family, the reference last; in one as the study orders them."""
        asked = [str(name) for name in self.run.study.study.models]
        names = dict.fromkeys([*asked, *(name for case in self.cases for name in case.models)])
        told, order = (name for name in names if name not in self.twins), list(Family)
        return tuple(sorted(told, key=lambda name: (name == self.reference, order.index(family_of(name)))))

    @cached_property
    def twins(self) -> dict[str, str]:
        """Model -> the one that it is in every case, and is left out for: bem-sparse is bem on few nodes."""
        found = {}
        for name in {name for case in self.cases for name in case.models if split(name)[0] == SPARSE}:
            twin = name.replace(SPARSE, WHOLE)
            cases = [case for case in self.cases if name in case.models]
            if name != self.reference and all(
                twin in case.models and _is_whole(case, name) for case in cases
            ):
                found[name] = twin
        return found

    @cached_property
    def reference(self) -> str | None:
        """The reference of the finished cases, else the study's."""
        found = next((case.reference for case in self.cases if case.reference), None)
        return found or self.run.study.study.reference

    @cached_property
    def compared(self) -> tuple[str, ...]:
        """The models that are measured against the reference."""
        return tuple(
            name for name in self.models if name != self.reference and (name, VECTOR) in self._columns
        )

    @cached_property
    def coarse_reference(self) -> str | None:
        """The reference's own model on the case's mesh, where the cases were held against it on a refined one."""
        asked = self.run.study.study.reference
        return asked if asked != self.reference and asked in self.compared else None

    @cached_property
    def families(self) -> dict[Family, tuple[str, ...]]:
        """The compared models of each family."""
        return {
            family: tuple(name for name in self.compared if family_of(name) is family) for family in Family
        }

    @cached_property
    def outside(self) -> tuple[Outside, ...]:
        """The cases out of the reference's range."""
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
                found.append(Outside(case.hash, self.case_name(case), moved, drift))
        return tuple(found)

    @cached_property
    def unreached(self) -> tuple[Unreached, ...]:
        """The cases whose reference did not reach the full load."""
        found = []
        for case in self.cases:
            if case.reached != case.full_load:
                share = abs(float(case.load_factors[case.reached] / case.load_factors[case.full_load]))
                why = case.models[str(case.reference)].status[case.full_load].message
                found.append(Unreached(case.hash, self.case_name(case), share, why))
        return tuple(found)

    @cached_property
    def in_range(self) -> Digest:
        """The same of the cases that can be judged; itself where that is all of them."""
        beyond = {one.case for one in self.outside} | {one.case for one in self.unreached}
        if not beyond:
            return self
        return Digest(replace(self.run, cases=[case for case in self.cases if case.hash not in beyond]))

    def same_as_reference(self, model: str) -> bool:
        """Whether a model's answers are the reference's own to rounding, where that is solved on the same mesh."""
        if str(self.reference).endswith(REFINED):
            return False
        spread = self.spread(model, VECTOR)
        return spread is not None and spread.worst < SAME_NUMBERS

    def deciding(self, family: Family) -> str:
        """The model that decides in a family: of those that are compared the one that stands best."""
        return min(self.families[family], key=lambda name: self.limits.standing(self.cases, name))

    @cached_property
    def _places(self) -> dict[str, int]:
        return palette.places(name for name in self.models if name != self.reference)

    def colour(self, model: str) -> int:
        """The model's place in the palette."""
        return REFERENCE if model == self.reference else self._places[model]

    @cached_property
    def legend(self) -> list[tuple[int, str, bool]]:
        """(number in the palette, name, is the reference) of every model; the reference comes last."""
        others = [(self.colour(name), name, False) for name in self.models if name != self.reference]
        return [*others, (REFERENCE, self.reference, True)] if self.reference in self.models else others

    def case_name(self, case: CaseResult) -> str:
        """What a case is called on the page."""
        if case.label:
            return case.label
        return "the only case" if len(self.cases) == 1 else f"case {case.hash[:8]}"

    def title(self, role: str, case: CaseResult) -> str:
        """A key case with its role."""
        return f"{role.capitalize()}: {self.case_name(case)}" if role else self.case_name(case)

    def mark(self, name: str) -> int | None:
        """The place of a name in the palette, None of what is no model of the run."""
        return self.colour(name) if name in self.models else None

    def at(self, case: CaseResult, model: str, metric: str) -> float:
        """A metric of a case at the step of its largest load; NaN where there is none."""
        return float(self.full_loads(model, metric)[self.place[case.hash]])

    @cached_property
    def place(self) -> dict[str, int]:
        """Hash of each case -> its number."""
        return {case.hash: k for k, case in enumerate(self.cases)}

    def full_loads(self, model: str, metric: str) -> Array:
        """(C,) a metric of every case at the step of the largest load; NaN where there is none."""
        found = self._columns.get((model, metric))
        return np.full(len(self.cases), math.nan) if found is None else found[0]

    def bars(self, metric: str) -> Array:
        """(C,) the reference's own part in a metric of every case; NaN where there is none."""
        return np.array([reference_bar(case, metric) for case in self.cases])

    def own_error(self, metric: str) -> float:
        """Median over the cases of the reference's own part in a metric; NaN where none was measured."""
        bars = self.bars(metric)
        known = bars[np.isfinite(bars)]
        return float(np.median(known)) if len(known) else math.nan

    def spread(self, model: str | None, metric: str) -> Spread | None:
        """A metric of a model at full load over all cases; of each case's own reference where that is None."""
        nothing = np.full(len(self.cases), math.nan)
        if model is not None:
            return spread_of(*self._columns.get((model, metric), (nothing, nothing)))
        own = [self._columns.get((str(case.reference), metric), (nothing, nothing)) for case in self.cases]
        columns = [[part[which][k] for k, part in enumerate(own)] for which in (0, 1)]
        return spread_of(np.array(columns[0]), np.array(columns[1]))

    def median(self, model: str, metric: str) -> float:
        """A metric of a model at full load, median over the cases that have it; NaN where none has."""
        found = self.spread(model, metric)
        return math.nan if found is None else found.median

    def floor(self, model: str) -> float:
        """The displacement error of the reference itself, moved along normals only; NaN of models that move freely.

        No model that moves its nodes along normals can be closer.
        """
        share = self.spread(model, "tangential_share")
        if self.reference is None or share is None or not share.worst < ALONG_NORMALS:
            return math.nan
        return self.median(self.reference, "tangential_share")

    def leading(self, model: str) -> str:
        """The metric that leads: the normal error of a model that moves along normals, else displacement."""
        return NORMAL if math.isfinite(self.floor(model)) else VECTOR

    @property
    def mostly_rigid(self) -> bool:
        """Whether the reference's displacement is more rigid motion than change of shape: at the median."""
        return self.reference is not None and self.median(self.reference, "rigid_share") > math.sqrt(0.5)

    @cached_property
    def behaviours(self) -> list[str]:
        """What the reference's mesh levels do, of each case that has them."""
        estimates = [uncertainty.stored_estimate(case.reference_error) for case in self.cases]
        return [e.behaviour for e in estimates if e is not None]

    @cached_property
    def costs(self) -> dict[str, Cost]:
        """Of every model."""
        return {name: self._cost(name) for name in self.models}

    def _cost(self, name: str) -> Cost:
        results = [case.models[name] for case in self.cases if name in case.models]
        frames = [result.frames for result in results if result.frames is not None]
        times = [one.contact for one in frames] or [result.seconds_per_step for result in results]
        setups = [one.setup for one in frames] or [np.array([result.seconds_setup]) for result in results]
        return Cost(
            model=name,
            set_up=_median_known(setups),
            frame=_median_known(times),
            memory=float(max((r.peak_bytes for r in results if _has_answer(r)), default=math.nan)),
            iterative=not frames and any(r.parameters.get("solver") == "iterative" for r in results),
            marks=tuple(self._marks(name)),
        )

    def frame_everywhere(self, name: str) -> float:
        """Median time of a frame with all nodes loaded [s]; NaN where not measured."""
        frames = [case.models[name].frames for case in self.cases if name in case.models]
        return _median_known([one.everywhere for one in frames if one is not None])

    @cached_property
    def stopped(self) -> dict[str, int]:
        """Model -> cases with a step that failed, of the models that have any."""
        found = {
            name: sum(bool(failed_steps(c.models[name])) for c in self.cases if name in c.models)
            for name in self.models
        }
        return {name: count for name, count in found.items() if count}

    def _marks(self, name: str) -> Iterator[str]:
        """What is said of a model's times: nothing where all are of the run that did the others, here."""
        resumed = set(self.run.plan.get("resumed", ()))  # done before the last run that did others
        found, anew = set(), any(m.frames is not None for case in self.cases for m in case.models.values())
        here = processor_name()
        for case in (case for case in self.cases if name in case.models):
            about, frames = case.models[name].parameters, case.models[name].frames
            if frames is not None:
                found |= {ELSEWHERE} if frames.processor != here else set()
                continue
            found |= {ONCE} if anew else set()
            found |= {EARLIER} if case.hash in resumed or "measured_earlier" in about else set()
            machine = about.get("measured_on", case.provenance.get("processor", ""))
            found |= {ELSEWHERE} if machine not in ("", here) else set()
        return (mark for mark in (EARLIER, ELSEWHERE, ONCE) if mark in found)

    @cached_property
    def focus(self) -> str | None:
        """The model that the page looks at closely: the one that decides in the first family of the study."""
        digest = self.in_range if self.in_range.compared else self
        first = next((family for family, models in digest.families.items() if models), None)
        if first is not None:
            return digest.deciding(first)
        others = [name for name in self.models if name != self.reference]
        return next(iter([*others, *self.models]), None)

    @cached_property
    def key_cases(self) -> list[tuple[str, CaseResult]]:
        """(role, case): the worst, the median and the best case of the focus model, fewer where there are fewer.

        Without a reference: those with the largest, median and smallest displacement.
        """
        if not self.cases:
            return []
        if len(self.cases) == 1:
            return [("", self.cases[0])]
        by_error = bool(self.compared)
        sizes = [self._size(case, by_error=by_error) for case in self.cases]
        order = sorted(range(len(sizes)), key=lambda k: (not math.isfinite(sizes[k]), -sizes[k], k))
        finite = [k for k in order if math.isfinite(sizes[k])] or order
        roles = ("worst", "median", "best") if by_error else ("largest", "median", "smallest")
        picks = [(roles[0], finite[0]), (roles[1], finite[len(finite) // 2]), (roles[2], finite[-1])]
        if len(finite) == 2:
            picks = [picks[0], picks[2]]
        seen: dict[int, str] = {}
        for role, k in picks:
            seen.setdefault(k, role)
        return [(role, self.cases[k]) for k, role in seen.items()]

    def _size(self, case: CaseResult, *, by_error: bool) -> float:
        if self.focus is None:
            return math.nan
        if by_error:
            return abs(self.at(case, self.focus, VECTOR))
        result = case.models.get(self.focus)
        if result is None:
            return math.nan
        return float(np.linalg.norm(result.displacement[case.full_load], axis=1).max())

    @cached_property
    def swept_keys(self) -> list[str]:
        """Swept parameters that take more than one value."""
        keys = dict.fromkeys(key for case in self.cases for key in case.swept)
        return [key for key in keys if len({case.swept.get(key) for case in self.cases}) > 1]

    @property
    def has_steps(self) -> bool:
        """Whether any case has a load history."""
        return any(len(case.load_factors) > 1 for case in self.cases)


def _is_whole(case: CaseResult, name: str) -> bool:
    """Whether the coarse body of a model has every node of the surface."""
    return float(case.models[name].parameters.get("coarse_nodes", 0.0)) >= len(case.points)


def _median_known(parts: Sequence[Array]) -> float:
    """Median of the numbers in some arrays that are finite; NaN where there are none."""
    values = np.concatenate([np.zeros(0), *parts])
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


digest_of = lru_cache(maxsize=1)(Digest)  # page, terminal and notebook show one run
