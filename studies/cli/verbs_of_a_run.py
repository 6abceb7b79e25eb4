"""Uses of stored results: `report gate accept compare export`; and a study's scene for other programs."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

from ..machine import whole_directory, write_atomically
from ..study.errors import InputError, plural
from .arguments import (
    BASELINE,
    CASE,
    RUN,
    RUNS,
    STUDY_READS,
    flag,
    option,
    output,
    run_directory,
    study_argument,
    verb,
)
from .output import (
    FAILED,
    NOTHING_COMPARED,
    OK,
    REGRESSED,
    WIDTH,
    answer,
    complain,
    complain_of_failures,
    folded,
    print_json,
    print_run,
    print_table,
    tell,
)
from .studies import baseline_of, numbered_case, plan_of, run_missing

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..gate import Baseline, Finding
    from ..measures.foreign import Foreign

MOST = len(ascii_uppercase)  # runs, each a letter
HEADLINE = {  # metrics that are always shown; others only if they changed
    "relative_l2_displacement_error": "displacement error",
    "relative_l2_deformation_error": "error in change of shape",
    "max_nodal_error": "largest difference at a node",
    "volume_drift": "volume drift",
}
_MARKS = {"worse": "worse", "newly failing": "fails", "not comparable": "?", "missing": "gone"}
_MARKS |= {"better": "better", "newly passing": "passes", "new": "new"}


@verb(
    "report",
    "rebuild the report from the stored results",
    RUN,
    output("--picture", "FILE", "write a PNG of reference, model and difference too"),
)
def report_run(options: argparse.Namespace) -> int:
    """Rebuild the report of a directory."""
    from ..report.rebuild import rebuild

    run, report = rebuild(run_directory(options.directory))
    if options.picture:
        from ..report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, Path(options.directory), report, options.json)


@verb(
    "gate",
    "hold a run's accuracy against its baseline",
    RUN,
    BASELINE,
    flag("--allow-missing", "compare what is there; by default what is missing or not comparable is 6"),
    output("--junit", "FILE", "write JUnit XML too"),
    output("--markdown", "FILE", "write a summary in Markdown too"),
)
def gate_run(options: argparse.Namespace) -> int:
    """Compare a run with its baseline."""
    from .. import gate
    from ..store.cases import read_run

    run = read_run(run_directory(options.directory))
    study = run.study.study.name
    path = baseline_of(options, study)
    # a missing first baseline is not an error of the command; whoever collects the files finds them
    missing = gate.no_baseline(path) if options.baseline is None and not path.exists() else ""
    baseline = None if missing else gate.read_baseline(path)
    none = gate.Finding(gate.NOT_COMPARABLE, "baseline", "", "", why=missing)
    findings = gate.compare(run, baseline) if baseline else [none]
    about = f"Baseline of {baseline.date}: {baseline.reason}" if baseline else "There is no baseline."
    if options.junit:
        write_atomically(options.junit, gate.junit(study, findings, allow_missing=options.allow_missing))
    if options.markdown:
        write_atomically(options.markdown, gate.markdown(study, about, findings).encode("utf-8", "replace"))
    if options.json:
        print_json({"study": study, "counts": gate.counts(findings), "findings": [vars(f) for f in findings]})
    elif baseline:
        for finding in findings:
            if finding.outcome != gate.SAME:
                print(gate.describe(finding))
        for told in dict.fromkeys(
            f"{f.model}: {f.why}" for f in findings if f.outcome == gate.SAME and f.why
        ):
            print(f"unchanged: {told}")
        print(f"{study}: {gate.summary(findings)} (baseline of {baseline.date}: {baseline.reason})")
    if gate.regressed(findings):
        return REGRESSED
    why = f"nothing was compared: {missing}" if missing else ""
    why = why or gate.why_not_passed(findings, allow_missing=options.allow_missing)
    return complain(why, NOTHING_COMPARED) if why else OK


@verb(
    "accept",
    "make a run's accuracy the baseline",
    RUN,
    BASELINE,
    option("--reason", required=True, metavar="TEXT", help="why these numbers are right"),
)
def accept_run(options: argparse.Namespace) -> int:
    """Write a run as the baseline."""
    from ..gate import accept
    from ..store.cases import read_run

    run = read_run(run_directory(options.directory))
    path = baseline_of(options, run.study.study.name)
    baseline = accept(run, path, options.reason)
    told = {"baseline": str(path), "cases": len(baseline.cases), "reason": baseline.reason}
    return answer(options, told, f"accepted {plural(len(baseline.cases), 'case')}: {path}")


@verb(
    "compare",
    "put runs side by side, each held against the first; or another program's result beside a study's models",
    option(
        "directories",
        metavar="DIR",
        nargs="+",
        help="run directories, two or more; the first is what the others are held against; with --result a STUDY",
    ),
    option(
        "--result",
        type=Path,
        metavar="FILE",
        help="what another program computed: VTU, VTK, or CSV by node or by place; displacements or positions",
    ),
    option("--name", metavar="NAME", help="what the program is called (default: the file's name)"),
    option("--array", metavar="FIELD", help="field of a VTU or VTK file (default: displacement)"),
    *RUNS,
    *STUDY_READS,
)
def compare_runs(options: argparse.Namespace) -> int:
    """Put runs side by side, each held against the first.

    With --result FILE: judge what another program computed for STUDY, at its largest load, like a model of it.
    """
    if options.result is not None:
        return _judge(options)
    return _side_by_side(options)


def _side_by_side(options: argparse.Namespace) -> int:
    """Print what is worse, better, newly failing and not comparable."""
    from ..gate import baseline_of, compare
    from ..store.cases import read_run

    directories = {os.path.normpath(path): path for path in map(run_directory, options.directories)}
    if not 2 <= len(directories) <= MOST:
        raise InputError(f"give 2 to {MOST} different run directories, not {len(directories)}")
    first, *others = [read_run(path) for path in directories.values()]
    held = [baseline_of(run) for run in (first, *others)]
    findings = [compare(run, held[0], "A") for run in others]
    found = _rows(held, findings)
    if options.json:
        told = [[vars(finding) for finding in each] for each in findings]
        return print_json({"runs": list(directories), "rows": found, "findings": told})
    _print(list(directories), found, findings)
    return OK


def _rows(held: Sequence[Baseline], findings: Sequence[Sequence[Finding]]) -> list[dict[str, Any]]:
    """For each metric and model: the worst value over each run's cases, its outcome and the reference's bar there.

    NaN for what there is not.
    """
    from ..gate import OUTCOMES, OWN, SAME
    from ..measures.uncertainty import SIGNED

    worst: dict[tuple[str, str], list[float]] = {}
    bars: dict[tuple[str, str], list[float]] = {}
    for k, one in enumerate(held):
        for case in one.cases.values():
            reference = case.values.get(case.reference or "", {})
            for model, found in case.values.items():
                for metric, value in found.items():
                    own = worst.setdefault((metric, model), [math.nan] * len(held))
                    bar = bars.setdefault((metric, model), [math.nan] * len(held))
                    if value is not None and not abs(own[k]) >= abs(value):
                        known = None if metric in SIGNED else reference.get(OWN + metric)
                        own[k], bar[k] = value, math.nan if known is None else known
    units = {name: measure.unit for one in held for name, measure in one.metrics.items()}
    rows = []
    for (metric, model), values in worst.items():
        said = [
            {f.outcome for f in each if f.model in ("", model) and f.metric in ("", metric)}
            for each in findings
        ]
        outcomes = [next((one for one in OUTCOMES if one in each), SAME) for each in said]
        unit, all_outcomes = units[metric.removeprefix(OWN)], ["first", *outcomes]
        rows.append(
            {"metric": metric, "model": model, "unit": unit, "values": values}
            | {"bars": bars[metric, model], "outcomes": all_outcomes}
        )
    return rows


def _print(
    names: Sequence[str], found: Sequence[Mapping[str, Any]], findings: Sequence[Sequence[Finding]]
) -> None:
    """A block for each metric of `HEADLINE`, and for changed ones: a row for each model, a column for each run."""
    from ..gate import summary
    from ..verdict.formatting import of_unit

    for letter, name in zip(ascii_uppercase, names, strict=False):
        print(f"{letter}  {name}"[:WIDTH])
    print("at full load, the worst of all cases; held against A case by case")
    news = {"worse", "better", "newly failing", "newly passing"}
    changed = {row["metric"] for row in found if news & {*row["outcomes"]}}
    for metric in dict.fromkeys(row["metric"] for row in found if row["metric"] in {*HEADLINE, *changed}):
        print(f"\n{HEADLINE.get(metric, metric.replace('_', ' '))}")
        rows = []
        for row in (row for row in found if row["metric"] == metric):
            cells = zip(ascii_uppercase, row["values"], row["bars"], row["outcomes"], strict=False)
            told = {
                letter: f"{of_unit(value, row['unit'], bar)} {_MARKS.get(outcome, '')}".rstrip()
                for letter, value, bar, outcome in cells
            }
            rows.append({"model": row["model"], **told})
        print_table(rows)
    print()
    for letter, each in zip(ascii_uppercase[1:], findings, strict=False):
        print(f"{letter} against A: {summary(each)}")
        why = list(dict.fromkeys(finding.why for finding in each if finding.why))
        for reason in [*why[:3], *([f"and {len(why) - 3} more; all by --json"] if len(why) > 3 else [])]:
            print(folded(reason, "   "))


def _judge(options: argparse.Namespace) -> int:
    """Run what is missing of the study, and put the file's result beside its models."""
    from ..body.mesh_cache import mesh_from_cache
    from ..measures.foreign import read_foreign
    from ..report.page import write_report
    from ..study.kinds import safe_name
    from ..work.judge_foreign import judged

    if len(options.directories) != 1:
        raise InputError("with --result give one study")
    options.study = options.directories[0]
    name = options.name or options.result.stem
    try:
        safe_name(name)
    except ValueError as error:
        raise InputError(f"--name: {error}") from None
    plan = plan_of(options)
    if len(plan.cases) > 1:
        raise InputError("--result judges a study of one case; leave [sweep] out")
    case = plan.cases[0]
    if name in plan.study.study.models:
        raise InputError(f"--name: {name} is a model of the study; give the program another name")
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache)
    foreign = read_foreign(options.result, mesh, options.array)
    found, _ = run_missing(plan, options)
    if not found.cases:
        complain_of_failures(found)
        return FAILED
    found = judged(found, case.study, mesh, name, foreign)
    report = plan.directory / f"report-{name}.html"
    write_report(found, report)
    if not options.json:
        tell(_mapping(foreign))
    return print_run(found, plan.directory, report, options.json)


def _mapping(foreign: Foreign) -> str:
    from ..verdict.formatting import percent, quantity

    if foreign.exact == 1.0:
        return "every surface node has its own value in the file"
    return (
        f"{percent(foreign.exact)} of the surface nodes have their own value; the others take that of the nearest "
        f"point, at most {quantity(foreign.distance, 'm', 2)} away, which may cost {quantity(foreign.bend, 'm', 2)}"
    )


@verb(
    "export",
    "write a run's tables, figures and meshes, or a study's scene for other programs",
    study_argument(", or a run directory"),
    *STUDY_READS,
    output("--to", "OUT", "a new or an empty directory", required=True),
    CASE,
)
def export_files(options: argparse.Namespace) -> int:
    """Of a run directory: its tables (CSV), figures (SVG) and a mesh per case (VTU) with what models answer.

    Answers are those at full load. Lengths in a mesh are in metres, those of a body from a file in its own unit, so
    that the mesh lies on the scan. Of a study: one case at its largest load, as a mesh with regions (VTU, MSH),
    supports and loads (JSON), and scenes for SOFA, FEBio and MuJoCo, all in metres, newtons and pascals.
    """
    out: Path = options.to
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is not an empty directory; name a new one")
    if Path(options.study).is_dir():
        return _export_run(options, out)
    return _export_scene(options, out)


def _export_run(options: argparse.Namespace, out: Path) -> int:
    from ..body.mesh_file import write_surface_vtu
    from ..report.export import exported, mesh_names, surface_fields, unit_of
    from ..store.cases import read_run

    path = run_directory(options.study)
    run = read_run(path)
    if not run.cases:
        raise InputError(f"{path}: no case is finished, so there is nothing to export")
    names = []
    with whole_directory(out) as begun:
        for name, text in exported(run):
            write_atomically(begun / name, text.encode())
            names.append(name)
        (begun / "meshes").mkdir(exist_ok=True)
        for name, case in mesh_names(run.cases):
            points, fields = surface_fields(case)
            write_surface_vtu(begun / name, points, case.triangles, fields)
            names.append(name)
    unit = ", ".join(sorted({unit_of(case) for case in run.cases}))
    return _told(options, out, names, [f"lengths in meshes/ in {unit}"])


def _export_scene(options: argparse.Namespace, out: Path) -> int:
    import numpy as np

    from ..body.mesh_cache import mesh_from_cache
    from ..measures.metrics import full_load_step
    from ..scene.export import Handout, write_scene
    from ..scene.scene import build_scene

    plan = plan_of(options)
    case, study = numbered_case(plan, options.case), plan.study.study
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache)
    history = case.study.load.history
    factor = history[full_load_step(np.array(history))]
    name = f"{study.name}: {case.label}" if case.label else study.name
    scene = build_scene(case.study, mesh)
    body = Handout(scene, scene.load(factor), " ".join(name.split()), factor)
    with whole_directory(out) as begun:
        names, refused = write_scene(body, begun)
    return _told(options, out, names, ["lengths in metres, forces in newtons", *refused])


def _told(options: argparse.Namespace, out: Path, names: list[str], lines: list[str]) -> int:
    told = {"directory": str(out), "files": names, "notes": lines}
    return answer(options, told, *(str(out / name) for name in names), *lines)
