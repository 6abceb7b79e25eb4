"""What can be run, whether a study is right, what a run would do, and the run: `list schema check plan run`."""

from __future__ import annotations

import argparse
from collections import Counter

from ..study.errors import plural
from ..study.files import shipped_studies
from .arguments import (
    CHANGES,
    PLANS,
    STUDY_READS,
    flag,
    option,
    positive_seconds,
    shard,
    size_in_bytes,
    study_argument,
    verb,
)
from .output import OK, USAGE, folded, print_json, print_run
from .studies import check_files, load, make_plan, require_own, run_missing


@verb(
    "list",
    "list the shipped studies, or the models",
    flag("--models", "list the models with what a study may set"),
)
def list_studies(options: argparse.Namespace) -> int:
    """Print the shipped studies, or the models."""
    import tomllib

    titles = {}
    if options.models:
        from ..study.registry import BROKEN, all_models

        for name, model in all_models().items():
            titles[name] = (
                f"solvers {', '.join(model.solvers)}; reads {', '.join(model.parameters) or 'none'}"
            )
        titles |= {name: f"no model: {why}" for name, why in BROKEN.items()}
    for name, path in shipped_studies().items() if not options.models else ():
        titles[name] = tomllib.loads(path.read_text())["study"]["title"]
    if options.json:
        return print_json(titles)
    width = max(map(len, titles))
    for name, title in titles.items():
        print(f"{name:<{width}}  {title}")
    return OK


@verb(
    "schema",
    "print the JSON schema of study files, for editors",
)
def print_schema(_: argparse.Namespace) -> int:
    """Print the JSON schema of study files.

    Save it, and name it in the first line of a study, #:schema study.json, for an editor that knows TOML
    schemas.
    """
    from ..study.fields import study_schema

    print_json(study_schema())
    return OK


@verb(
    "check",
    "validate a study without running it",
    study_argument(),
    *STUDY_READS,
    CHANGES,
)
def check_study(options: argparse.Namespace) -> int:
    """Validate a study without running it: its keys, and its scene on the surface of its mesh.

    A surface that is not in the cache is meshed and kept there, which takes a second or two, unless it has more
    than 20,000 nodes. What cannot run ends with exit code 2; what is a matter of judgement is a warning.
    """
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


@verb(
    "plan",
    "say what a run would do",
    *PLANS,
)
def plan_study(options: argparse.Namespace) -> int:
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


@verb(
    "run",
    "run what is missing and write the report",
    *PLANS,
    option(
        "--shard", type=shard, default=(1, 1), metavar="I/N", help="run only the I-th of N parts of the cases"
    ),
    option(
        "--scheduler",
        metavar="ADDRESS",
        help="run the cases on this Dask cluster, such as tls://HOST:8786; meshes are made here; without TLS it "
        "trusts all who reach it, on loopback every user of the machine",
    ),
    flag(
        "--insecure-scheduler",
        "allow a scheduler on another machine without TLS: whoever reaches its network can run programs",
    ),
    flag("--fail-fast", "stop at the first failure"),
    option("--timeout", type=positive_seconds, metavar="S", help="seconds that one case may take"),
    option(
        "--memory",
        type=size_in_bytes,
        metavar="SIZE",
        help="memory that one worker may take, such as 4GB (default: the machine's, divided by the jobs)",
    ),
)
def run_study(options: argparse.Namespace) -> int:
    """Run what is missing, write the report, print the headline table."""
    study = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    names = ("shard", "timeout", "memory", "fail_fast", "scheduler", "insecure_scheduler")
    how = {name: getattr(options, name) for name in names}
    run, report = run_missing(plan, options, **how)
    return print_run(run, plan.directory, report, options.json)
