"""What was computed, in one picture and a few lines: the scene of the case that the page looks at first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations, product

import numpy as np
from markupsafe import Markup

from solver_common.arrays import Array

from ..body.surface_measures import facet_area_vectors, piece_volumes, shells
from ..measures.case import CaseResult
from ..scene.result import REST_DISTANCE
from ..study.loads import Constraint
from ..study.schema import Inclusion
from ..verdict.acceptance import kind_of, name_of
from ..verdict.digest import Digest
from ..verdict.formatting import listed, plain, plural, scale_of, short_percent, span
from .blocks import Scene
from .scene_picture import PART, Outline, Part, Stage, scene_svg, style_of

MOST_STRAIN = 0.1  # within a part, beyond which it is told
_REPAIRED = {
    "facets_flipped": "turned outward",
    "facets_dropped": "without area or repeated left out",
    "facets_of_other_pieces": "of other pieces left out",
    "facets_added": "added to close holes",
}
FILLED = {"empty": "empty", "fluid": "filled with an incompressible fluid"}
_ALL_ROUND = (
    0.05  # of the sum of its facets' forces: a contact whose resultant is smaller presses from all sides
)


def scene(digest: Digest) -> Scene | None:
    """The picture and the words of a run's scene; None where no case is finished."""
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
    """Of each model that cut the body, its parts where they are at full load, with their rotation and strain."""
    drawn: list[Markup] = []
    for name, model in case.models.items():
        of_node, moved = model.part_of_node, model.displacement[case.full_load]
        told = {key: values[case.full_load] for key, values in model.scalars.items()}
        if of_node is None or told.get("parts") != of_node.max() or not np.isfinite(moved).all():
            continue
        # a node on a cut counts to the last of its parts, so a facet is of the first that one of its nodes is of
        of_facet = of_node[case.triangles].min(axis=1)
        parts = []
        for k in range(1, int(of_node.max()) + 1):
            nodes = np.isin(np.arange(len(of_node)), case.triangles[of_facet == k])
            turn, strain = (float(told[f"{what}_of_part_{k}"]) for what in ("rotation", "strain"))
            words = f"turned {np.degrees(turn):.0f}°, strain {short_percent(strain)}"
            parts.append(Part(words, PART, nodes, number=k))
        stage = Stage(case.points + moved, case.triangles, parts)
        title, words = f"{name} at full load, in parts", _parts_words(case, name)
        drawn.append(scene_svg(stage, alt=words, salt=f"parts-{len(drawn)}", title=title))
    return drawn


def parts_of(case: CaseResult, cases: Sequence[CaseResult]) -> list[Part]:
    """The regions of a case that something acts on; the labels tell the loads of all `cases`."""
    several = sum(c.kind == "contact" for c in case.study.constraints) > 1
    parts = []
    for constraint in case.study.constraints:
        name, kind, nodes = name_of(constraint), kind_of(constraint), case.regions[constraint.region]
        label = _load(name, cases)
        if kind == "contact" and several:
            label = f"{name} {label}"
        parts.append(Part(name, kind, nodes, _direction(case, kind, constraint), label))
    return parts


def _direction(case: CaseResult, kind: str, constraint: Constraint) -> Array | None:
    """(3,) of what a constraint moves or pushes; None of a support, and of what pushes from all sides."""
    key = {"constrained": "displacement", "line": "resultant", "traction": "resultant", "indenter": "push"}
    if (given := getattr(constraint, key.get(kind, ""), None)) is not None:
        return np.array(given, dtype=float)
    return _thrust(case, constraint) if kind in ("contact", "indenter") else None


def outlines_of(case: CaseResult) -> list[Outline]:
    """Where the inclusions are: three great circles of a ball, the edges of a box; of a group nothing is known."""
    found = []
    for entry in _inclusions(case):
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
    """(E, 2, 3) the three great circles of the unit ball."""
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    pieces = np.stack([circle[:-1], circle[1:]], axis=1)
    return np.concatenate([pieces, pieces[:, :, [2, 0, 1]], pieces[:, :, [1, 2, 0]]])


def _edges() -> Array:
    """(12, 2, 3) edges of the unit box."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    ends = [(a, b) for a, b in combinations(range(8), 2) if np.abs(corners[a] - corners[b]).sum() == 1.0]
    return corners[np.array(ends)]


def _inclusions(case: CaseResult) -> list[Inclusion]:
    return list(case.study.inclusions or ())


def _scan_words(cases: Sequence[CaseResult]) -> str:
    """How far the bodies are from the surface of the file that they are from, at worst; "" where there is none."""
    if not any("surface_distance_max" in case.mesh_quality and case.study.geometry.path for case in cases):
        return ""
    worst = {
        key: max((case.mesh_quality.get(key, 0.0) for case in cases), key=abs)
        for key in ("surface_distance_max", "surface_distance_mean", "volume_change", *_REPAIRED)
    }
    moved, mean = (plain(1e3 * worst[f"surface_distance_{which}"], 2) for which in ("max", "mean"))
    told = (
        f"remeshing moved the surface by up to {moved} mm ({mean} mm in the mean) and changed its volume by "
    )
    repaired = [f"{plural(int(n), 'facet')} {what}" for key, what in _REPAIRED.items() if (n := worst[key])]
    return ", ".join([told + short_percent(worst["volume_change"]), *repaired])


def _scanned_words(cases: Sequence[CaseResult]) -> str:
    """How far the scanned shapes are from those at rest, as each model found them."""
    found: dict[str, list[float]] = {}
    for case in cases:
        for name, model in case.models.items():
            if REST_DISTANCE in model.scalars:
                found.setdefault(name, []).append(float(model.scalars[REST_DISTANCE][0]))
    told = [f"{span(values, 'm', 2)} ({name})" for name, values in found.items()]
    return f"scanned under it, where its surface is up to {listed(told)} from its rest shape" if told else ""


def scene_words(case: CaseResult, cases: Sequence[CaseResult]) -> list[tuple[str, str]]:
    """(what, value) of tissue, body, mesh and constraints, with the ranges over all `cases`."""
    tissue = [f"Young's modulus {_over(cases, 'tissue', 'youngs_modulus', 'Pa')}"]
    tissue.append(f"Poisson ratio {_over(cases, 'tissue', 'poisson_ratio', '1')}")
    laws = dict.fromkeys(law for other in cases if (law := other.study.tissue.law))
    if laws:
        tissue.append(f"{listed(laws)} at large strain")
    if any(other.study.anisotropy for other in cases):
        tissue.append(f"{_over(cases, 'anisotropy', 'contrast', '1')} times as stiff along its fibres")
    if any(other.study.gravity for other in cases):
        tissue.append(f"with weight, density {_over(cases, 'tissue', 'density', '1')} kg/m³")
    if told := _scanned_words(cases):
        tissue.append(told)
    rows = [("Tissue", ", ".join(part for part in tissue if not part.endswith(" ")))]
    for number, entry in enumerate(_inclusions(case)):
        rows.append(("Inclusion", _inclusion_words(number, entry, case, cases)))
    named = [other.study.geometry.shape for other in cases]
    shapes = dict.fromkeys("from a file" if shape == "file" else shape for shape in named)
    extents = np.ptp(case.points, axis=0)
    factor, unit = scale_of("m", extents)
    lengths = " × ".join(plain(float(length) / factor, 2) for length in extents) + f" {unit}"
    body = [listed(filter(None, shapes)), lengths if len(shapes) == 1 else ""]
    rows.append(("Body", ", ".join(filter(None, body))))
    rows += [("Cavities", _cavities_words(case)), ("Scan", _scan_words(cases))]
    size = _over(cases, "geometry", "mesh_size", "m")
    nodes = span([len(other.points) for other in cases], "1", 9)
    rows.append(("Mesh", f"{nodes} surface nodes" + (f", {size} apart" if size else "")))
    rows += [("Parts", words) for name in case.models if (words := _parts_words(case, name))]
    for constraint in case.study.constraints:
        name, kind = name_of(constraint), kind_of(constraint)
        mask = case.regions[constraint.region]
        rows.append((style_of(kind)[0].capitalize(), _in_words(case, cases, name, constraint, mask)))
    return [(what, value) for what, value in rows if value]


def _cavities_words(case: CaseResult) -> str:
    """How many closed surfaces are inside the outer one, how much room they leave and what is in it."""
    content = case.study.geometry.cavities
    if content is None:
        return ""
    of_facet = shells(case.points, case.triangles)
    volumes = -piece_volumes(case.points, case.triangles, of_facet, of_facet.max() + 1)[1:]
    each = span(volumes.tolist(), "m^3", 2)
    return f"{plural(len(volumes), 'cavity', 'cavities')} of {each}, {FILLED[content]}"


def _parts_words(case: CaseResult, name: str) -> str:
    """Into how many parts a model cut the body, and how far each turned and is strained at full load."""
    found = {key: values[case.full_load] for key, values in case.models[name].scalars.items()}
    if not found.get("parts", math.nan) > 0:
        return ""
    count, strain = int(found["parts"]), float(found["part_strain"])
    turns = listed(f"{np.degrees(found[f'rotation_of_part_{k}']):.0f}°" for k in range(1, count + 1))
    told = f"{name}: {plural(count, 'part')}, turned by {turns}, strained by up to {short_percent(strain)} within"
    if strain > MOST_STRAIN:
        told += " (a part follows small strain)"
    if (bar := found.get("parts_error")) is None:
        return told
    if math.isnan(bar):
        return f"{told}; twice as many find no balance, so what they would change is not known"
    return f"{told}; twice as many change the answer by {short_percent(bar)}"


def _inclusion_words(number: int, entry: Inclusion, case: CaseResult, cases: Sequence[CaseResult]) -> str:
    """Its name, size and moduli over all cases, and who leaves it out."""
    same = [found[number] for other in cases if len(found := _inclusions(other)) > number]
    young = span([one.youngs_modulus for one in same], "Pa")
    ratio = [one.poisson_ratio for one in same if one.poisson_ratio is not None]
    size = f"{plain(2e3 * entry.ball.radius, 2)} mm across" if entry.ball else ""
    leave_out = case.study.study.homogeneous
    unknown = f"unknown to {listed(leave_out)}" if leave_out else ""
    told = (f"Poisson ratio {span(ratio, '1')}" if ratio else "", size, unknown)
    return ", ".join(filter(None, [entry.name, f"Young's modulus {young}", *told]))


def _in_words(
    case: CaseResult, cases: Sequence[CaseResult], name: str, constraint: Constraint, mask: np.ndarray
) -> str:
    nodes, profile = case.points[mask], constraint.profile
    across = ""
    if len(nodes):
        middle = (nodes.min(axis=0) + nodes.max(axis=0)) / 2
        across = f"{plain(2e3 * float(np.linalg.norm(nodes - middle, axis=1).max()), 2)} mm across"
    shape = f"{profile} pressure" if constraint.kind == "contact" and profile else ""
    return ", ".join(filter(None, [name, _load(name, cases), shape, plural(len(nodes), "node"), across]))


def _thrust(case: CaseResult, constraint: Constraint) -> Array | None:
    """(3,) direction in which a contact pushes the body; None where it pushes from all sides."""
    inside = case.regions[constraint.region][case.triangles].all(axis=1)
    vectors = facet_area_vectors(case.points, case.triangles[inside])
    total, sizes = vectors.sum(axis=0), np.linalg.norm(vectors, axis=1).sum()
    if np.linalg.norm(total) <= _ALL_ROUND * sizes:
        return None
    size = constraint.force or constraint.pressure or constraint.depth or 0.0
    return np.asarray(-total * math.copysign(1.0, size * case.load_factors[case.full_load]))


def _load(name: str, cases: Iterable[CaseResult]) -> str:
    """The load of a constraint at full load over all cases: "0.1 to 0.4 N", "peak 800 Pa", "2 mm"."""
    found: dict[str, list[float]] = {}
    for case in cases:
        factor = float(case.load_factors[case.full_load])
        for constraint in case.study.constraints:
            if name_of(constraint) != name:
                continue
            if constraint.force is not None:
                found.setdefault("N", []).append(factor * constraint.force)
            elif constraint.pressure is not None:
                kind = "Pa" if constraint.profile in (None, "uniform") else "peak"
                found.setdefault(kind, []).append(factor * constraint.pressure)
            elif constraint.stiffness is not None:
                found.setdefault("Pa/m", []).append(constraint.stiffness)
            elif constraint.depth is not None:
                found.setdefault("m", []).append(factor * constraint.depth)
            elif kind_of(constraint) == "constrained" and constraint.displacement is not None:
                found.setdefault("m", []).append(factor * float(np.linalg.norm(constraint.displacement)))
    told = [
        f"peak {span(values, 'Pa')}" if unit == "peak" else span(values, unit)
        for unit, values in found.items()
    ]
    return " or ".join(told)


def _over(cases: Iterable[CaseResult], table: str, key: str, unit: str) -> str:
    """The values of a key of the study over all cases; empty where none has it."""
    values = [getattr(getattr(case.study, table), key, None) for case in cases]
    return span([float(value) for value in values if isinstance(value, int | float)], unit)
