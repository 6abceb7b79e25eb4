"""From the cases of a plan to the tasks that are not done yet: what nobody asks for has no task."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from ..body.mesh_cache import mesh_path
from ..study.config import resolved
from .cache import answer_path, limits_path
from .keys import Wanted, has_weight, level_key

if TYPE_CHECKING:
    from .plan import Plan, PlannedCase


@dataclass(frozen=True)
class Task:
    """One piece of work.

    Attributes
    ----------
    id : its key
    kind : which function of `vdmbench.work.worker` does it: "mesh", "level", "answers", "limits" or "case"
    label : what to call it
    payload : what that function is given, plain JSON
    needs : ids of the tasks to be done before
    case : of "case", which
    """

    id: str
    kind: str
    label: str
    payload: Mapping[str, Any]
    needs: frozenset[str]
    case: PlannedCase | None = None


@dataclass(frozen=True)
class Asked:
    """One answer that is missing: its key, the case that stands for all that want it, and its load factors."""

    key: str
    case: PlannedCase
    factors: tuple[float, ...]


@dataclass(frozen=True)
class Body:
    """One set-up and the answers that are asked of it, which may be for several Young's moduli."""

    name: str
    level: int
    key: str
    mesh: str
    asked: tuple[Asked, ...]

    @property
    def id(self) -> str:
        """Key of the task: a body is set up once in a run."""
        return f"answers {self.key} {self.asked[0].key if not self.superposes else ''}".strip()

    @property
    def superposes(self) -> bool:
        """Whether its answers are of one load each, and not load paths."""
        return len(self.asked[0].factors) == 1 and bool(self.asked[0].case.want(self.name, self.level).scales)


def bodies(plan: Plan, cases: Sequence[PlannedCase]) -> list[Body]:
    """The set-ups that these cases need, each with the answers that the cache has not; a load path has its own."""
    return plan.remembered(("bodies", *(case.hash for case in cases)), lambda: _bodies(plan, cases))


def _bodies(plan: Plan, cases: Sequence[PlannedCase]) -> list[Body]:
    found: dict[str, tuple[str, int, str, str]] = {}
    asked: dict[str, dict[str, Asked]] = {}
    for case in (part for one in cases for part in one.parts):
        for want in case.wanted:
            for key, factors in _factors(case, want):
                if plan.has(answer_path(plan.cache, key)):
                    continue
                of = want.factor if want.scales else f"{want.body} {key}"
                found.setdefault(of, (want.name, want.level, want.factor, case.mesh))
                asked.setdefault(of, {}).setdefault(key, Asked(key, case, factors))
    return [Body(*about, tuple(asked[of].values())) for of, about in found.items()]


def tasks_of(plan: Plan, cases: Sequence[PlannedCase], run: str) -> list[Task]:
    """The tasks that these cases need and whose files are not there, each after those that it needs."""
    cache = str(plan.cache)
    tasks: list[Task] = []
    there: dict[str, str] = {}  # file's key -> task that makes it

    def add(
        kind: str,
        identity: str,
        label: str,
        payload: Mapping[str, Any],
        needs: Iterable[str],
        case: PlannedCase | None = None,
    ) -> str:
        made = frozenset(there[need] for need in needs if need in there)
        tasks.append(Task(identity, kind, label, {"cache": cache, "run": run, **payload}, made, case))
        return identity

    for mesh in plan.missing_meshes(cases):
        of = next(case for case in cases if case.mesh == mesh.key)
        there[mesh.key] = add("mesh", f"mesh {mesh.key}", mesh.label, _on_mesh(of, plan), ())
    found = bodies(plan, cases)
    for mesh_key, level in dict.fromkeys((body.mesh, k) for body in found for k in range(1, body.level + 1)):
        key = level_key(mesh_key, level)
        if not plan.has(mesh_path(plan.cache, key)):
            of = next(case for case in cases if case.mesh == mesh_key)
            label = f"{plan.meshes[mesh_key].label}, refined" + (f" {level} times" if level > 1 else "")
            payload = _on_mesh(of, plan) | {"level": level}
            needs = [level_key(mesh_key, k) for k in range(level)]
            there[key] = add("level", f"mesh {key}", label, payload, needs)
    for body in found:
        payload = _on_mesh(body.asked[0].case, plan) | {
            "name": body.name,
            "level": body.level,
            "asked": [
                {"key": asked.key, "study": resolved(asked.case.study), "factors": asked.factors}
                for asked in body.asked
            ],
        }
        needs = [level_key(body.mesh, k) for k in range(body.level + 1)]
        identity = add("answers", body.id, _answers_label(body), payload, needs)
        there |= {asked.key: identity for asked in body.asked}
    for case in cases:
        if case.limits is not None and not plan.has(limits_path(plan.cache, case.limits)):
            payload = _on_mesh(case, plan) | {"study": resolved(case.study), "limits": case.limits}
            label = f"limits of {case.label or plan.study.study.name}"
            there[case.limits] = add("limits", f"limits {case.limits}", label, payload, [case.mesh])
    for case in cases:
        keys = [key for part in case.parts for want in part.wanted for key in want.answers]
        label = case.label or plan.study.study.name
        add("case", case.hash, label, on_case(case, plan), [case.mesh, case.limits or "", *keys], case)
    return tasks


def _on_mesh(case: PlannedCase, plan: Plan) -> dict[str, Any]:
    return {
        "mesh": case.mesh,
        "volume": plan.meshes[case.mesh].volume,
        "file_hash": plan.meshes[case.mesh].file_hash,
        "study": resolved(case.study),
    }


def on_case(case: PlannedCase, plan: Plan) -> dict[str, Any]:
    """What the task of a case is given."""
    return _on_mesh(case, plan) | {
        "id": case.hash,
        "label": case.label,
        "swept": dict(case.swept),
        "swept_units": dict(case.swept_units),
        "path": str(plan.case_file(case)),
        "wanted": [asdict(want) for want in case.wanted],
        "limits": case.limits,
        "variations": [
            [
                {"wanted": asdict(want), "times": part.times, "values": dict(part.values)}
                for part in variation
                for want in part.wanted
            ]
            for variation in case.variations
        ],
    }


def _factors(case: PlannedCase, want: Wanted) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Each answer that is wanted with the load factors of the case's scene that it is asked at."""
    history = case.study.load.history
    if not want.scales:
        yield want.answers[0], tuple(history)
        return
    for key, factor, scale in zip(want.answers, history, want.scales, strict=True):
        if scale or not any(want.scales):  # a step without load is no times another
            yield key, (factor / scale if scale and not has_weight(case.study) else factor,)


def _answers_label(body: Body) -> str:
    count = f", {len(body.asked)} loads" if len(body.asked) > 1 else ""
    label = body.asked[0].case.label if count == "" else ""
    level = " refined" if body.level else ""
    return f"{body.name}{level}{count}" + (f", {label}" if label else "")
