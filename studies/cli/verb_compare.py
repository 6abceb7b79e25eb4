"""`vdmbench compare`: runs side by side, or another program's result beside a study's models."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..machine.streams import harmless
from .argument_kinds import file_arguments, given_run_directory, run_arguments
from .output import FAILED, OK, UsageError, complain_of_failures, print_json, print_run, tell
from .studies import load, make_plan, only_case, require_own, run_missing

if TYPE_CHECKING:
    from ..measures.foreign import Foreign

SUMMARY = (
    "put runs side by side, each held against the first; or another program's result beside a study's models"
)
MORE = (
    "Put runs side by side, each held against the first. With --result FILE: judge what another program computed "
    "for STUDY, at its largest load, like a model of it."
)
MOST = 26  # runs, each a letter


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument(
        "directories",
        metavar="DIR",
        nargs="+",
        help="run directories, two or more; the first is what the others are held against; with --result a STUDY",
    )
    parser.add_argument(
        "--result",
        type=Path,
        metavar="FILE",
        help="what another program computed: VTU, VTK, or CSV by node or by place; displacements or positions",
    )
    parser.add_argument(
        "--name", metavar="NAME", help="what the program is called (default: the file's name)"
    )
    parser.add_argument("--array", metavar="FIELD", help="field of a VTU or VTK file (default: displacement)")
    run_arguments(parser)
    file_arguments(parser)


def run(options: argparse.Namespace) -> int:
    """Print models by metrics by runs, or judge another program's result."""
    if options.result is not None:
        return _judge(options)
    return _side_by_side(options)


def _side_by_side(options: argparse.Namespace) -> int:
    """Print what is worse, better, newly failing and not comparable."""
    from ..gate import as_text, side_by_side
    from ..store.cases import read_run

    paths = map(given_run_directory, options.directories)
    directories = {os.path.normpath(path): path for path in paths}
    if not 2 <= len(directories) <= MOST:
        raise UsageError(f"give 2 to {MOST} different run directories, not {len(directories)}")
    found = side_by_side({name: read_run(path) for name, path in directories.items()})
    if not options.json:
        for line in as_text(found):
            print(harmless(line))
        return OK
    return print_json(
        {
            "runs": list(found.names),
            "rows": [
                {
                    "metric": row.metric,
                    "model": row.model,
                    "unit": row.unit,
                    "values": [None if math.isnan(value) else value for value in row.values],
                    "outcomes": list(row.outcomes),
                }
                for row in found.rows
            ],
            "findings": [[vars(finding) for finding in findings] for findings in found.findings],
        }
    )


def _judge(options: argparse.Namespace) -> int:
    """Run what is missing of the study, and put the file's result beside its models."""
    from ..body.mesh_cache import mesh_from_cache
    from ..evidence.judge_foreign import judged
    from ..measures.foreign import read_foreign
    from ..report.page import write_report
    from ..study.kinds import safe_name

    if len(options.directories) != 1:
        raise UsageError("with --result give one study")
    options.study = options.directories[0]
    name = options.name or options.result.stem
    try:
        safe_name(name)
    except ValueError as error:
        raise UsageError(f"--name: {error}") from None
    study, path = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    case = only_case(plan, "--result judges")
    if name in plan.study.study.models:
        raise UsageError(f"--name: {name} is a model of the study; give the program another name")
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache)
    foreign = read_foreign(options.result, mesh, options.array)
    found, _ = run_missing(plan, path.read_text(), options)
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
