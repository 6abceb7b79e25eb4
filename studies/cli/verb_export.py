"""`vdmbench export`: a run's tables, figures and meshes, or a study's scene, as files of their own."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine import whole_directory, write_atomically
from .arguments import CASE, STUDY_READS, given_run_directory, option, place, study_argument, verb
from .output import OK, UsageError, print_json
from .studies import load, make_plan, numbered_case


@verb(
    "export",
    "write a run's tables, figures and meshes, or a study's scene for other programs",
    study_argument(", or a run directory"),
    *STUDY_READS,
    option("--to", type=place, required=True, metavar="OUT", help="a new or an empty directory"),
    CASE,
)
def export_files(options: argparse.Namespace) -> int:
    """Of a run directory: its tables (CSV, LaTeX), figures (SVG) and a mesh per case (VTU) with what models answer.

    Answers are those at full load. Lengths in a mesh are in metres, those of a body from a file in its own unit, so
    that the mesh lies on the scan. Of a study: one case at its largest load, as a mesh with regions (VTU, MSH),
    supports and loads (JSON), and scenes for SOFA, FEBio and MuJoCo, all in metres, newtons and pascals.
    """
    out: Path = options.to
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out}: is not an empty directory; name a new one")
    if Path(options.study).is_dir():
        return _export_run(options, out)
    return _export_scene(options, out)


def _export_run(options: argparse.Namespace, out: Path) -> int:
    from ..body.mesh_file import write_surface_vtu
    from ..report.case_surface import mesh_names, surface_fields, unit_of
    from ..report.export import exported
    from ..store.cases import read_run

    path = given_run_directory(options.study)
    run = read_run(path)
    if not run.cases:
        raise UsageError(f"{path}: no case is finished, so there is nothing to export")
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

    study = load(options)
    plan = make_plan(study, options)
    case = numbered_case(plan, options.case)
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache)
    history = case.study.load.history
    factor = history[full_load_step(np.array(history))]
    name = f"{study.study.name}: {case.label}" if case.label else study.study.name
    scene = build_scene(case.study, mesh)
    body = Handout(scene, scene.load(factor), " ".join(name.split()), factor)
    with whole_directory(out) as begun:
        names, refused = write_scene(body, begun)
    return _told(options, out, names, ["lengths in metres, forces in newtons", *refused])


def _told(options: argparse.Namespace, out: Path, names: list[str], lines: list[str]) -> int:
    if options.json:
        return print_json({"directory": str(out), "files": names, "notes": lines})
    for name in names:
        print(out / name)
    for line in lines:
        print(line)
    return OK
