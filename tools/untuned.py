"""Bodies and loads that nothing was tuned for: a torus, a cone, a bent plate, a kidney and a squeezed liver.

Each is held at its foot and loaded in four ways at four Poisson's ratios; `bem` beside elements on the same mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import meshio
import numpy as np
import tomli_w

from solver_common.arrays import Array, Index
from tests.bodies import shaped
from tests.vdm import vdm_shapes
from tools.documents import ROOT, show, table
from tools.evidence import EVIDENCE, MEASURES, RUNS, finished, kept, slashed
from vdmbench.body.geometry import build_mesh
from vdmbench.measures.bars import reference_bar, where_reached
from vdmbench.measures.case import CaseResult
from vdmbench.scene.warnings import scene_warnings
from vdmbench.store.cases import read_run

FORM, ELEMENTS = "bem", "fem-linear"
ENOUGH = 0.1


class Body(NamedTuple):
    """A surface [m], the edge length of its mesh, and where a patch on it lies: its direction and half angle."""

    points: Array
    triangles: Index
    mesh_size: str
    angle: str = "25 deg"
    top: tuple[float, float, float] = (0.3, 0.1, 1.0)


def torus() -> Body:
    """40 mm from its middle to the tube's, which is 18 mm thick in radius; it lies flat."""
    return Body(*vdm_shapes.torus(0.04, 0.018, 80, 40), "7.5 mm", top=(1.0, 0.3, 0.5))


def cone(columns: int = 72) -> Body:
    """A cone cut off: 40 mm in radius at its foot, 12 mm at its top, 80 mm high; both ends on the axis."""
    corners = np.array([[0, 0.08], [0.012, 0.08], [0.04, 0.0], [0, 0.0]])
    profile = np.concatenate([np.linspace(a, b, 24, endpoint=False) for a, b in pairwise(corners)])[1:]
    turn, n = 2 * np.pi * np.arange(columns) / columns, len(profile)
    ring = profile[:, None, :1] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    height = np.broadcast_to(profile[:, None, 1:], (n, columns, 1))
    points = np.concatenate([ring, height], axis=2).reshape(-1, 3)
    i, j = np.mgrid[0 : n - 1, 0:columns].reshape(2, -1)
    right, around = (j + 1) % columns, np.arange(columns)
    a, b, c, d = i * columns + j, (i + 1) * columns + j, (i + 1) * columns + right, i * columns + right
    top, foot, last, following = len(points), len(points) + 1, (n - 1) * columns, np.roll(around, -1)
    triangles = [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    triangles.append(np.stack([np.full(columns, top), around, following], 1))
    triangles.append(np.stack([np.full(columns, foot), last + following, last + around], 1))
    return Body(np.concatenate([points, [[0, 0, 0.08], [0, 0, 0.0]]]), np.concatenate(triangles), "6.5 mm")


def bent_plate() -> Body:
    """100 x 60 x 18 mm bent to a quarter of a circle about y: three elements thick."""
    box = build_mesh(shaped("box", 0.006, {"size": (0.1, 0.06, 0.018)}), volume=False)
    x, y, z = box.surface_points.T
    radius = 0.1 / (np.pi / 2)
    turn = x / radius
    points = np.stack([(radius + z) * np.sin(turn), y, (radius + z) * np.cos(turn)], axis=1)
    return Body(points, box.triangles, "6 mm", "30 deg")


def kidney() -> Body:
    """An ellipsoid of 110 x 60 x 50 mm with a dent of 14 mm at its hilum, bent towards it."""
    ball = build_mesh(shaped("sphere", 0.06, {"radius": 1.0}), volume=False)
    unit = ball.surface_points / np.linalg.norm(ball.surface_points, axis=1)[:, None]
    x, y, z = (unit * (0.055, 0.03, 0.025)).T
    dent = 0.014 * np.exp(-((x / 0.02) ** 2) - (z / 0.02) ** 2) * (unit[:, 1] > 0) * unit[:, 1]
    return Body(np.stack([x, y - dent + 2.5 * x**2, z], axis=1), ball.triangles, "5.5 mm")


def squeezed(surface: Path | None) -> Body:
    """A liver, or the procedural organ, at 40 per cent of its height, 160 mm long."""
    if surface is None:
        mesh = build_mesh(shaped("organ", 0.008, {"size": 0.2}), volume=False)
        points, triangles = mesh.surface_points, mesh.triangles
    else:
        read = meshio.read(surface)
        points, triangles = read.points, read.cells_dict["triangle"].astype(np.int64)
    points = points - (points.min(axis=0) + points.max(axis=0)) / 2
    extent = np.ptp(points, axis=0)
    points = points * (0.16 / extent.max()) * np.where(extent.argsort().argsort() == 0, 0.4, 1.0)
    return Body(np.asarray(points), triangles, "8 mm")


def bodies(surface: Path | None) -> dict[str, Callable[[], Body]]:
    """All of them, by name."""
    last = "squeezed liver" if surface else "squeezed organ"
    plain = {"torus": torus, "cone": cone, "bent plate": bent_plate, "kidney": kidney}
    return {**plain, last: lambda: squeezed(surface)}


class Row(NamedTuple):
    """A body under a load at one Poisson's ratio: errors of models and reference, and what is told."""

    body: str
    load: str
    nodes: int
    errors: dict[str, list[float]]
    own: list[float]
    told: str  # what the form says of its answer, and `check` of the scene; "" where nothing


def study_text(body: Body, load: str) -> str:
    """A load on a body as a study file."""
    own: dict[str, Any] = EVIDENCE["untuned"]
    base = own["study"]
    regions = {
        "foot": base["regions"]["foot"],
        "top": {"cap": {"direction": list(body.top), "angle": body.angle}},
        "side": {"cap": {**base["regions"]["side"]["cap"], "angle": body.angle}},
    }
    weight = {"gravity": {"acceleration": [0, 0, -9.81]}} if load == "weight" else {}
    acting = [{"kind": "fixed", "region": "foot"}, *own["loads"][load]]
    study = {"study": {"name": "untuned", **base["study"]}, "regions": regions, "constraints": acting}
    geometry = {"geometry": {**base["geometry"], "mesh_size": body.mesh_size}}
    return tomli_w.dumps({**base, **study, **geometry, **weight})


def solved(name: str, body: Body) -> Iterator[Row]:
    """Its rows."""
    directory = RUNS / "untuned" / name.replace(" ", "-")
    directory.mkdir(parents=True, exist_ok=True)
    meshio.write(directory / "body.stl", meshio.Mesh(body.points, [("triangle", body.triangles)]))
    for load in EVIDENCE["untuned"]["loads"]:
        (directory / "untuned.toml").write_text(study_text(body, load))
        out = load.replace(" ", "-")
        finished("run", "untuned.toml", "--out", out, cwd=directory)
        yield from (_row(name, load, case) for case in read_run(directory / out).cases)


def _row(body: str, load: str, case: CaseResult) -> Row:
    errors = {m: [where_reached(case, m, measure) for measure in MEASURES] for m in (FORM, ELEMENTS)}
    status = case.models[FORM].status[case.full_load]
    inputs = case.study.model_dump(exclude_none=True)
    of_scene = scene_warnings(
        inputs["constraints"], inputs["tissue"], case.regions, case.points, case.triangles
    )
    own_words = status.message if status.ok else f"{status.code}: {status.message}"
    told = "; ".join(filter(None, (own_words, *(text.partition(":")[0] for _, text in of_scene))))
    return Row(body, load, len(case.points), errors, [reference_bar(case, m) for m in MEASURES], told)


def all_rows(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Head and lines of the table of all: a line a load on a body."""
    lines = []
    for body, load in dict.fromkeys((row.body, row.load) for row in rows):
        own = [row for row in rows if (row.body, row.load) == (body, load)]
        worst = max(own, key=lambda row: (bool(row.told), max(row.errors[FORM])))
        shown = [max(row.errors[ELEMENTS] for row in own), max(own, key=lambda row: row.own[0]).own]
        cells = [*(row.errors[FORM] for row in own), *shown]
        lines.append([body, str(own[0].nodes), load, *map(slashed, cells), worst.told or "nothing"])
    ratios = EVIDENCE["untuned"]["study"]["sweep"]["tissue.poisson_ratio"]
    head = ["body", "nodes", "load", *(f"nu {ratio}" for ratio in ratios), "elements, at worst", "±", "told"]
    return head, lines


def by_body(lines: Sequence[Sequence[str]]) -> str:
    """The page's table: for each body and load `bem` at its worst ratio, in brackets the elements at theirs."""
    loads = list(dict.fromkeys(line[2] for line in lines))
    cells = {(line[0], line[2]): f"{max(line[3:-3], key=_error)} ({line[-3]})" for line in lines}
    bodies = dict.fromkeys(line[0] for line in lines)
    return table(["body", *loads], [[body, *(cells[body, load] for load in loads)] for body in bodies])


def _error(cell: str) -> float:
    return float(cell.split(" / ")[0])


def summed_up(rows: Sequence[Row]) -> str:
    """What the table comes to."""
    off = [row for row in rows if max(row.errors[FORM]) > ENOUGH]
    silent = sum(not row.told for row in off)
    form, elements = (
        slashed([median(row.errors[m][k] for row in rows) for k in (0, 1)]) for m in (FORM, ELEMENTS)
    )
    return (
        f"{len(rows) - len(off)} of {len(rows)} cases are within 10 % in both errors. Of the other {len(off)} the "
        f"tool gives {silent} without a reservation.\nMedians: {form} %, of the elements {elements} %.\n"
    )


def main(name: str, arguments: Sequence[str]) -> None:
    """Run all and write the page's tables."""
    surface = Path(arguments[0]).resolve() if arguments else None
    rows = [row for body, make in bodies(surface).items() for row in solved(body, make())]
    document, lines = ROOT / EVIDENCE[name]["document"], kept(EVIDENCE[name]["all_rows"], *all_rows(rows))
    show(document, name, by_body(lines))
    show(document, f"{name}-sum", summed_up(rows))
