"""Bodies and loads that nothing was tuned for: the boundary form there, beside elements on the same mesh.

A torus, a cone, a bent plate three elements thick, a kidney, and a liver squeezed along one axis, each held at its
foot and loaded in four ways, at four Poisson's ratios. A liver may be named as argument; without one the procedural
organ is squeezed. The tables go to `docs/evidence/untuned.md`. About twenty minutes of an idle core.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

import meshio
import numpy as np
from numpy.typing import NDArray

from tests.unit import vdm_shapes
from tools import marked
from tools.accuracy import as_per_cent
from tools.ratios import RATIOS
from tools.runs import ROOT, finished
from vdmbench.body.geometry import build_mesh
from vdmbench.measures.bars import at_full_load, reference_bar
from vdmbench.measures.case import CaseResult
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.scene.warnings import scene_warnings
from vdmbench.store.cases import read_run
from vdmbench.study.shapes import Geometry

DOCUMENT = ROOT / "docs" / "evidence" / "untuned.md"
RUNS = ROOT / "build" / "untuned"  # what is there is not done again
FORM, ELEMENTS = "bem", "fem-linear"
ENOUGH = 0.1

Array = NDArray[np.float64]
Triangles = NDArray[np.int64]


@dataclass(frozen=True)
class Body:
    """A surface [m], the edge length of its mesh, and where a patch on it lies: its direction and half angle."""

    points: Array
    triangles: Triangles
    mesh_size: str
    angle: str = "25 deg"
    top: tuple[float, float, float] = (0.3, 0.1, 1.0)


def _grid(rows: int, columns: int) -> Triangles:
    """Triangles of rows x columns nodes; columns meet their first one."""
    i, j = np.mgrid[0 : rows - 1, 0:columns]
    i, j, below, right = i.ravel(), j.ravel(), i.ravel() + 1, (j.ravel() + 1) % columns
    a, b, c, d = i * columns + j, below * columns + j, below * columns + right, i * columns + right
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def _turned(profile: Array, columns: int) -> tuple[Array, Triangles]:
    """A body of revolution about z from (k, 2) radii and heights, both ends on the axis."""
    inner, turn = profile[1:-1], 2 * np.pi * np.arange(columns) / columns
    ring = np.stack(
        [
            np.outer(inner[:, 0], np.cos(turn)),
            np.outer(inner[:, 0], np.sin(turn)),
            np.repeat(inner[:, 1:], columns, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    triangles, around = _grid(len(inner), columns), np.arange(columns)
    following, last = np.roll(around, -1), len(ring) - columns
    ends = [
        np.stack([np.full(columns, len(ring)), around, following], 1),
        np.stack([np.full(columns, len(ring) + 1), last + following, last + around], 1),
    ]
    points = np.concatenate([ring, [[0, 0, profile[0, 1]], [0, 0, profile[-1, 1]]]])
    return points, np.concatenate([triangles, *ends])


def torus() -> Body:
    """40 mm from its middle to the tube's, which is 18 mm thick in radius; it lies flat."""
    return Body(*vdm_shapes.torus(0.04, 0.018, 80, 40), "7.5 mm", top=(1.0, 0.3, 0.5))


def cone() -> Body:
    """A cone cut off: 40 mm in radius at its foot, 12 mm at its top, 80 mm high."""
    corners = np.array([[0, 0.08], [0.012, 0.08], [0.04, 0.0], [0, 0.0]])
    edges = [np.linspace(a, b, 24, endpoint=False) for a, b in pairwise(corners)]
    return Body(*_turned(np.concatenate([*edges, corners[-1:]]), 72), "6.5 mm")


def bent_plate() -> Body:
    """100 x 60 x 18 mm bent to a quarter of a circle about y: three elements thick."""
    box = build_mesh(Geometry("box", 0.006, {"size": (0.1, 0.06, 0.018)}), volume=False)
    x, y, z = box.surface_points.T
    radius = 0.1 / (np.pi / 2)
    turn = x / radius
    points = np.stack([(radius + z) * np.sin(turn), y, (radius + z) * np.cos(turn)], axis=1)
    return Body(points, box.triangles, "6 mm", "30 deg")


def kidney() -> Body:
    """An ellipsoid of 110 x 60 x 50 mm with a dent of 14 mm at its hilum, bent towards it."""
    ball = build_mesh(Geometry("sphere", 0.06, {"radius": 1.0}), volume=False)
    unit = ball.surface_points / np.linalg.norm(ball.surface_points, axis=1)[:, None]
    x, y, z = (unit * (0.055, 0.03, 0.025)).T
    dent = 0.014 * np.exp(-((x / 0.02) ** 2) - (z / 0.02) ** 2) * (unit[:, 1] > 0) * unit[:, 1]
    return Body(np.stack([x, y - dent + 2.5 * x**2, z], axis=1), ball.triangles, "5.5 mm")


def squeezed(surface: Path | None) -> Body:
    """A liver at 40 per cent of its height, 160 mm long."""
    if surface is None:
        mesh = build_mesh(Geometry("organ", 0.008, {"size": (0.2,)}), volume=False)
        points, triangles = mesh.surface_points, mesh.triangles
    else:
        read = meshio.read(surface)
        points, triangles = read.points, read.cells_dict["triangle"]
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    points = (
        points
        * (0.16 / np.ptp(points, axis=0).max())
        * np.where(np.ptp(points, axis=0).argsort().argsort() == 0, 0.4, 1.0)
    )
    return Body(np.asarray(points), np.asarray(triangles, dtype=np.int64), "8 mm")


def bodies(surface: Path | None) -> dict[str, Callable[[], Body]]:
    """All of them, by name."""
    return {
        "torus": torus,
        "cone": cone,
        "bent plate": bent_plate,
        "kidney": kidney,
        "squeezed liver" if surface else "squeezed organ": lambda: squeezed(surface),
    }


STUDY = """
[study]
name = "untuned"
models = ["{form}", "{elements}"]
reference = "{elements}"

[geometry]
shape = "file"
path = "body.stl"
mesh_size = "{mesh_size}"
coordinates = "centred"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.45

[regions.foot]
below = {{ axis = "z", fraction = 0.2 }}

[regions.top]
cap = {{ direction = {top}, angle = "{angle}" }}

[regions.side]
cap = {{ direction = [-1.0, 0.5, 0.8], angle = "{angle}" }}

[[constraints]]
kind = "fixed"
region = "foot"

{loads}
[sweep]
"tissue.poisson_ratio" = {ratios}
[uncertainty]
levels = 2
"""
_PRESSED = """[[constraints]]
kind = "contact"
region = "{}"
pressure = "{} Pa"

"""
LOADS = {
    "shear": '[[constraints]]\nkind = "constrained"\nregion = "top"\ndisplacement = ["1 mm", 0, 0]\n\n',
    "two contacts": _PRESSED.format("top", 40) + _PRESSED.format("side", 40),
    "pull": _PRESSED.format("top", -40),
    "weight": '[gravity]\nacceleration = [0, 0, "-9.81 m/s^2"]\n\n',
}


@dataclass(frozen=True)
class Row:
    """A body under a load at one Poisson's ratio."""

    body: str
    load: str
    nodes: int
    ratio: float
    errors: Mapping[str, tuple[float, float]]  # model -> displacement, deformation
    own: tuple[float, float]  # the reference's
    told: str  # what the form says of its answer, and `check` of the scene; "" where nothing

    @property
    def worst(self) -> float:
        """The larger of the form's two errors."""
        return max(self.errors[FORM])


def solved(name: str, body: Body, directory: Path) -> Iterable[Row]:
    """Its rows; runs the studies in `directory`."""
    meshio.write(directory / "body.stl", meshio.Mesh(body.points, [("triangle", body.triangles)]))
    for load, text in LOADS.items():
        study = STUDY.format(
            form=FORM,
            elements=ELEMENTS,
            mesh_size=body.mesh_size,
            angle=body.angle,
            top=list(body.top),
            loads=text,
            ratios=list(RATIOS),
        )
        (directory / "untuned.toml").write_text(study)
        out = load.replace(" ", "-")
        finished("run", "untuned.toml", "--out", out, cwd=directory)
        yield from (_row(name, load, case) for case in read_run(directory / out).cases)


def _row(body: str, load: str, case: CaseResult) -> Row:
    both = (VECTOR, DEFORMATION)
    errors = {
        m: (at_full_load(case, m, VECTOR), at_full_load(case, m, DEFORMATION)) for m in (FORM, ELEMENTS)
    }
    status = case.models[FORM].status[case.full_load]
    own_words = status.message if status.ok else f"{status.code}: {status.message}"
    inputs = case.study.model_dump(exclude_none=True)
    of_scene = scene_warnings(
        inputs["constraints"], inputs["tissue"], case.regions, case.points, case.triangles
    )
    told = "; ".join(filter(None, (own_words, *(text.partition(":")[0] for _, text in of_scene))))
    own = tuple(reference_bar(case, measure) for measure in both)
    ratio = case.study.tissue.poisson_ratio
    return Row(body, load, len(case.points), ratio, errors, (own[0], own[1]), told)


def written(rows: Sequence[Row]) -> tuple[str, str]:
    """The table of all rows, and what it comes to."""
    lines = []
    for body, load in dict.fromkeys((row.body, row.load) for row in rows):
        own = [row for row in rows if (row.body, row.load) == (body, load)]
        bars = max(own, key=lambda row: row.own[0]).own
        told = max(own, key=lambda row: (bool(row.told), row.worst)).told
        cells = [" / ".join(as_per_cent(e) for e in row.errors[FORM]) for row in own]
        elements = max(row.errors[ELEMENTS] for row in own)
        shown = (" / ".join(map(as_per_cent, pair)) for pair in (elements, bars))
        lines.append([body, str(own[0].nodes), load, *cells, *shown, told or "nothing"])
    head = ["body", "nodes", "load", *(f"nu {ratio}" for ratio in RATIOS), "elements, at worst", "±", "told"]
    within = sum(row.worst <= ENOUGH for row in rows)
    silent = [row for row in rows if row.worst > ENOUGH and not row.told]
    medians = [median(row.errors[model][k] for row in rows) for model in (FORM, ELEMENTS) for k in range(2)]
    form, elements = (" / ".join(map(as_per_cent, pair)) for pair in (medians[:2], medians[2:]))
    rest = len(rows) - within
    told = (
        f"{within} of {len(rows)} cases are within {as_per_cent(ENOUGH)} % in both errors. Of the other {rest} the "
        f"tool gives {len(silent)} without a reservation.\nMedians: {form} %, of the elements {elements} %.\n"
    )
    return marked.table(head, lines), told


def main() -> None:
    """Run all and write the page's tables."""
    surface = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else None
    rows: list[Row] = []
    for name, make in bodies(surface).items():
        directory = RUNS / name.replace(" ", "-")
        directory.mkdir(parents=True, exist_ok=True)
        rows += solved(name, make(), directory)
        print(written(rows)[0], flush=True)
    table, told = written(rows)
    marked.show(DOCUMENT, "untuned", table)
    marked.show(DOCUMENT, "untuned-sum", told)


if __name__ == "__main__":
    main()
