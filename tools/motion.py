"""Writes what the reference's motion is made of in every shipped study to `docs/evidence/accuracy.md`.

Of each study the reference alone is solved, on the study's own mesh, for its first case: five minutes
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools import marked
from tools.accuracy import DOCUMENT, as_per_cent
from tools.runs import CASES
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.metrics import METRICS, History, full_load_step
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, geometry_of, load_study
from vdmbench.study.registry import is_surface

HEAD = ("study", "rigid", "least along normals")
SHARES = ("rigid_share", "tangential_share")
PART = "motion"


def row_of(path: Path) -> list[str] | None:
    """The study's row; None where its reference is none, or a surface model itself."""
    case = expand(load_study(path))[0].study
    reference = case.study.reference
    if reference is None or is_surface(reference):
        return None
    mesh = build_mesh(geometry_of(case))
    scene = build_scene(case, mesh)
    result = models.run_model(scene, reference)
    step = full_load_step(scene.load_factors)
    history = History(result.displacement[[step]], result.reaction_force[[step]], np.ones(1))
    surface = Surface(mesh.surface_points, mesh.triangles)
    return [path.stem, *(as_per_cent(METRICS[name].function(surface, history)[0]) for name in SHARES)]


def main() -> None:
    """Solve all of them and write the table."""
    rows = filter(None, map(row_of, sorted(CASES.glob("*.toml"))))
    marked.show(DOCUMENT, PART, marked.table(HEAD, rows))


if __name__ == "__main__":
    main()
