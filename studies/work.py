"""What a plan leaves to do, counted: set-ups, solves and steps of each model, and what makes them few."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from . import models
from .keys import loads_of
from .plan import Plan, PlannedCase
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
    steps : load steps asked for
    solves : load steps solved; the others are combinations of them, or repeat one
    """

    name: str
    mesh: str
    worker: int
    level: int
    setups: int
    steps: int
    solves: int


def work_of(plan: Plan, cases: Sequence[PlannedCase], jobs: int = 1) -> list[ModelWork]:
    """The work of some cases in `jobs` workers, group by group: what is stored or cached counts nothing."""
    out: list[ModelWork] = []
    for worker, group in enumerate(plan.groups(cases, jobs)):
        for name in group[0].study.study.models:
            unique = {
                (case.results[name], n_levels): case
                for case in group
                if (n_levels := _levels_to_solve(plan, case, name))
            }
            for level in range(max((n_levels for _, n_levels in unique), default=0)):
                there = [case for (_, n_levels), case in unique.items() if n_levels > level]
                out.append(_work(name, worker, level, there))
    return out


def _levels_to_solve(plan: Plan, case: PlannedCase, name: str) -> int:
    """On how many mesh levels a case has to ask a model; 0 where its result is there."""
    is_there = name in plan.reused(case)
    if name != case.study.study.reference:
        return 0 if is_there else 1
    levels = case.study.uncertainty.levels if case.study.uncertainty else 1
    return 0 if plan.reference_cached(case) or (is_there and levels == 1) else levels


def _work(name: str, worker: int, level: int, cases: Sequence[PlannedCase]) -> ModelWork:
    model = models.find(name)[0]
    steps = sum(len(case.study.load.history) for case in cases)
    solves = steps
    if model.together:
        solves = independent_loads(case.study for case in cases)
    elif models.scales(name) and not _has_penalty(name, cases[0].study):
        # of the cases whose loads are multiples of each other the first, as the plan orders them
        solved = {(case.surface, case.load): case for case in reversed(cases)}
        solves = sum(len(case.study.load.history) for case in solved.values())
    setups = 1 if model.volumetric else len({case.surface for case in cases})
    if model.name == "fem-condensed":
        setups = len({_condensed_to(case.study) for case in cases})
    elif model.volumetric and model.together is None:
        setups = len(cases)
    return ModelWork(name, cases[0].mesh, worker, level, setups, steps, solves)


def _condensed_to(study: Study) -> tuple[tuple[str, float], ...]:
    """What a set-up of condensed elements is for: where there is contact, and one motion up to a factor."""
    loads = loads_of(study)
    moved = {unit: value for unit, value in loads.items() if not unit.startswith(("force ", "pressure "))}
    largest = max(map(abs, moved.values()), default=0.0) or 1.0
    return tuple((unit, value / largest if unit in moved else 1.0) for unit, value in loads.items() if value)


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
        weight = {"gravity": 1.0} if study.gravity else {}
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
