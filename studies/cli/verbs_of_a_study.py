"""A study before it is solved, and its run: `list schema new show check plan run`."""

from __future__ import annotations

import argparse
import os
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..study.errors import InputError, plural
from ..study.files import shipped_studies
from .arguments import (
    CASE,
    CHANGES,
    PLANS,
    STUDY_READS,
    flag,
    option,
    output,
    positive_seconds,
    shard,
    study_argument,
    verb,
)
from .output import OK, USAGE, answer, folded, print_json, print_run, print_table
from .studies import check_files, numbered_case, plan_of, run_missing

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..measures.case import CaseResult
    from ..work.plan import Plan, PlannedCase

TEMPLATE = Path(__file__).with_name("new_study.toml")
_NAME = re.compile(r'^(\s*name\s*=\s*)(?:"[^"\n]*"|\'[^\'\n]*\')', re.MULTILINE)


@verb(
    "new",
    "write a study file to begin with, or a copy of another study",
    option("name", metavar="NAME", help="name of the study; NAME.toml is written, which must be new"),
    option("--from", dest="source", metavar="STUDY", help="a study to copy, a file or a shipped one"),
)
def new_study(options: argparse.Namespace) -> int:
    """Write NAME.toml, and beside it the files that a copied study names."""
    from ..study.files import study_path
    from ..study.kinds import is_safe_name

    path = Path(options.name).with_suffix("") if options.name.endswith(".toml") else Path(options.name)
    if not is_safe_name(path.name):
        raise InputError(
            f"{options.name!r}: a study's name has letters, digits, _ . - and at most 64 of them"
        )
    source = study_path(options.source) if options.source else TEMPLATE
    text = source.read_text(encoding="utf-8-sig")
    files = _files(text, source.parent) if options.source else {}
    target = path.with_name(f"{path.name}.toml")
    wanted: dict[Path, bytes] = {target: _named(text, path.name, source).encode()}
    wanted |= {target.parent / name: file.read_bytes() for name, file in files.items()}
    for file in wanted:
        if os.path.lexists(file):
            raise InputError(f"{file}: is there already, and is not overwritten; choose another name")
    for file, content in wanted.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("xb") as out:
            out.write(content)
    told = {"study": str(target), "files": [str(file) for file in wanted]}
    return answer(options, told, f"{target}: run it with: vdmbench run {target}")


def _named(text: str, name: str, source: Path) -> str:
    """The study's text with another name."""
    if source == TEMPLATE:
        return text.replace("NAME", name)
    start = re.search(r"^\s*\[\s*study\s*\]", text, re.MULTILINE)
    found = _NAME.search(text, start.end()) if start else None
    if found is None:
        raise InputError(f"{source}: has no line with the name of its study, so it cannot be copied")
    return f'{text[: found.start()]}{found[1]}"{name}"{text[found.end() :]}'


def _files(text: str, directory: Path) -> dict[str, Path]:
    """The files beside a study that it names. Raises InputError for one that is missing or elsewhere."""
    names = re.findall(r'^\s*path\s*=\s*"([^"\n]*)"', text, re.MULTILINE)
    for name in names:
        if Path(name).is_absolute() or ".." in Path(name).parts or not (directory / name).is_file():
            raise InputError(f"it names {name!r}, which is no file beside it; copy the study by hand")
    return {name: directory / name for name in names}


@verb(
    "show",
    "draw body, regions and loads of a study before anything is solved",
    study_argument(),
    *STUDY_READS,
    CHANGES,
    output("--save", "PNG", "the picture (default NAME-scene.png in this directory)"),
    CASE,
)
def show_scene(options: argparse.Namespace) -> int:
    """Mesh the body, put the scene on it, draw it."""
    from ..machine import write_atomically
    from ..report.scene_picture import Stage, scene_png
    from ..report.section_scene import outlines_of, parts_of, scene_words

    if options.save and options.save.suffix.lower() != ".png":
        raise InputError(f"--save {options.save}: the picture is a PNG; give a name that ends in .png")
    plan = plan_of(options)
    study, case = plan.study.study, _unsolved(plan, numbered_case(plan, options.case))
    words = scene_words(case, [case])
    path = options.save or Path(f"{study.name}-scene.png")
    title = f"{study.title}: {case.label}" if case.label else study.title
    told = [f"{what}: {value}" for what, value in words]
    parts = parts_of(case, [case])
    stage = Stage(case.points, case.triangles, parts, outlines_of(case))
    write_atomically(path, scene_png(stage, told, title=title))
    return answer(options, {"picture": str(path), "scene": dict(words)}, *told, f"picture: {path}")


def _unsolved(plan: Plan, case: PlannedCase) -> CaseResult:
    """A case with its scene but no answer. Raises StudyError where the scene does not fit its mesh."""
    from ..measures.case import CaseResult
    from ..work.explain import scene_of

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


@verb(
    "list",
    "list the shipped studies, or the models",
    flag("--models", "list the models with what a study may set"),
)
def list_studies(options: argparse.Namespace) -> int:
    """Print the shipped studies, or the models."""
    import tomllib

    if options.models:
        from ..study.registry import BROKEN, all_models

        titles = {
            name: f"solvers {', '.join(model.solvers)}; reads {', '.join(model.parameters) or 'none'}"
            for name, model in all_models().items()
        } | {name: f"no model: {why}" for name, why in BROKEN.items()}
    else:
        texts = {name: path.read_text() for name, path in shipped_studies().items()}
        titles = {name: tomllib.loads(text)["study"]["title"] for name, text in texts.items()}
    width = max(map(len, titles))
    return answer(options, titles, *(f"{name:<{width}}  {title}" for name, title in titles.items()))


@verb("schema", "print the JSON schema of study files, for editors")
def print_schema(_: argparse.Namespace) -> int:
    """Print the JSON schema of study files.

    Save it, and name it in the first line of a study, #:schema study.json, for an editor that knows TOML
    schemas.
    """
    from ..study.fields import study_schema

    return print_json(study_schema())


@verb("check", "validate a study without running it", study_argument(), *STUDY_READS, CHANGES)
def check_study(options: argparse.Namespace) -> int:
    """Validate a study without running it: its keys, and its scene on its mesh.

    A body that is not in the cache is meshed and kept there for the run, which takes the longer the finer it is,
    unless its surface has more than 20,000 nodes. What cannot run ends with exit code 2; a matter of judgement is a
    warning.
    """
    from ..study.errors import StudyError
    from ..work.explain import beyond_memory, refused, scene_problems
    from ..work.tasks import tasks_of

    try:
        plan = plan_of(options)
        study = plan.study
        check_files(plan, plan.cases)
        tasks = tasks_of(plan, plan.cases)
        if stops := beyond_memory(plan, tasks):
            raise study.error(stops)
        expected = refused(plan, plan.cases)
        doubts = scene_problems(plan) + study.error(beyond_memory(plan, tasks, 1.0)).problems
    except StudyError as error:
        if not options.json:
            raise
        print_json({"ok": False, "problems": [problem._asdict() for problem in error.problems]})
        return USAGE
    told = [problem._asdict() for problem in doubts]
    return answer(
        options,
        {"ok": True, "problems": [], "cases": len(plan.cases), "refused": expected, "warnings": told},
        f"{study.path}: ok, {plural(len(plan.cases), 'case')}",
        *(f"warning: {problem}" for problem in doubts),
        *(f"will be refused: {line}" for line in expected),
    )


@verb("plan", "say what a run would do", *PLANS)
def plan_study(options: argparse.Namespace) -> int:
    """Print what a run would do."""
    from ..work.explain import summary

    plan = plan_of(options)
    check_files(plan, plan.cases_to_run())
    planned = summary(plan) | {"directory": str(plan.directory)}
    if options.json:
        return print_json(planned)
    study = plan.study.study
    print(folded(f"{study.title}: {plural(len(planned['cases']), 'case')} of {', '.join(study.models)}"))
    if study.reference is None:
        print("no reference: the models run without comparison")
    for case in planned["cases"]:
        print(f"  {case['hash'][:12]}  {case['state']:<8} {case['label']}")
    states = Counter(case["state"] for case in planned["cases"])
    print(f"in {plan.directory}: {', '.join(f'{number} {state}' for state, number in states.items())}")
    meshes = plural(planned["meshes_to_make"], "mesh", "meshes")
    limits = f", small-strain limits of {plural(planned['limits'], 'case')}" if planned["limits"] else ""
    print(f"to run: {plural(planned['cases_to_run'], 'case')}, {meshes}{limits}")
    print_table(_work_rows(planned["work"]))
    for line in planned["refused"]:
        print(folded(f"will be refused: {line}"))
    return OK


def _work_rows(work: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Work that the cache lacks, from which all load steps are made: a line for each model and mesh level."""
    set_ups, solves = Counter[str](), Counter[str]()
    for one in work:
        refined = f", refined {plural(one['level'], 'time')}" if one["level"] else ""
        set_ups[one["model"] + refined] += 1
        solves[one["model"] + refined] += one["solves"]
    return [
        {"still to solve": name, "set-ups": f"{count}", "solves": f"{solves[name]}"}
        for name, count in set_ups.items()
    ]


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
    option("--timeout", type=positive_seconds, metavar="S", help="seconds that one case may take"),
)
def run_study(options: argparse.Namespace) -> int:
    """Run what is missing, write the report, print the headline table."""
    plan = plan_of(options)
    names = ("shard", "timeout", "scheduler", "insecure_scheduler")
    how = {name: getattr(options, name) for name in names}
    run, report = run_missing(plan, options, **how)
    return print_run(run, plan.directory, report, options.json)
