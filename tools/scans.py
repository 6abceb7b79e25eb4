"""Known bodies sag under their weight, are scanned and led back to rest: how far that is from what is known."""

from __future__ import annotations

import dataclasses
import re
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from unittest import mock

import numpy as np
import tomli_w

from fem_reference.finite_strain import FiniteStrainProblem
from tools.evidence import EVIDENCE
from tools.trial import body_file
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.machine import cache_directory
from vdmbench.models import elements, run_model, surface
from vdmbench.models.elements import hyperelastic
from vdmbench.models.scanned import from_scan
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.config import Study, expand, load_study
from vdmbench.study.files import merged
from vdmbench.verdict.formatting import NOTHING

OWN = EVIDENCE["scans"]
PARTS = "bem:nonlinear"
FORMS = {PARTS: surface, "fem": elements}


def scans(arguments: Sequence[str]) -> Iterator[list[str]]:
    """A line for each mesh of each body, or of the bodies and surfaces that are named alone."""
    for name in arguments or OWN["bodies"]:
        about = OWN["bodies"].get(name) or merged(OWN["surface"], {"geometry": {"path": name}})
        if file := about["geometry"].get("path"):
            path = body_file(file) if file in ("cup.stl", "fork.stl") else Path(file).resolve()
            about = merged(about, {"geometry": {"path": f"{path}"}})
        with tempfile.TemporaryDirectory() as folder:
            (path := Path(folder) / "scans.toml").write_text(tomli_w.dumps(merged(OWN["study"], about)))
            studies = [case.study for case in expand(load_study(path))]
        yield from (scans_row(name if name in OWN["bodies"] else Path(name).stem, study) for study in studies)


def scans_row(body: str, study: Study) -> list[str]:
    """Nodes and parts; of parts, and on few nodes of elements, sag, how far the one found is off, what is told."""
    scene = build_scene(study, mesh_from_cache(study.geometry, cache_directory()))
    known, n = run_model(scene, PARTS), len(scene.fixed)
    parts = f"{known.scalars['parts'][0]:.0f}"
    solid = led_back(study, scene, "fem", run_model(scene, "fem")) if n <= OWN["elements"] else 3 * [NOTHING]
    return [body, str(n), parts, *led_back(study, scene, PARTS, known), *solid]


def led_back(study: Study, scene: Scene, form: str, known: ModelResult) -> list[str]:
    """The sag over the body's size, the largest error over its mean square, and what only the scan is told."""
    if not known.status[0].ok:
        return [NOTHING, NOTHING, known.status[0].message.split("; ")[0]]
    mesh, sag = scene.mesh, known.displacement[0]
    moved = np.zeros_like(mesh.points)
    moved[mesh.surface_nodes] = sag
    if form == "fem":  # nodes inside are scanned too
        moved = FiniteStrainProblem(**hyperelastic(scene, 1)).sag(scene.gravity).displacement[0][: len(moved)]
    weighed = merged(study.model_dump(exclude_none=True), {"gravity": {"scanned": True}})
    scan = dataclasses.replace(mesh, points=mesh.points + moved)
    with mock.patch.object(FORMS[form], "from_scan", wraps=from_scan) as met:
        status = run_model(build_scene(Study.model_validate(weighed), scan, scene.regions), form).status[0]
    found, before = (_told(one.message) for one in (status, known.status[0]))
    told = "; ".join(text for words, text in found.items() if words not in before) or "nothing"
    told = re.sub(r"the rest shape is known to \S+ mm, (\S+) %[^;]*", r"\1", told)
    largest = np.linalg.norm(sag, axis=1).max()
    size = f"{100 * largest / np.ptp(mesh.points, axis=0).max():.2g}"
    if not status.ok:
        return [size, NOTHING, told.split("; ")[0]]
    off = 100 * np.linalg.norm(met.call_args.args[2] - sag, axis=1) / largest
    return [size, f"{off.max():.2g} / {np.sqrt((off**2).mean()):.2g}", told]


def _told(message: str) -> dict[str, str]:
    """What a message tells, by its words without their numbers."""
    return {re.sub(r"[\d.]+", "", one): one for one in message.split("; ") if one}
