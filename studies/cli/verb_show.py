"""`vdmbench show`: the body, its regions and its loads in a picture, before anything is solved."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import CASE, CHANGES, STUDY_READS, option, place, study_argument, verb
from .output import OK, print_json
from .studies import load, make_plan, numbered_case

if TYPE_CHECKING:
    from ..measures.case import CaseResult
    from ..work.plan import Plan, PlannedCase


@verb(
    "show",
    "draw body, regions and loads of a study before anything is solved",
    study_argument(),
    *STUDY_READS,
    CHANGES,
    option(
        "--save",
        type=place,
        metavar="PNG",
        help="the picture (default NAME-scene.png in this directory)",
    ),
    CASE,
)
def show_scene(options: argparse.Namespace) -> int:
    """Mesh the surface, put the scene on it, draw it."""
    from ..machine import write_atomically
    from ..report.scene_picture import Stage, scene_png
    from ..report.section_scene import outlines_of, parts_of, scene_words

    study = load(options)
    plan = make_plan(study, options)
    case = _unsolved(plan, numbered_case(plan, options.case))
    words = scene_words(case, [case])
    path = options.save or Path(f"{study.study.name}-scene.png")
    title = f"{study.study.title}: {case.label}" if case.label else study.study.title
    told = [f"{what}: {value}" for what, value in words]
    parts = parts_of(case, [case])
    stage = Stage(case.points, case.triangles, parts, outlines_of(case))
    write_atomically(path, scene_png(stage, told, title=title))
    if options.json:
        return print_json({"picture": str(path), "scene": dict(words)})
    for line in told:
        print(line)
    print(f"picture: {path}")
    return OK


def _unsolved(plan: Plan, case: PlannedCase) -> CaseResult:
    """A case with its scene and no answer. Raises StudyError where the scene cannot be put on its mesh."""
    from ..measures.case import CaseResult
    from ..work.scene_check import scene_of

    scene = scene_of(plan, case)
    return CaseResult(
        hash=case.hash,
        label=case.label,
        swept=case.swept,
        swept_units=case.swept_units,
        study=case.study,
        provenance={},
        points=scene.mesh.surface_points,
        triangles=scene.mesh.triangles,
        load_factors=scene.load_factors,
        regions=scene.regions,
        models={},
        metrics={},
        reference=None,
    )
