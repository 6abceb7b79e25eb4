"""What a plan leaves to do, counted: set-ups, solves and steps of each model, and what makes them few."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from . import models
from .keys import has_weight, is_at_rest, loads_of
from .plan import Plan, PlannedCase
from .setups import most_at_once, next_uses
from .study_file.schema import Study


@dataclass(frozen=True)
class ModelWork:
    """What one model has to do for the cases of one group.

    Attributes
    ----------
    name, mesh : the model, and the key of the mesh of its cases
    worker : which of the groups that run apart, each with set-ups of its own
    level : 0 on the cases' own mesh, 1 on its first refinement and so on
    setups : operators and factors made
    held : of these the most that are kept at the same time
    steps : load steps asked for
    solves : load steps solved; the others are combinations of them, or repeat one
    """

    name: str
    mesh: str
    worker: int
    level: int
    setups: int
    held: int
    steps: int
    solves: int


def work_of(plan: Plan, cases: Sequence[PlannedCase], jobs: int = 1) -> list[ModelWork]:
    """The work of some cases in `jobs` workers, group by group: what is stored or cached counts nothing."""
    out: list[ModelWork] = []
    chosen = {case.hash for case in cases}
    groups = plan.groups([case for case in plan.in_order if case.hash in chosen], jobs)
    for worker, group in enumerate(groups):
        for name in group[0].study.study.models:
            unique: dict[tuple[str, int], PlannedCase] = {}
            for case in group:
                if n_levels := _levels_to_solve(plan, case, name):
                    unique.setdefault((case.results[name], n_levels), case)
            for level in range(max((n_levels for _, n_levels in unique), default=0)):
                there = [case for (_, n_levels), case in unique.items() if n_levels > level]
                out.append(_work(name, worker, level, there))
    return out


def _levels_to_solve(plan: Plan, case: PlannedCase, name: str) -> int:
    """On how many mesh levels a case has to ask a model; 0 where its result is there."""
    is_there = name in {**plan.reused(case), **plan.twins(case)}
    if name != case.study.study.reference:
        return 0 if is_there else 1
    levels = case.study.uncertainty.levels if case.study.uncertainty else 1
    return 0 if plan.reference_cached(case) or (is_there and levels == 1) else levels


def _work(name: str, worker: int, level: int, cases: Sequence[PlannedCase]) -> ModelWork:
    model = models.find(name)[0]
    steps = sum(len(case.study.load.history) for case in cases)
    setups, held, solves = len(cases), 1, steps
    if model.together or not model.volumetric or model.name == "fem-condensed":
        uses = next_uses([case.setups[name] for case in cases])
        setups, held = uses.count(None), most_at_once(uses)
    if model.together:
        parts = groupby(cases, key=lambda case: case.setup)
        solves = sum(independent_loads(case.study for case in part) for _, part in parts)
    if models.scales(name):
        solves = _solves_but_for_multiples(name, cases)
    return ModelWork(name, cases[0].mesh, worker, level, setups, held, steps, solves)


def _solves_but_for_multiples(name: str, cases: Sequence[PlannedCase]) -> int:
    """Load steps that a linear surface model solves; of a multiple of what its set-up solved last, none."""
    there = set(next_uses([case.setups[name] for case in cases]))  # places that find their set-up
    last: dict[str, str] = {}  # set-up -> the load that it solved last
    solves = 0
    for place, case in enumerate(cases):
        setup, study = case.setups[name], case.study
        if place not in there:
            last.pop(setup, None)
        if setup in last and (last[setup] == case.load or is_at_rest(study)):
            continue
        solves += len(study.load.history)
        if not has_weight(study) and not _has_penalty(name, study):
            last[setup] = case.load
    return solves


def _has_penalty(name: str, study: Study) -> bool:
    return "penalty" in {**study.vdm_parameters(), **study.model_parameters().get(name, {})}


def independent_loads(studies: Iterable[Study]) -> int:
    """How many load steps of cases on one set-up span all of them, by what they say, without a mesh.

    A load is a sum of unit loads (a contact's shape, a displacement along one axis, the weight) times numbers; the
    rank of these numbers is what a linear model has to solve. Pressures and forces of one shape count apart.
    """
    columns: list[dict[str, float]] = []
    for study in studies:
        parts = loads_of(study)
        weight = {"gravity": 1.0} if has_weight(study) else {}
        columns += [{unit: f * value for unit, value in parts.items()} | weight for f in study.load.history]
    units = sorted({unit for column in columns for unit in column})
    table = np.array([[column.get(unit, 0.0) for unit in units] for column in columns])
    if not table.any():
        return 1
    table = table[table.any(axis=1)]
    largest = np.abs(table).max(axis=0)
    table = table / np.where(largest > 0, largest, 1.0)
    table = table / np.abs(table).max(axis=1, keepdims=True)
    return int(np.linalg.matrix_rank(table / np.linalg.norm(table, axis=1, keepdims=True)))
