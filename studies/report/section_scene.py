"""The scene of the first key case, in one picture and a few lines of words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from solver_common.arrays import Array

from ..body.surface_measures import facet_area_vectors, piece_volumes, shells
from ..measures.case import CaseResult
from ..scene.result import REST_DISTANCE
from ..study.loads import Constraint
from ..study.schema import Inclusion
from ..verdict.acceptance import kind_of
from ..verdict.digest import Digest
from ..verdict.formatting import capital
from ..verdict.words import said
from .blocks import Scene
from .scene_picture import PART, Outline, Part, Stage, facets_at, scene_svg, style_of

_WORDS = Path(__file__).parent / "templates" / "scene.txt"
# resultant over the sum of facet forces: a contact with less presses from all sides
_ALL_ROUND = 0.05


def _said(macro: str, *about: Any) -> str:
    return " ".join(said(macro, *about, file=_WORDS))


def scene(digest: Digest) -> Scene | None:
    """The picture and the words of a run's scene; None if no case is finished."""
    if not digest.cases:
        return None
    case = digest.key_cases[0][1]
    parts, words = parts_of(case, digest.cases), scene_words(case, digest.cases)
    alt = "The body at rest. " + "; ".join(f"{what}: {value}" for what, value in words)
    stage = Stage(case.points, case.triangles, parts, outlines_of(case))
    svg = scene_svg(stage, alt=alt, salt="scene")
    same = all(np.array_equal(case.points, other.points) for other in digest.cases)
    note = "" if same else f"The picture shows {digest.case_name(case)}."
    return Scene(svg, words, note, _cut_bodies(case))


def _cut_bodies(case: CaseResult) -> list[Markup]:
    """A drawing of the body at full load for each model that cut it, with the rotation and strain of the parts."""
    drawn: list[Markup] = []
    for name, model in case.models.items():
        of_node, moved = model.part_of_node, model.displacement[case.full_load]
        told = {key: values[case.full_load] for key, values in model.scalars.items()}
        if of_node is None or told.get("parts") != of_node.max() or not np.isfinite(moved).all():
            continue
        # nodes on a cut have the highest number of their parts, so the lowest number of a facet's nodes is its
        # part
        of_facet = of_node[case.triangles].min(axis=1)
        parts = []
        for k in range(1, int(of_node.max()) + 1):
            nodes = np.isin(np.arange(len(of_node)), case.triangles[of_facet == k])
            turn, strain = (float(told[f"{what}_of_part_{k}"]) for what in ("rotation", "strain"))
            parts.append(Part(_said("part", turn, strain), PART, nodes, number=k))
        stage = Stage(case.points + moved, case.triangles, parts)
        title, words = f"{name} at full load, in parts", _parts_words(case, name)
        drawn.append(scene_svg(stage, alt=words, salt=f"parts-{len(drawn)}", title=title))
    return drawn


def parts_of(case: CaseResult, cases: Sequence[CaseResult]) -> list[Part]:
    """The regions of a case with supports or loads; the labels have the loads of all `cases`."""
    several = sum(c.kind == "contact" for c in case.study.constraints) > 1
    parts = []
    for constraint in case.study.constraints:
        name, kind, nodes = constraint.name, kind_of(constraint), case.regions[constraint.region]
        label = _load(name, cases)
        if kind == "contact" and several:
            label = f"{name} {label}"
        parts.append(Part(name, kind, nodes, _direction(case, kind, constraint), label))
    return parts


def _direction(case: CaseResult, kind: str, constraint: Constraint) -> Array | None:
    """(3,) direction in which a constraint moves or pushes; None for supports, and for pressure from all sides."""
    key = {"constrained": "displacement", "line": "resultant", "traction": "resultant", "indenter": "push"}
    if (given := getattr(constraint, key.get(kind, ""), None)) is not None:
        return np.array(given, dtype=float)
    return _thrust(case, constraint) if kind in ("contact", "indenter") else None


def outlines_of(case: CaseResult) -> list[Outline]:
    """Outlines of the inclusions: great circles of a ball, edges of a box; none for groups of a mesh file."""
    found = []
    for entry in case.study.inclusions or ():
        if ball := entry.ball:
            lines = ball.radius * _circles() + np.array(ball.center)
        elif box := entry.box:
            low, high = np.array(box.min), np.array(box.max)
            lines = low + _edges() * (high - low)
        else:
            continue
        found.append(Outline(entry.name, lines))
    return found


def _circles() -> Array:
    """(E, 2, 3) segments of three great circles of the unit ball."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    pieces = np.stack([circle[:-1], circle[1:]], axis=1)
    return np.concatenate([pieces, pieces[:, :, [2, 0, 1]], pieces[:, :, [1, 2, 0]]])


def _edges() -> Array:
    """(12, 2, 3) edges of the unit cube."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    ends = [(a, b) for a, b in combinations(range(8), 2) if np.abs(corners[a] - corners[b]).sum() == 1.0]
    return corners[np.array(ends)]


def scene_words(case: CaseResult, cases: Sequence[CaseResult]) -> list[tuple[str, str]]:
    """(what, value) of tissue, body, mesh and constraints, with ranges over all `cases`."""
    rows = [("Tissue", _said("tissue", _tissue(cases)))]
    for k, entry in enumerate(case.study.inclusions or ()):
        rows.append(("Inclusion", _said("inclusion", _inclusion(entry, k, case, cases))))
    shapes = list(dict.fromkeys(other.study.geometry.shape for other in cases))
    rows.append(("Body", _said("body", shapes, np.ptp(case.points, axis=0))))
    if case.study.geometry.cavities is not None:
        rows.append(("Cavities", _said("cavities", _cavities(case), case.study.geometry.cavities)))
    if any("surface_distance_max" in other.mesh_quality and other.study.geometry.path for other in cases):
        keys = dict.fromkeys(key for other in cases for key in other.mesh_quality)
        worst = {key: max((other.mesh_quality.get(key, 0.0) for other in cases), key=abs) for key in keys}
        rows.append(("Scan", _said("scan", worst)))
    nodes, sizes = [len(other.points) for other in cases], _over(cases, "geometry", "mesh_size")
    rows.append(("Mesh", _said("mesh", nodes, sizes)))
    rows += [("Parts", words) for name in case.models if (words := _parts_words(case, name))]
    for constraint in case.study.constraints:
        name, within = constraint.name, case.points[case.regions[constraint.region]]
        middle = (within.min(axis=0) + within.max(axis=0)) / 2 if len(within) else 0.0
        about = {
            "name": name,
            "load": _load(name, cases),
            "profile": constraint.profile if constraint.kind == "contact" else None,
            "nodes": len(within),
            "across": 2.0 * float(np.linalg.norm(within - middle, axis=1).max()) if len(within) else None,
        }
        rows.append((capital(style_of(kind_of(constraint))[0]), _said("constraint", about)))
    return rows


def _tissue(cases: Sequence[CaseResult]) -> dict[str, Any]:
    """Values of the tissue over all cases; `rest`: model -> distances of scanned shapes from rest shapes [m]."""
    rest: dict[str, list[float]] = {}
    for name, model in ((name, model) for case in cases for name, model in case.models.items()):
        if REST_DISTANCE in model.scalars:
            rest.setdefault(name, []).append(float(model.scalars[REST_DISTANCE][0]))
    return {
        "young": _over(cases, "tissue", "youngs_modulus"),
        "poisson": _over(cases, "tissue", "poisson_ratio"),
        "laws": list(dict.fromkeys(law for case in cases if (law := case.study.tissue.law))),
        "contrast": _over(cases, "anisotropy", "contrast"),
        "weight": any(case.study.gravity for case in cases),
        "density": _over(cases, "tissue", "density"),
        "rest": rest,
    }


def _inclusion(entry: Inclusion, k: int, case: CaseResult, cases: Sequence[CaseResult]) -> dict[str, Any]:
    """An inclusion's name, size and moduli over all cases, and the models that leave it out."""
    same = [found[k] for other in cases if len(found := other.study.inclusions or ()) > k]
    return {
        "name": entry.name,
        "young": [one.youngs_modulus for one in same],
        "poisson": [one.poisson_ratio for one in same if one.poisson_ratio is not None],
        "radius": entry.ball.radius if entry.ball else None,
        "unknown_to": case.study.study.homogeneous,
    }


def _cavities(case: CaseResult) -> list[float]:
    """Volumes of the cavities [m^3]."""
    of_facet = shells(case.points, case.triangles)
    volumes = piece_volumes(case.points, case.triangles, of_facet, of_facet.max() + 1)
    return [-float(volume) for volume in volumes[1:]]


def _parts_words(case: CaseResult, name: str) -> str:
    """The number of parts that a model cut the body into, their rotations and strain at full load; "" if none."""
    found = {key: float(values[case.full_load]) for key, values in case.models[name].scalars.items()}
    if not found.get("parts", math.nan) > 0:
        return ""
    turns = [found[f"rotation_of_part_{k}"] for k in range(1, int(found["parts"]) + 1)]
    about = {"strain": found["part_strain"], "bar": found.get("parts_error")}
    return _said("parts", {"name": name, "turns": turns, **about})


def _thrust(case: CaseResult, constraint: Constraint) -> Array | None:
    """(3,) direction in which a contact pushes the body; None if it pushes from all sides."""
    inside = facets_at(case.regions[constraint.region], case.triangles)
    vectors = facet_area_vectors(case.points, case.triangles[inside])
    total, sizes = vectors.sum(axis=0), np.linalg.norm(vectors, axis=1).sum()
    if np.linalg.norm(total) <= _ALL_ROUND * sizes:
        return None
    size = constraint.force or constraint.pressure or constraint.depth or 0.0
    return np.asarray(-total * math.copysign(1.0, size * case.load_factors[case.full_load]))


def _load(name: str, cases: Iterable[CaseResult]) -> str:
    """The full load of a constraint over all cases: "0.1 to 0.4 N", "peak 800 Pa", "2 mm"."""
    found: dict[str, list[float]] = {}
    for case in cases:
        factor = float(case.load_factors[case.full_load])
        for constraint in (one for one in case.study.constraints if one.name == name):
            if constraint.stiffness is not None:
                found.setdefault("Pa/m", []).append(constraint.stiffness)
            for key in constraint.loads:
                size = getattr(constraint, key)
                if isinstance(size, tuple):  # a displacement of zero is a support, not a load
                    size = float(np.linalg.norm(size)) or None
                if size is not None:
                    smooth = key == "pressure" and constraint.profile != "uniform"
                    found.setdefault("peak" if smooth else constraint.unit(key), []).append(factor * size)
    return _said("load", found)


def _over(cases: Iterable[CaseResult], table: str, key: str) -> list[float]:
    """The values of a key of the study over all cases that have it."""
    values = [getattr(getattr(case.study, table), key, None) for case in cases]
    return [float(value) for value in values if isinstance(value, int | float)]
