"""The tasks of a plan's cases that are not done yet; work that nobody needs has no task."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ..body.mesh_cache import mesh_path
from ..study.config import resolved
from ..study.schema import has_weight
from .cache import answer_path
from .keys import Wanted, level_key

if TYPE_CHECKING:
    from .plan import Plan, PlannedCase


@dataclass(frozen=True)
class Task:
    """One piece of work.

    Attributes
    ----------
    id : its key
    kind : the function of `vdmbench.work.worker` that does it: "mesh", "answers", "case" or "times"
    label : name for messages
    payload : input of that function, plain JSON
    needs : ids of tasks to be done before
    case : the case of a "case" task
    """

    id: str
    kind: str
    label: str
    payload: Mapping[str, Any]
    needs: frozenset[str]
    case: PlannedCase | None = None


def tasks_of(plan: Plan, cases: Sequence[PlannedCase]) -> list[Task]:
    """The tasks that these cases need and whose files are missing, each after those that it needs.

    A mesh task includes its refinements. An answers task includes one set-up and all its missing answers; a load
    path has its own set-up.
    """
    set_ups: dict[str, Task] = {}
    made_by: dict[str, str] = {}  # answer -> the task that makes it
    levels = dict.fromkeys((case.mesh for case in cases), 0)  # mesh -> number of refinements
    for case in (part for one in cases for part in one.parts):
        for want in case.wanted:
            for key, factors in _factors(case, want):
                if key in made_by or plan.has(answer_path(plan.cache, key)):
                    continue
                own = made_by[key] = f"answers {want.body}" + ("" if want.scales else f" {key}")
                if own not in set_ups:
                    levels[case.mesh] = max(levels[case.mesh], want.level)
                    about = {"name": want.name, "level": want.level, "asked": []}
                    label = f"{want.name}{' refined' if want.level else ''}"
                    needs = frozenset({f"mesh {case.mesh}"})
                    set_ups[own] = Task(own, "answers", label, case_payload(case, plan) | about, needs)
                asked = {"key": key, "study": resolved(case.study), "factors": factors}
                set_ups[own].payload["asked"].append(asked)
    on_mesh = {case.mesh: case for case in reversed(cases)}
    tasks = []
    for mesh, level in levels.items():
        if not all(plan.is_sound(mesh_path(plan.cache, level_key(mesh, k))) for k in range(level + 1)):
            label = plan.meshes[mesh].label + (", refined" if level else "")
            payload = case_payload(on_mesh[mesh], plan) | {"level": level}
            tasks.append(Task(f"mesh {mesh}", "mesh", label, payload, frozenset()))
    for task in set_ups.values():
        loads = len(task.payload["asked"])
        told = f"{loads} loads" if loads > 1 else task.payload["case"]["label"]
        tasks.append(replace(task, label=", ".join(filter(None, (task.label, told)))))
    for case in cases:
        answers = (key for part in case.parts for want in part.wanted for key in want.answers)
        mine = {f"mesh {case.mesh}", *(made_by[key] for key in answers if key in made_by)}
        label = case.label or plan.study.study.name
        tasks.append(Task(case.hash, "case", label, case_payload(case, plan), frozenset(mine), case))
    return tasks


def case_payload(case: PlannedCase, plan: Plan) -> dict[str, Any]:
    """The payload of a case and its mesh, plain JSON."""
    mesh = plan.meshes[case.mesh]
    return {
        "cache": str(plan.cache.absolute()),
        "path": str(plan.case_file(case).absolute()),
        "case": case.as_json(),
        "volume": mesh.volume,
        "file_hash": mesh.file_hash,
    }


def _factors(case: PlannedCase, want: Wanted) -> Iterator[tuple[str, tuple[float, ...]]]:
    """The needed answers, each with the load factors of the case's scene for it."""
    history = case.study.load.history
    if not want.scales:
        yield want.answers[0], tuple(history)
        return
    for key, factor, scale in zip(want.answers, history, want.scales, strict=True):
        if scale or not any(want.scales):  # a step without load is zero times another
            yield key, (factor / scale if scale and not has_weight(case.study) else factor,)
