"""Where on the surface the error sits: the 3-D viewer and its still pictures, within what room the page has."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Sequence

import numpy as np

from ..case import CaseResult
from .blocks import Section, Text, Viewer
from .digest import VECTOR, Array, Digest, at_full_load, full_load
from .formatting import plain, quantity, short_percent
from .picture import Panel
from .view import azimuth, candidates, displacement_scale, payload

Renderer = Callable[[Sequence[Sequence[Panel]]], tuple[list[bytes], str]]
_COLOUR_MAPS = ("viridis", "inferno")


def surfaces(digest: Digest, room: int, render: Renderer) -> Section | None:
    """The viewer with as many cases and steps as `room` bytes hold; `render` makes the still pictures."""
    if not digest.cases or digest.focus is None:
        return None
    notes: list[str] = []
    pictures: list[tuple[str, str, str]] = []
    drawn = [(role, case, panels) for role, case in digest.key_cases if (panels := _panels(digest, case))]
    files, why = render([panels for *_, panels in drawn]) if drawn else ([], "")
    for (role, case, panels), file in zip(drawn, files, strict=False):
        url = "data:image/png;base64," + base64.b64encode(file).decode("ascii")
        if len(url) > room // 4:
            notes.append("A still picture was left out to keep the page small.")
            continue
        room -= len(url)
        pictures.append((_title(digest, role, case), url, _alternative(digest, case, len(panels))))
    if why:
        notes.append(f"No still pictures: {why}.")
    chosen: dict[str, object] | None = None
    for view, note in candidates(digest):
        data = payload(view, digest)
        if len(json.dumps(data)) <= room:
            chosen = data
            notes += [note] if note else []
            break
    else:
        notes.append(
            "The surface has too many nodes for a viewer in a page of this size; open the case files in ParaView."
        )
    intro = _introduction(digest)
    return Section(
        "surface", "Where on the surface", [Text(intro, kind="note"), Viewer(chosen, pictures, notes)]
    )


def _introduction(digest: Digest) -> str:
    count = len(digest.key_cases)
    if count == 1:
        return ""
    if digest.compared:
        return f"Of {len(digest.cases)} cases, those that matter most by the displacement error of {digest.focus}."
    return f"Of {len(digest.cases)} cases, those with the largest, the median and the smallest displacement."


def _title(digest: Digest, role: str, case: CaseResult) -> str:
    name = digest.case_name(case)
    return f"{role[:1].upper()}{role[1:]}: {name}" if role else name


def _panels(digest: Digest, case: CaseResult) -> list[Panel]:
    """Reference, focus model and their difference at full load, deformed alike."""
    step, focus, reference = full_load(case), digest.focus or "", case.reference
    shown = [name for name in (reference, focus) if name in case.models]
    fields = {name: case.models[name].displacement[step] for name in dict.fromkeys(shown) if name}
    fields = {name: u for name, u in fields.items() if np.isfinite(u).all()}
    if not fields:
        return []
    scale = displacement_scale(case)
    largest = max(float(np.linalg.norm(u, axis=1).max()) for u in fields.values())
    turned = azimuth(case)

    def panel(u: Array, values: Array, top: float, colour_map: str) -> Panel:
        return Panel(
            case.points + scale * u, case.triangles, values / top if top > 0 else values, colour_map, turned
        )

    panels = [panel(u, np.linalg.norm(u, axis=1), largest, _COLOUR_MAPS[0]) for u in fields.values()]
    if len(fields) == 2:
        u, r = fields[focus], fields[str(reference)]
        gap = np.linalg.norm(u - r, axis=1)
        panels.append(panel(u, gap, float(gap.max()), _COLOUR_MAPS[1]))
    return panels


def _alternative(digest: Digest, case: CaseResult, panels: int) -> str:
    """What a still picture shows, in words and numbers."""
    step, scale = full_load(case), displacement_scale(case)
    names = [name for name in (case.reference, digest.focus) if name in case.models]
    parts = []
    for name in dict.fromkeys(names):
        u = case.models[str(name)].displacement[step]
        parts.append(f"{name}, largest displacement {quantity(float(np.linalg.norm(u, axis=1).max()), 'm')}")
    text = f"Left to right: {'; '.join(parts)}"
    if panels == 3:
        error = at_full_load(case, digest.focus or "", VECTOR)
        text += "; their difference" + (
            f", {short_percent(error)} of the reference" if math.isfinite(error) else ""
        )
    return f"{text}. Displacements are drawn {plain(scale)} times as large as they are."
