"""The verbs that take a study: list, check, plan, run, calibrate, bench."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..machine.processors import usable_processors
from .output import (
    FAILED,
    OK,
    USAGE,
    Progress,
    UsageError,
    complain,
    complain_of_failures,
    count,
    print_json,
    print_run,
    print_table,
    results_directory,
    tell,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..graph.plan import Plan, PlannedCase
    from ..measures.case import Run
    from ..study.schema import Study

SHIPPED = Path(__file__).parents[1] / "cases"


def list_verb(options: argparse.Namespace) -> int:
    """Print the shipped studies, or the models."""
    import tomllib

    titles = {}
    if options.models:
        from ..study.registry import all_models

        for name, model in all_models().items():
            titles[name] = (
                f"solvers {', '.join(model.solvers)}; reads {', '.join(model.parameters) or 'none'}"
            )
    for path in sorted(SHIPPED.glob("*.toml")) if not options.models else ():
        titles[path.stem] = tomllib.loads(path.read_text())["study"]["title"]
    if options.json:
        return print_json(titles)
    width = max(map(len, titles))
    for name, title in titles.items():
        print(f"{name:<{width}}  {title}")
    return OK


def check_verb(options: argparse.Namespace) -> int:
    """Print whether a study is right, or every mistake in it."""
    from ..graph.explain import refused
    from ..graph.nodes import bodies
    from ..graph.scene_check import scene_problems
    from ..study.problems import StudyError

    try:
        study, path = _load(options)
        plan = _make_plan(study, options)
        _check_files(plan, plan.cases)
        expected = refused(plan, plan.cases, bodies(plan, plan.cases))
        doubts = [] if expected else scene_problems(plan)
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
    print(f"{path}: ok, {count(len(plan.cases), 'case')}")
    for problem in doubts:
        print(f"warning: {problem}")
    for line in expected:
        print(f"will be refused: {line}")
    return OK


def _check_files(plan: Plan, cases: Sequence[PlannedCase]) -> None:
    """Read the files of cases that are still to be meshed. Raises StudyError for those that cannot be used."""
    from ..machine.errors import MeshError
    from ..study.config import geometry_error

    for mesh in plan.missing_meshes(cases):
        try:
            _ = mesh.expected
        except MeshError as error:
            raise geometry_error(plan.study, error) from error


def plan_verb(options: argparse.Namespace) -> int:
    """Print what a run would do, and what it would cost."""
    from ..graph.explain import summary
    from ..graph.space import free_bytes

    study, _ = _load(options)
    plan = _make_plan(study, options)
    _require_own(plan, options)
    _check_files(plan, plan.cases_to_run())
    free = free_bytes(plan.directory)
    planned = summary(plan) | {"directory": str(plan.directory), "disk_free": free}
    if options.json:
        return print_json(planned)
    print(f"{study.study.title}: {count(len(planned['cases']), 'case')} of {', '.join(study.study.models)}")
    if study.study.reference is None:
        print("no reference: the models run without comparison")
    for case in planned["cases"]:
        print(f"  {case['hash'][:12]}  {case['state']:<8} {case['label']}")
    meshes = count(planned["meshes_to_make"], "mesh", "meshes")
    print(f"to run: {count(planned['cases_to_run'], 'case')}, {meshes}")
    for kind in ("needed", "skipped", "refused"):
        for line in planned[kind]:
            print(f"{'will be refused' if kind == 'refused' else kind}: {line}")
    expected = planned["estimate"]
    print(
        f"estimate: {expected['seconds']:.0f} s on one core, {expected['memory'] / 1e6:.0f} MB a worker, "
        f"{expected['disk'] / 1e6:.1f} MB on disk ({free / 1e9:.3g} GB free); "
        f"each within a factor of {expected['factor']:g}"
    )
    return OK


def run_verb(options: argparse.Namespace) -> int:
    """Run what is missing, write the report, print the headline table."""
    from ..graph.run import Options, count_of_events, lost_cases, run_plan
    from ..report.rebuild import rebuild

    study, path = _load(options)
    plan = _make_plan(study, options)
    _require_own(plan, options)
    how = Options(
        jobs=options.jobs or usable_processors(),
        shard=options.shard,
        timeout=options.timeout,
        memory=options.memory,
        fail_fast=options.fail_fast,
        scheduler=options.scheduler,
        insecure_scheduler=options.insecure_scheduler,
    )
    with Progress(count_of_events(plan, how.shard), study.study.name, quiet=options.json) as progress:
        run, report = run_plan(plan, path.read_text(), how, progress.show, rebuild)
    code = print_run(run, plan.directory, report, options.json)
    stopped = options.fail_fast and run.failed  # before it came to all
    if lost := [] if stopped else lost_cases(plan, how.shard, run):
        told = f"no longer in {plan.directory}: {count(len(lost), 'case')} of this run, first {lost[0]}"
        complain(f"{told}; run the same again", FAILED)
        return code or FAILED
    return code


def calibrate_verb(options: argparse.Namespace) -> int:
    """Fit the VDM parameters on half of a study's loads; print and write the table for its `[vdm]`."""
    from ..evidence.calibrate import as_json, as_toml, body, calibrate, check, check_fit, finer_study
    from ..evidence.calibration_table import table
    from ..machine.files import json_text, write_atomically
    from ..study.problems import StudyError

    study, path = _load(options)
    plan = _make_plan(study, options)
    _require_own(plan, options)
    check_fit(plan)
    elsewhere = []  # read, and found to be of use, before anything is run
    for name in options.transfer:
        there = argparse.Namespace(**vars(options) | {"study": name, "surface": None, "out": None})
        other, other_path = _load(there)
        elsewhere.append((_make_plan(other, there), other_path))
        check(elsewhere[-1][0])
    out = plan.directory
    run, refined = _run_for_fit(plan, path, options), None
    finer, no_finer = finer_study(plan)
    if finer is not None:
        again = _command("calibrate", options)
        try:
            planned = _make_plan(finer, options, directory=out / "finer", command=again)
        except StudyError as error:
            no_finer = error.problems[0].message
        else:
            refined = _run_for_fit(planned, path, options)
    own = body(*run, refined, no_finer)
    others = [body(*_run_for_fit(*other, options)) for other in elsewhere]
    entries = calibrate(own, others)
    data = {own.name: as_json(entries)}
    write_atomically(out / "calibration.json", json_text(data, indent=1).encode())
    write_atomically(out / "calibration.toml", as_toml(entries).encode())
    if options.json:
        print_json(data)
    else:
        print_table(table(entries))
        print(f"\n{as_toml(entries)}\nwritten: {out / 'calibration.toml'}")
    return FAILED if own.lost or any(other.lost for other in others) else OK


def bench_verb(options: argparse.Namespace) -> int:
    """Measure the study, or a sphere, an organ and the surface that is given, with every model."""
    from ..evidence import bench
    from ..evidence.bench_data import answers, machine_independent, rows
    from ..evidence.bench_page import ANSWERS_NOTE, ERROR_NOTE, write_bench_page
    from ..evidence.bench_store import write_bench

    studies = {
        body: _load(argparse.Namespace(**vars(options) | {"study": name, "surface": surface}))[0]
        for body, (name, surface) in bodies_to_measure(options.study, options.surface).items()
    }
    if options.study:
        for study in studies.values():
            # a mesh that cannot be made is told with its line before anything is measured
            _make_plan(study, options)
    out = options.out or results_directory() / "bench"
    if out.is_dir() and any(out.iterdir()) and not (out / "bench.h5").exists():
        raise UsageError(f"{out}: is not empty and not a benchmark's directory; choose another --out")
    found = bench.measure(
        studies,
        results_directory() / "cache",
        names=None if options.study else bench.MODELS,
        large=options.large,
        watch=tell,
    )
    write_bench(out / "bench.h5", found)
    write_bench_page(found, out / "bench.html")
    if options.json:
        return print_json(
            {"rows": rows(found), "answers": answers(found), "figures": machine_independent(found)}
        )
    print(", ".join(f"{name}: {text}" for name, text in list(found.machine.items())[:5]))
    print_table(rows(found))
    print(ERROR_NOTE)
    for growth in found.growths:
        print(f"{growth.what} grows as nodes ^ {growth.exponent:.2f}, up to {int(growth.nodes[-1]):,} nodes")
    print_table(answers(found))
    print(ANSWERS_NOTE)
    print(f"report: {out / 'bench.html'}")
    return OK


def bodies_to_measure(study: str | None, surface: Path | None) -> dict[str, tuple[str, Path | None]]:
    """Name of each body of a benchmark -> its study, and the file that replaces the study's own body."""
    if study:
        return {Path(study).stem: (study, surface)}
    bodies: dict[str, tuple[str, Path | None]] = {
        "sphere": ("quickstart", None),
        "organ": ("accuracy-organ", None),
    }
    if surface is not None:
        bodies[surface.name if surface.stem in bodies else surface.stem] = ("accuracy-organ", surface)
    return bodies


def _load(options: argparse.Namespace) -> tuple[Study, Path]:
    from ..study.config import load_study

    path = Path(options.study)
    if path.suffix != ".toml" and not path.exists():
        shipped = SHIPPED / f"{options.study}.toml"
        if not shipped.exists() or shipped.parent != SHIPPED:
            known = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.toml")))
            raise UsageError(
                f"no study file {options.study!r} and no shipped study of that name; shipped are: {known}"
            )
        path = shipped
    return load_study(path, allow_outside=options.allow_outside, surface=options.surface), path


def _make_plan(
    study: Study,
    options: argparse.Namespace,
    *,
    directory: Path | None = None,
    command: tuple[str, ...] = (),
) -> Plan:
    """The plan of all cases; in --out or results/runs/NAME by default."""
    from ..graph.plan import make_plan
    from ..study.config import expand

    directory = directory or vars(options).get("out")
    if directory is None:
        directory = results_directory() / "runs" / study.study.name
    cache = results_directory() / "cache"
    command = command or _command("run", options)
    fresh = vars(options).get("fresh", False)
    return make_plan(study, expand(study), directory, cache, command, fresh=fresh)


def _require_own(plan: Plan, options: argparse.Namespace) -> None:
    """Raises UsageError where the directory holds no run, or that of another surface file of the same name."""
    from ..graph.explain import surfaces
    from ..store.hdf5 import StoreError
    from ..store.run_directory import read_plan, refuse_foreign

    refuse_foreign(plan.directory)
    if options.surface is None or options.out is not None:
        return
    try:
        there = read_plan(plan.directory)
    except StoreError:
        return
    if (
        "--surface" in there.get("command", [])
        and not surfaces(plan).keys() & there.get("surfaces", {}).keys()
    ):
        raise UsageError(
            f"{plan.directory} has the results of another surface of that name; give those of {options.surface} "
            "a directory of their own by --out"
        )


def _command(verb: str, options: argparse.Namespace) -> tuple[str, ...]:
    """What to type to get the same results again: the words of this command that decide them, without folders."""
    given = vars(options)
    words = [verb, _name(given["study"])]
    for key in ("surface", "out"):
        if given.get(key):
            words += [f"--{key}", _name(given[key])]
    if given["allow_outside"]:
        words.append("--allow-outside")
    return tuple(words)


def _name(path: str | Path) -> str:
    """The last name of a path: the others may be a patient's."""
    return Path(path).name or str(path)


def _run_for_fit(plan: Plan, path: Path, options: argparse.Namespace) -> tuple[Plan, Run]:
    """Run what is missing of a study that parameters are fitted on, and say what failed."""
    from ..graph.run import Options, count_of_events, run_plan
    from ..report.rebuild import rebuild

    with Progress(count_of_events(plan), plan.study.study.name, quiet=options.json) as progress:
        how = Options(jobs=options.jobs or usable_processors())
        run, _ = run_plan(plan, path.read_text(), how, progress.show, rebuild)
    complain_of_failures(run)
    return plan, run
