"""`vdmbench compare`: runs side by side, or another program's result beside a study's models."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
from string import ascii_uppercase
from typing import TYPE_CHECKING, Any

from .arguments import RUNS, STUDY_READS, given_run_directory, option, verb
from .output import (
    FAILED,
    OK,
    WIDTH,
    UsageError,
    complain_of_failures,
    folded,
    print_json,
    print_run,
    print_table,
    tell,
)
from .studies import load, make_plan, only_case, require_own, run_missing

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ..gate import Baseline, Finding
    from ..measures.foreign import Foreign

MOST = len(ascii_uppercase)  # runs, each a letter
HEADLINE = {  # shown whether it has changed or not; of the others what has
    "relative_l2_displacement_error": "displacement error",
    "relative_l2_deformation_error": "error in change of shape",
    "max_nodal_error": "largest difference at a node",
    "volume_drift": "volume drift",
}
_MARKS = {"worse": "worse", "newly failing": "fails", "not comparable": "?", "missing": "gone"}
_MARKS |= {"better": "better", "newly passing": "passes", "new": "new"}


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

    directories = {os.path.normpath(path): path for path in map(given_run_directory, options.directories)}
    if not 2 <= len(directories) <= MOST:
        raise UsageError(f"give 2 to {MOST} different run directories, not {len(directories)}")
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
    """For each metric and model: the worst value of each run's cases, NaN for none, and what became of it."""
    from ..gate import OUTCOMES, OWN, SAME

    worst: dict[tuple[str, str], list[float]] = {}
    for place, one in enumerate(held):
        for case in one.cases.values():
            for model, found in case.values.items():
                for metric, value in found.items():
                    own = worst.setdefault((metric, model), [math.nan] * len(held))
                    if value is not None and not abs(own[place]) >= abs(value):
                        own[place] = value
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
            {"metric": metric, "model": model, "unit": unit, "values": values, "outcomes": all_outcomes}
        )
    return rows


def _print(
    names: Sequence[str], found: Sequence[Mapping[str, Any]], findings: Sequence[Sequence[Finding]]
) -> None:
    """A block for each metric of `HEADLINE`, and others that have changed: a row for each model, a column a run."""
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
            cells = zip(ascii_uppercase, row["values"], row["outcomes"], strict=False)
            told = {
                letter: f"{of_unit(value, row['unit'])} {_MARKS.get(outcome, '')}".rstrip()
                for letter, value, outcome in cells
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
        raise UsageError("with --result give one study")
    options.study = options.directories[0]
    name = options.name or options.result.stem
    try:
        safe_name(name)
    except ValueError as error:
        raise UsageError(f"--name: {error}") from None
    plan = make_plan(load(options), options)
    require_own(plan, options)
    case = only_case(plan, "--result judges")
    if name in plan.study.study.models:
        raise UsageError(f"--name: {name} is a model of the study; give the program another name")
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
