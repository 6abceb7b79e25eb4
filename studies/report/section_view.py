"""The error on the surface: the 3-D viewer with its data, and still pictures.

Coordinates are 16-bit fractions of the bounding box, displacements 16-bit fractions of each step's largest
component. The rounding, 1.5e-5 of the range, is far below a pixel. Surfaces that cases share are stored once.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.metrics import full_load_step
from ..verdict.digest import Digest
from ..verdict.formatting import plain, round_below, short_percent
from .blocks import Section, Still, Viewer, note
from .picture import COLOUR_MAPS, Panel, labelled
from .scene_picture import KINDS, Stage
from .section_scene import parts_of

_U16, _I16 = 65535, 32767
MOST_BYTES = 4_000_000  # limit of the viewer's data, so that a page can be mailed


def surface(digest: Digest) -> Section | None:
    """The viewer and a still picture of the first key case; None without cases.

    The viewer has every load step, that of `opening_step` alone, or nothing, as `MOST_BYTES` allows.
    """
    if not digest.cases or digest.focus is None:
        return None
    role, first = digest.key_cases[0]
    panels, words = still(digest, first)
    shown = None
    if panels:
        url = "data:image/png;base64," + base64.b64encode(labelled(panels)).decode("ascii")
        shown = Still(digest.title(role, first), url, words)
    cases, roles = [case for _, case in digest.key_cases], [role for role, _ in digest.key_cases]
    data: dict[str, object] | None = None
    for history in (True, False):
        data = payload(digest, cases, digest.models, history)
        if len(json.dumps(data)) <= MOST_BYTES:
            break
    else:
        data = None
    intro = note("surface", roles, len(digest.cases), digest.focus, bool(digest.compared))
    return Section(
        "surface",
        "Where on the surface",
        [intro, Viewer(data, shown, note("viewer", data is not None, history))],
    )


def opening_step(digest: Digest, case: CaseResult) -> int:
    """The step of the largest load that focus model and reference both reached; of full load if there is none."""
    shown = [case.models[name] for name in map(str, (digest.focus, case.reference)) if name in case.models]
    answered = [[status.ok for status in one.status] for one in shown]
    known = np.flatnonzero(np.all(answered, axis=0) & (case.load_factors != 0.0))
    return int(known[full_load_step(case.load_factors[known])]) if len(known) else case.full_load


def _at(case: CaseResult, step: int) -> str:
    """The load of a step in words, as a share of the full load; "" for the full load."""
    share = (
        abs(float(case.load_factors[step] / case.load_factors[case.full_load]))
        if step != case.full_load
        else 1.0
    )
    return "" if share == 1.0 else f"at {short_percent(share)} of the load, the last that both reached"


def heading(digest: Digest, role: str, case: CaseResult) -> tuple[str, str]:
    """Two lines above a picture of one case: the study; the case and the scale of displacements."""
    study = digest.run.study.study.title
    scale = plain(displacement_scale(case))
    drawn = f"drawn with {scale} times the displacement"
    return study, ", ".join(
        filter(None, [digest.title(role, case), _at(case, opening_step(digest, case)), drawn])
    )


def still(digest: Digest, case: CaseResult) -> tuple[list[Panel], str]:
    """Panels of focus model, reference and their difference at `opening_step`, and what they show in words."""
    step, scale, seen_from = opening_step(digest, case), displacement_scale(case), azimuth(case)
    names = [name for name in dict.fromkeys((digest.focus, case.reference)) if name in case.models]
    fields = {str(name): case.models[str(name)].displacement[step] for name in names}
    fields = {name: u for name, u in fields.items() if np.isfinite(u).all()}
    if not fields:
        return [], ""
    sizes = {name: np.linalg.norm(u, axis=1) for name, u in fields.items()}
    largest = max(float(size.max()) for size in sizes.values())
    called = {name: "the reference" if name == case.reference else name for name in fields}

    def panel(name: str, values: Array, top: float, colour_map: str, title: str) -> Panel:
        points = case.points + scale * fields[name]
        shares = values / top if top > 0 else values
        return Panel(points, case.triangles, shares, colour_map, seen_from, title, top)

    panels = [
        panel(name, size, largest, COLOUR_MAPS[0], f"displacement of {called[name]}")
        for name, size in sizes.items()
    ]
    gap = None
    if len(fields) == 2:
        model, reference = fields
        apart = np.linalg.norm(fields[model] - fields[reference], axis=1)
        gap = float(apart.max())
        panels.append(panel(model, apart, gap, COLOUR_MAPS[1], "difference"))
    moves = {called[name]: float(size.max()) for name, size in sizes.items()}
    return panels, note("still", moves, gap, scale, _at(case, step)).text


# --- the viewer's data ---


def payload(
    digest: Digest, shown: Sequence[CaseResult], models: Sequence[str], history: bool
) -> dict[str, object]:
    """The viewer's JSON for some key cases and models: with `history` all load steps, else `opening_step` alone."""
    roles = {case.hash: role for role, case in digest.key_cases}
    surfaces: dict[tuple[bytes, bytes], int] = {}
    geometries: list[dict[str, object]] = []
    cases = []
    for case in shown:
        key = (case.points.tobytes(), case.triangles.tobytes())
        if key not in surfaces:
            surfaces[key] = len(geometries)
            geometries.append(_geometry(case))
        opens = opening_step(digest, case)
        steps = list(range(len(case.load_factors))) if history else [opens]
        names = [name for name in models if name in case.models]
        cases.append(
            {
                "title": digest.title(roles[case.hash], case),
                "name": case.label,
                "geometry": surfaces[key],
                "reference": case.reference if case.reference in names else None,
                "opens": steps.index(opens),
                "factors": [float(case.load_factors[step]) for step in steps],
                "azimuth": azimuth(case),
                "scale": displacement_scale(case),
                "regions": _regions(case),
                "models": [{"name": name, "steps": _displacements(case, name, steps)} for name in names],
            }
        )
    return {
        "geometries": geometries,
        "cases": cases,
        "focus": digest.focus,
        "colours": colour_maps(),
        "regionColours": {kind: colour for kind, (_, colour) in KINDS.items()},
    }


def colour_maps() -> dict[str, str]:
    """256 RGB entries for displacement and for difference: perceptually uniform, safe for colour-blind readers."""
    maps = {
        "displacement": colormaps["viridis"](np.linspace(0, 1, 256)),
        "difference": colormaps["inferno"](np.linspace(0.12, 0.97, 256)),
    }
    return {name: _pack((colours[:, :3] * 255).round().astype(np.uint8)) for name, colours in maps.items()}


def azimuth(case: CaseResult) -> float:
    """Azimuth of the camera that shows the case's supports and loads best [rad]."""
    return Stage(case.points, case.triangles, parts_of(case, [case])).azimuth


def displacement_scale(case: CaseResult) -> float:
    """A round factor, at least 1, that scales the largest displacement to about a tenth of the body."""
    sizes = [np.abs(result.displacement[np.isfinite(result.displacement)]) for result in case.models.values()]
    largest = max((float(size.max()) for size in sizes if size.size), default=0.0)
    wanted = 0.1 * float(np.linalg.norm(np.ptp(case.points, axis=0))) / largest if largest > 0 else 1.0
    return max(round_below(wanted), 1.0)


def _regions(case: CaseResult) -> list[dict[str, object]]:
    """The nodes of the regions with supports or loads."""
    return [
        {"kind": part.kind, "nodes": _pack(np.flatnonzero(part.nodes).astype(_index_type(case)))}
        for part in parts_of(case, [case])
    ]


def _index_type(case: CaseResult) -> str:
    return "<u4" if len(case.points) > _U16 else "<u2"


def _geometry(case: CaseResult) -> dict[str, object]:
    """The viewer's surface: nodes as 16-bit fractions of the bounding box, triangles as node numbers."""
    low = case.points.min(axis=0)
    step = np.where(np.ptp(case.points, axis=0) > 0, np.ptp(case.points, axis=0), 1.0) / _U16
    return {
        "nodes": len(case.points),
        "low": [float(v) for v in low],
        "step": [float(v) for v in step],
        "points": _pack(((case.points - low) / step).round().astype("<u2")),
        "wide": len(case.points) > _U16,
        "triangles": _pack(case.triangles.astype(_index_type(case))),
    }


def _displacements(case: CaseResult, model: str, steps: list[int]) -> list[dict[str, object]]:
    """The viewer's displacements of each step, or the message of a step that failed."""
    out: list[dict[str, object]] = []
    for step in steps:
        u = case.models[model].displacement[step]
        status = case.models[model].status[step]
        if not status.ok or not np.isfinite(u).all():
            out.append({"message": status.message or status.code})
            continue
        scale = float(np.abs(u).max()) / _I16
        out.append({"scale": scale, "data": _pack(_rounded(u, scale))})
    return out


def _rounded(u: Array, scale: float) -> NDArray[np.int16]:
    """(N, 3) displacement u in units of `scale` [m]; zero where nothing moves."""
    return (u / scale if scale > 0 else np.zeros_like(u)).round().astype("<i2")


def _pack(values: NDArray[np.generic]) -> str:
    """The bytes of an array in Base64."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
