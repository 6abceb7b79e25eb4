"""A scene as files that other programs read: mesh, tables, and scenes for SOFA, FEBio and MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..body.mesh_file import write_body_msh, write_body_vtu
from ..machine.files import write_atomically
from . import as_feb, as_mjcf, as_sofa
from .as_tables import forces_csv, left_out, scene_json, supports_csv
from .handout import Handout, cannot_express

Writer = Callable[[Handout], str]
TABLES: dict[str, Writer] = {
    "scene.json": scene_json,
    "supports.csv": supports_csv,
    "forces.csv": forces_csv,
}
SCENES: dict[str, tuple[str, frozenset[str], Writer]] = {  # file -> program, extras that it takes, writer
    "scene_sofa.py": (as_sofa.NAME, as_sofa.TAKES, as_sofa.sofa),
    "scene.feb": (as_feb.NAME, as_feb.TAKES, as_feb.feb),
    "scene_mujoco.xml": (as_mjcf.NAME, as_mjcf.TAKES, as_mjcf.mjcf),
}


def write_scene(body: Handout, out: Path) -> tuple[list[str], list[str]]:
    """Write a scene into a directory. Gives the files' names, and a line for each that is not there. OSError."""
    out.mkdir(parents=True, exist_ok=True)
    mesh = body.mesh
    on_facets = {name: np.all(mask[mesh.triangles], axis=1) for name, mask in body.scene.regions.items()}
    numbers = body.surface_number
    fields = {
        name: (mask[numbers] & (numbers >= 0)).astype(float) for name, mask in body.scene.regions.items()
    }
    fields = {f"region.{name}": values for name, values in fields.items()}
    fields |= {"surface_node": numbers.astype(float), "held": body.held.astype(float)}
    fields |= {"prescribed": body.displacement, "force": body.force}
    write_body_vtu(out / "mesh.vtu", mesh, fields, body.facet_pressure)
    write_body_msh(out / "mesh.msh", mesh, on_facets)
    why_not = {name: cannot_express(body, takes) for name, (_, takes, _) in SCENES.items()}
    texts = TABLES | {name: write for name, (_, _, write) in SCENES.items() if not why_not[name]}
    for name, write in texts.items():
        write_atomically(out / name, write(body).encode())
    refused = [
        f"{name}: not written: {program}: {why_not[name]}"
        for name, (program, _, _) in SCENES.items()
        if why_not[name]
    ]
    refused += [f"scene.json: leaves out {part}" for part in left_out(body)]
    return ["mesh.vtu", "mesh.msh", *texts], refused
