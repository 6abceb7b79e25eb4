"""`vdmbench export`: a run's tables, figures and meshes as files of their own."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine.streams import harmless
from .argument_kinds import directory, run_directory
from .output import OK, UsageError, print_json

SUMMARY = "write a run's tables (CSV, LaTeX), figures (SVG) and meshes (VTU)"
MORE = (
    "Write a run's tables (CSV, LaTeX), figures (SVG) and a mesh per case (VTU) with what each model answers at "
    "full load. Lengths in a mesh are in metres; those of a body from a file are in its own unit, so that the "
    "mesh lies on the scan."
)


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("directory", type=run_directory, metavar="DIR", help="run directory")
    parser.add_argument(
        "--to", type=directory, required=True, metavar="OUT", help="a new or an empty directory"
    )


def run(options: argparse.Namespace) -> int:
    """Write the files, and say which."""
    from ..body.mesh_file import write_surface_vtu
    from ..report.case_surface import mesh_names, surface_fields, unit_of
    from ..report.export import exported
    from ..store.cases import read_run

    out: Path = options.to
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: is not an empty directory; name a new one")
    run = read_run(options.directory)
    if not run.cases:
        raise UsageError(f"{options.directory}: no case is finished, so there is nothing to export")
    names = []
    for name, text in exported(run):
        path = out / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", newline="\n")
        names.append(name)
    (out / "meshes").mkdir(parents=True, exist_ok=True)
    for name, case in mesh_names(run.cases):
        points, fields = surface_fields(case)
        write_surface_vtu(out / name, points, case.triangles, fields)
        names.append(name)
    if options.json:
        return print_json({"directory": str(out), "files": names})
    for name in names:
        print(out / name)
    print(f"lengths in meshes/ in {', '.join(sorted({harmless(unit_of(case)) for case in run.cases}))}")
    return OK
