"""`vdmbench plan`: what a run would do."""

from __future__ import annotations

import argparse
from collections import Counter

from ..study.errors import plural
from .arguments import PLANS
from .output import OK, folded, print_json
from .studies import check_files, load, make_plan, require_own

SUMMARY = "say what a run would do"
ARGUMENTS = PLANS


def run(options: argparse.Namespace) -> int:
    """Print what a run would do."""
    from ..work.explain import summary

    study = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    check_files(plan, plan.cases_to_run())
    planned = summary(plan) | {"directory": str(plan.directory)}
    if options.json:
        return print_json(planned)
    print(
        folded(
            f"{study.study.title}: {plural(len(planned['cases']), 'case')} of {', '.join(study.study.models)}"
        )
    )
    if study.study.reference is None:
        print("no reference: the models run without comparison")
    for case in planned["cases"]:
        print(f"  {case['hash'][:12]}  {case['state']:<8} {case['label']}")
    states = Counter(case["state"] for case in planned["cases"])
    print(f"in {plan.directory}: {', '.join(f'{number} {state}' for state, number in states.items())}")
    meshes = plural(planned["meshes_to_make"], "mesh", "meshes")
    print(f"to run: {plural(planned['cases_to_run'], 'case')}, {meshes}")
    for kind in ("needed", "skipped", "refused"):
        for line in planned[kind]:
            print(folded(f"{'will be refused' if kind == 'refused' else kind}: {line}"))
    return OK
