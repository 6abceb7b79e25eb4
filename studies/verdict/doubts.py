"""What is doubtful about the scenes: each a judgement, told beside results that were computed all the same."""

from __future__ import annotations

from dataclasses import dataclass

from ..measures.case import CaseResult
from ..scene.warnings import scene_warnings
from .digest import Digest


@dataclass(frozen=True)
class Doubt:
    """A doubt about a constraint, with the first case that raises it."""

    constraint: str
    case: CaseResult
    text: str


def doubts(digest: Digest) -> list[Doubt]:
    """Each constraint's doubts, of several cases the first."""
    found: dict[tuple[str | int, ...], Doubt] = {}
    for case in digest.cases:
        constraints = [one.model_dump(exclude_none=True) for one in case.study.constraints]
        tissue, factor = case.study.tissue.model_dump(exclude_none=True), float(abs(case.load_factors).max())
        for loc, text in scene_warnings(
            constraints, tissue, case.regions, case.points, case.triangles, factor
        ):
            entry = constraints[int(loc[1])] if loc[0] == "constraints" else {"name": ".".join(map(str, loc))}
            found.setdefault(loc, Doubt(entry.get("name") or entry["region"], case, text))
    return list(found.values())
