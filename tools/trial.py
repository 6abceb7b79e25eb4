"""Bodies in parts on trial: slender, thick, thin-walled, forked and hollow ones, and lumps, beside elements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import tomli_w

from tools.documents import ROOT, RUNS, finished, show, table
from tools.evidence import EVIDENCE, MEASURES, kept, slashed
from vdmbench.measures.case import CaseResult
from vdmbench.measures.frame import reference_bar, series
from vdmbench.store.cases import read_run

OWN = EVIDENCE["parts"]
FORM = OWN["study"]["study"]["models"][0]
HEAD = ["body", "load", "nodes", "moves", "parts", "error", "±", "told"]


def _write(path: Path) -> None:
    """The body of this name [m]: a cup, its rim at x = 60 mm, or a fork of two prongs along x."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 4.0)
        occ = gmsh.model.occ
        if path.stem == "cup":
            occ.cut(
                [(3, occ.addCylinder(0, 0, 0, 60, 0, 0, 25))], [(3, occ.addCylinder(12, 0, 0, 60, 0, 0, 15))]
            )
        else:
            prongs = [(3, occ.addCylinder(35, 0, 0, 50, y, 0, 8)) for y in (-30, 30)]
            occ.fuse([(3, occ.addCylinder(0, 0, 0, 42, 0, 0, 10))], prongs)
        occ.dilate(occ.getEntities(3), 0, 0, 0, 1e-3, 1e-3, 1e-3)
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.004)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def study_text(body: str, load: str) -> str:
    """A load on a body as a study file."""
    about = OWN["bodies"][body]
    geometry, contact = dict(about["geometry"]), load == "contact"
    if "path" in geometry:
        geometry |= {"shape": "file", "coordinates": "file"}
    regions = {"base": about["regions"]["base"]}
    regions |= {"patch": about.get("patch", OWN["patch"])} if contact else {"tip": about["regions"]["tip"]}
    acting = [dict(one) for one in OWN["loads"][load]]
    if contact and "contact" in about:
        acting[0]["pressure"] = about["contact"]
    weight = {"gravity": {"acceleration": [0, 0, -9.81]}} if load == "weight" else {}
    return tomli_w.dumps(
        {
            "study": {"name": f"{body}-{load}", **OWN["study"]["study"]},
            "geometry": geometry,
            "tissue": about["tissue"] | OWN["study"]["tissue"],
            "regions": regions,
            "constraints": [{"kind": "fixed", "region": "base"}, *acting],
            "uncertainty": OWN["study"]["uncertainty"],
            **weight,
        }
    )


def _run(name: str, text: str) -> list[CaseResult]:
    """Its cases; one whose reference ends on the way is compared where that ended."""
    directory = RUNS / "parts"
    directory.mkdir(parents=True, exist_ok=True)
    for file in ("cup.stl", "fork.stl"):
        if not (directory / file).exists():
            _write(directory / file)
    (directory / f"{name}.toml").write_text(text)
    finished("run", f"{name}.toml", "--out", name, "--jobs", "1", cwd=directory, codes=(0, 3))
    return read_run(directory / name).cases


def row(body: str, load: str, case: CaseResult, form: str = FORM) -> list[str]:
    """A line of the table, at the largest load that elements and parts both reached."""
    result = case.models[form]
    at = max(step for step in range(case.reached + 1) if result.status[step].ok)
    moved = np.linalg.norm(case.models[str(case.reference)].displacement[at], axis=1).max()
    parts = result.scalars["parts"][at] if "parts" in result.scalars else 1.0
    status = result.status[case.reached]
    told = status.message if status.ok else f"{status.code}: {status.message}"
    errors = [float(values[at]) for m in MEASURES if (values := series(case, form, m)) is not None]
    own = [reference_bar(case, m) for m in MEASURES]
    return [
        body, load, str(len(case.points)), f"{1e3 * moved:.3g} mm", f"{parts:.0f}", slashed(errors), slashed(own),
        told or "nothing",
    ]  # fmt: skip


def rows(surface: Path | None) -> Iterator[list[str]]:
    """All lines that are measured anew."""
    for body in OWN["bodies"]:
        for load in OWN["loads"]:
            if not (load == "weight" and body == "bladder"):
                (case,) = _run(f"{body}-{load}", study_text(body, load))
                yield row(body, load, case)
    if surface is not None:
        text: dict[str, Any] = OWN["liver"] | {"study": {"name": "liver", **OWN["study"]["study"]}}
        text["geometry"] = {**text["geometry"], "path": f"liver{surface.suffix}"}
        (RUNS / "parts" / f"liver{surface.suffix}").write_bytes(surface.read_bytes())
        yield from (row("liver, 4 kPa", "weight", case) for case in _run("liver", tomli_w.dumps(text)))
    for case in _run("lumps", tomli_w.dumps(OWN["lumps"])):
        (lump,) = case.study.inclusions or ()
        ratio = lump.youngs_modulus / case.study.tissue.youngs_modulus
        yield row(f"lump, {ratio:g} times as stiff", "contact", case, "bem")


def summed_up(lines: Sequence[Sequence[str]]) -> str:
    """What the table comes to."""
    off = [line for line in lines if not max(map(float, line[5].split(" / "))) < 100 * OWN["limit"]]
    silent = sum(line[-1] == "nothing" for line in off)
    return (
        f"{len(lines) - len(off)} of {len(lines)} are within {100 * OWN['limit']:.0f} % in both errors. "
        f"Of the other {len(off)} the model gives {silent} without a reservation.\n"
    )


def main(_: str, arguments: Sequence[str]) -> None:
    """Run all and write the page's table."""
    surface = Path(arguments[0]).resolve() if arguments else None
    lines = kept(OWN["all_rows"], HEAD, list(rows(surface)))
    document = ROOT / OWN["document"]
    show(document, OWN["part"], table(HEAD, lines))
    show(document, f"{OWN['part']}-sum", summed_up(lines))
