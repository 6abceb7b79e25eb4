"""`vdmbench check`: what is wrong with a study, before anything is solved."""

from __future__ import annotations

import argparse

from ..study.errors import plural
from .arguments import CHANGES, STUDY_READS, study_argument
from .output import OK, USAGE, print_json
from .studies import check_files, load, make_plan

SUMMARY = "validate a study without running it"
MORE = (
    "Validate a study without running it: its keys, and its scene on the surface of its mesh. A surface that is "
    "not in the cache is meshed and kept there, which takes a second or two, unless it has more than 20,000 nodes. "
    "What cannot run ends with exit code 2; what is a matter of judgement is a warning."
)
ARGUMENTS = (study_argument(), *STUDY_READS, CHANGES)


def run(options: argparse.Namespace) -> int:
    """Print whether a study is right, or every mistake in it."""
    from ..study.errors import StudyError
    from ..work.explain import beyond_memory, blockers, refused
    from ..work.scene_check import scene_problems
    from ..work.tasks import bodies

    try:
        study = load(options)
        plan = make_plan(study, options)
        check_files(plan, plan.cases)
        work = bodies(plan, plan.cases)
        if stops := blockers(plan, plan.cases, work):
            raise study.error(stops)
        expected = refused(plan, plan.cases, work)
        doubts = scene_problems(plan)
        tight = [(("geometry", "mesh_size"), text) for text in beyond_memory(plan, work, 1.0).values()]
        doubts += study.error(tight).problems
    except StudyError as error:
        if options.json:
            problems = [problem._asdict() for problem in error.problems]
            print_json({"ok": False, "problems": problems})
            return USAGE
        raise
    if options.json:
        told = [problem._asdict() for problem in doubts]
        return print_json(
            {"ok": True, "problems": [], "cases": len(plan.cases), "refused": expected, "warnings": told}
        )
    print(f"{study.path}: ok, {plural(len(plan.cases), 'case')}")
    for problem in doubts:
        print(f"warning: {problem}")
    for line in expected:
        print(f"will be refused: {line}")
    return OK
