"""A scene's tissue, supports and loads as JSON and CSV, for a program that has no scene of its own here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

import numpy as np

from solver_common.arrays import Array, Mask

from ..machine.files import json_text
from .handout import Handout

_XYZ = "xyz"
TAKES = frozenset({"dead forces", "normal springs", "full springs", "inclusions"})  # of the extras of a study


def scene_json(body: Handout) -> str:
    """Tissue, weight, supports, loads and regions; points are numbers of those in mesh.vtu, from 0."""
    pressed = np.flatnonzero(body.facet_pressure)
    loaded, held = np.flatnonzero(body.force.any(axis=1)), np.flatnonzero(body.held)
    surface = body.mesh.surface_nodes
    return json_text(
        {
            "name": body.name,
            "units": {"length": "m", "force": "N", "stress": "Pa", "density": "kg/m^3", "stiffness": "Pa/m"},
            "mesh": "mesh.vtu",
            "tissue": {
                "youngs_modulus": body.tissue.youngs_modulus,
                "poisson_ratio": body.tissue.poisson_ratio,
                "density": body.tissue.density,
            },
            "gravity": body.load.gravity,
            "load_factor": body.load_factor,
            "held": {"points": held, "displacement": body.displacement[held]},
            "forces": {"points": loaded, "force": body.force[loaded]},
            "pressures": {
                "facets": surface[body.mesh.triangles[pressed]],
                "pressure": body.facet_pressure[pressed],
            },
            "springs": [
                {
                    "facets": surface[body.mesh.triangles[part.facets]],
                    "stiffness": part.stiffness,
                    "direction": part.direction,
                }
                for part in body.scene.springs
            ],
            "inclusions": [
                {
                    "name": part.declared.name,
                    "tetrahedra": np.flatnonzero(part.inside),
                    "youngs_modulus": part.declared.youngs_modulus,
                    "poisson_ratio": part.declared.poisson_ratio,  # null: the tissue's
                }
                for part in body.scene.inclusions
            ],
            "left_out": left_out(body),
            "surface_points": surface,
            "regions": {name: surface[mask] for name, mask in body.scene.regions.items()},
        }
    )


def left_out(body: Handout) -> list[str]:
    """What the tables have no words for."""
    return [*sorted(set(body.scene.extras) - TAKES), *(["fibres"] if body.scene.anisotropy else [])]


def supports_csv(body: Handout) -> str:
    """The held points and where they go."""
    return _table(body, body.held, "displacement", "m", body.displacement)


def forces_csv(body: Handout) -> str:
    """The loaded points and their forces, without the weight."""
    return _table(body, np.any(body.force, axis=1), "force", "N", body.force)


def _table(body: Handout, mask: Mask, what: str, unit: str, values: Array) -> str:
    """Rows by point; `node` counts the surface nodes, as in a file for `compare --result`."""
    head = ["point", "node", *(f"{axis} [m]" for axis in _XYZ), *(f"{what}_{axis} [{unit}]" for axis in _XYZ)]
    numbers = body.surface_number
    rows: Iterator[Iterable[float]] = (
        chain((k, int(numbers[k])), body.mesh.points[k].tolist(), values[k].tolist())
        for k in np.flatnonzero(mask).tolist()
    )
    return "\n".join([",".join(head), *(",".join(map(repr, row)) for row in rows), ""])
