"""From the cases of a plan to the tasks that are not done yet: what nobody asks for has no task."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..body.mesh_cache import mesh_path
from ..study.config import resolved
from .cache import answer_path
from .keys import Wanted, has_weight, level_key

if TYPE_CHECKING:
    from .plan import Plan, PlannedCase


@dataclass(frozen=True)
class Task:
    """One piece of work.

    Attributes
    ----------
    id : its key
    kind : which function of `vdmbench.work.worker` does it: "mesh", "level", "answers", "case" or "times"
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
    """One set-up and the answers that are asked of it."""

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
                of = want.body if want.scales else f"{want.body} {key}"
                found.setdefault(of, (want.name, want.level, want.body, case.mesh))
                asked.setdefault(of, {}).setdefault(key, Asked(key, case, factors))
    return [Body(*about, tuple(asked[of].values())) for of, about in found.items()]


def tasks_of(plan: Plan, cases: Sequence[PlannedCase]) -> list[Task]:
    """The tasks that these cases need and whose files are not there, each after those that it needs."""
    tasks: list[Task] = []
    there: dict[str, str] = {}  # file's key -> task that makes it

    def add(kind: str, identity: str, label: str, of: PlannedCase, needs: Iterable[str], **own: Any) -> None:
        made = frozenset(there[need] for need in needs if need in there)
        payload = case_payload(of, plan) | own
        tasks.append(Task(identity, kind, label, payload, made, of if kind == "case" else None))

    on_mesh = {case.mesh: case for case in reversed(cases)}
    for mesh in plan.missing_meshes(cases):
        there[mesh.key] = f"mesh {mesh.key}"
        add("mesh", there[mesh.key], mesh.label, on_mesh[mesh.key], ())
    found = bodies(plan, cases)
    for mesh_key, level in dict.fromkeys((body.mesh, k) for body in found for k in range(1, body.level + 1)):
        key = level_key(mesh_key, level)
        if not plan.has(mesh_path(plan.cache, key)):
            label = f"{plan.meshes[mesh_key].label}, refined" + (f" {level} times" if level > 1 else "")
            coarser = [level_key(mesh_key, k) for k in range(level)]
            add("level", f"mesh {key}", label, on_mesh[mesh_key], coarser, level=level)
            there[key] = f"mesh {key}"
    for body in found:
        asked = [
            {"key": one.key, "study": resolved(one.case.study), "factors": one.factors} for one in body.asked
        ]
        needs = [level_key(body.mesh, k) for k in range(body.level + 1)]
        own = {"name": body.name, "level": body.level, "asked": asked}
        add("answers", body.id, _answers_label(body), body.asked[0].case, needs, **own)
        there |= {one.key: body.id for one in body.asked}
    for case in cases:
        keys = [key for part in case.parts for want in part.wanted for key in want.answers]
        add("case", case.hash, case.label or plan.study.study.name, case, [case.mesh, *keys])
    return tasks


def case_payload(case: PlannedCase, plan: Plan) -> dict[str, Any]:
    """What a task is told of a case and its mesh, plain JSON."""
    mesh = plan.meshes[case.mesh]
    return {
        "cache": str(plan.cache),
        "path": str(plan.case_file(case)),
        "fresh": plan.fresh,
        "case": case.as_json(),
        "volume": mesh.volume,
        "file_hash": mesh.file_hash,
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
