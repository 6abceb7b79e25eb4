"""A scene at one load as files that other programs read: mesh, JSON, and scenes for SOFA, FEBio and MuJoCo.

The scenes are of linear tetrahedra, each a template; all is in metres, newtons and pascals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from html import escape  # the standard library's escape for XML loads network modules
from pathlib import Path
from typing import TypeVar

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import NDArray

from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.mesh import Mesh
from ..body.mesh_file import write_body_msh, write_body_vtu
from ..machine import json_text, write_atomically
from ..study.schema import Tissue
from .scene import Scene, SurfaceLoad

T = TypeVar("T", bound=np.generic)

LOCKS_FROM = 0.45  # Poisson's ratio from which linear tetrahedra are visibly too stiff
FORCE_UNIT = 1e-6  # of the MuJoCo scene [N], and of its masses [kg]
TAKES = frozenset({"dead forces"})  # extras of a study that a scene can express
SCENES = {  # file -> program
    "scene_sofa.py": "SOFA (Python scene)",
    "scene.feb": "FEBio (.feb, format 4.0)",
    "scene_mujoco.xml": "MuJoCo (MJCF)",
}


@dataclass(frozen=True)
class Handout:
    """A tetrahedral scene under one load, in SI units: n points; surface node i is point `mesh.surface_nodes[i]`.

    Attributes
    ----------
    name : of the study and its case, one line
    load_factor : of the study's load history
    """

    scene: Scene
    load: SurfaceLoad
    name: str = ""
    load_factor: float = 1.0

    @property
    def mesh(self) -> Mesh:
        """The scene's mesh."""
        return self.scene.mesh

    @property
    def tissue(self) -> Tissue:
        """Moduli and density."""
        return self.scene.tissue

    @cached_property
    def held(self) -> Mask:
        """(n,) points whose displacement is given."""
        return self._at_points(self.scene.held)

    @cached_property
    def displacement(self) -> Array:
        """(n, 3) displacement of the held points, zero elsewhere [m]."""
        return self._at_points(np.where(self.scene.held[:, None], self.load.prescribed, 0.0))

    @cached_property
    def force(self) -> Array:
        """(n, 3) contact and line forces, dead, without the weight [N]."""
        return self._at_points(self.load.contact_force + self.load.dead_force)

    @cached_property
    def facet_pressure(self) -> Array:
        """(F,) mean contact pressure, positive into the body [Pa]."""
        return self.load.facet_pressure @ facet_quadrature()[1]

    def _at_points(self, values: NDArray[T]) -> NDArray[T]:
        """(n, ...) point values from (N, ...) at the surface nodes, zero inside."""
        found = np.zeros((len(self.mesh.points), *values.shape[1:]), dtype=values.dtype)
        found[self.mesh.surface_nodes] = values
        return found

    @cached_property
    def mass(self) -> Array:
        """(n,) lumped masses: a quarter of each tetrahedron at each of its points [kg]."""
        corners = self.mesh.points[self.mesh.tetrahedra]
        volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
        share = np.repeat(0.25 * self.tissue.density * volume, 4)
        found: Array = np.bincount(
            self.mesh.tetrahedra.ravel(), weights=share, minlength=len(self.mesh.points)
        ).astype(float)
        return found

    @property
    def whole_force(self) -> Array:
        """(n, 3) forces including weight, exact for linear tetrahedra [N]."""
        return self.force + self.mass[:, None] * self.load.gravity

    @property
    def moved(self) -> Mask:
        """(n,) held points with a displacement other than zero."""
        return self.held & self.displacement.any(axis=1)

    @property
    def surface_number(self) -> Index:
        """(n,) number of the surface node at each point, -1 inside."""
        numbers = np.full(len(self.mesh.points), -1)
        numbers[self.mesh.surface_nodes] = np.arange(len(self.mesh.surface_nodes))
        return numbers


# --- scenes ---


def write_scene(body: Handout, out: Path) -> tuple[list[str], list[str]]:
    """Write a scene into a directory; returns file names, and a line for each missing one. Raises OSError."""
    out.mkdir(parents=True, exist_ok=True)
    mesh, numbers = body.mesh, body.surface_number
    on_facets = {name: np.all(mask[mesh.triangles], axis=1) for name, mask in body.scene.regions.items()}
    fields = {
        f"region.{name}": (mask[numbers] & (numbers >= 0)).astype(float)
        for name, mask in body.scene.regions.items()
    }
    fields |= {"surface_node": numbers.astype(float), "held": body.held.astype(float)}
    fields |= {"prescribed": body.displacement, "force": body.force}
    write_body_vtu(out / "mesh.vtu", mesh, fields, body.facet_pressure)
    write_body_msh(out / "mesh.msh", mesh, on_facets)
    why_not = cannot_express(body, TAKES)
    texts = {"scene.json": scene_json(body)} | (
        {} if why_not else {name: scene_text(body, name) for name in SCENES}
    )
    for name, text in texts.items():
        write_atomically(out / name, text.encode())
    refused = [f"{name}: not written: {program}: {why_not}" for name, program in SCENES.items() if why_not]
    refused += [f"scene.json: leaves out {part}" for part in left_out(body)]
    return ["mesh.vtu", "mesh.msh", *texts], refused


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # no HTML: texts pass through `comment`, or into a Python string
    )
    environment.filters["comment"] = lambda lines: escape("\n".join(lines), quote=False).replace("--", "- -")
    return environment


def scene_text(body: Handout, name: str, *, with_loads: bool = True) -> str:
    """The scene for a program in `SCENES`; loads are optional in MuJoCo's."""
    force = np.where(body.held[:, None], 0.0, body.whole_force)
    pushed = np.flatnonzero(body.force.any(axis=1) & ~body.held)
    moved = np.flatnonzero(body.moved)
    ways, which = np.unique(body.displacement[moved], axis=0, return_inverse=True)
    template = _environment().get_template(name + (".txt" if name.endswith(".py") else ""))
    return template.render(
        body=body,
        tissue=body.tissue,
        points=body.mesh.points.tolist(),
        remarks=remarks(body),
        rests=np.flatnonzero(body.held & ~body.moved).tolist(),
        moved=moved.tolist(),
        moves=[(moved[which.ravel() == k].tolist(), way) for k, way in enumerate(ways.tolist())],
        displacement=body.displacement.tolist(),
        loaded=np.flatnonzero(force.any(axis=1)).tolist(),
        force=force.tolist(),
        contact=list(zip(pushed.tolist(), (body.force[pushed] / FORCE_UNIT).tolist(), strict=True)),
        without_joints={*np.flatnonzero(body.held & ~(body.moved & with_loads)).tolist()},
        masses=(body.mass / FORCE_UNIT).tolist(),
        unit=FORCE_UNIT,
        with_loads=with_loads,
    )


def cannot_express(body: Handout, takes: frozenset[str]) -> str:
    """Why linear tetrahedra of an isotropic law with these extras cannot express this scene; "" if they can."""
    if body.tissue.poisson_ratio == 0.5:
        return "its tetrahedra have no law for an incompressible tissue; give a poisson_ratio below 0.5"
    if others := sorted(set(body.scene.extras) - takes):
        return f"not expressed here: {', '.join(others)}; leave out what makes them"
    return ""


def remarks(body: Handout) -> list[str]:
    """Remarks at the head of a scene: units, load, and omissions."""
    told = [
        body.name,
        "Lengths in m, forces in N, stresses in Pa, masses in kg. Points as in mesh.vtu.",
        f"The load is that of load factor {body.load_factor:g}.",
        "Its forces are dead: pressure does not turn with the surface.",
    ]
    ratio = body.tissue.poisson_ratio
    if ratio >= LOCKS_FROM:
        told.append(f"Linear tetrahedra are too stiff at a Poisson ratio of {ratio:g}: they move too little.")
    if not body.held.any():
        told.append("Nothing holds the body: a static solver finds no answer.")
    return told


# --- for programs without a scene here ---


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
    """The parts of a scene that the JSON cannot express."""
    known = TAKES | {"normal springs", "full springs", "inclusions"}
    return sorted(set(body.scene.extras) - known)
