"""Where on the surface the error sits: the 3-D viewer and its still pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..verdict.digest import Digest
from ..verdict.formatting import listed, plain, quantity
from .blocks import Section, Still, Text, Viewer
from .picture import COLOUR_MAPS, Panel, still_of
from .view import azimuth, candidates, displacement_scale, payload


def surfaces(digest: Digest, *, stills: bool) -> Iterator[list[Section]]:
    """The viewer with its still pictures, from the fullest to the leanest, the last without it; [] of no case."""
    if not digest.cases or digest.focus is None:
        yield []
        return
    pictures = [_still(digest, role, case) for role, case in digest.key_cases] if stills else []
    shown = [picture for picture in pictures if picture is not None]
    intro = Text(_introduction(digest), kind="note")
    for view, note in candidates(digest):
        viewer = Viewer(payload(view, digest), shown, [note] if note else [])
        yield [Section("surface", "Where on the surface", [intro, viewer])]
    note = (
        "The surface has too many nodes for a viewer in a page of this size; open the case files in ParaView."
    )
    yield [Section("surface", "Where on the surface", [intro, Viewer(None, shown, [note])])]


def _still(digest: Digest, role: str, case: CaseResult) -> Still | None:
    panels, words = still(digest, case)
    return still_of(panels, digest.title(role, case), words) if panels else None


def _introduction(digest: Digest) -> str:
    roles = [role for role, _ in digest.key_cases]
    if len(roles) == 1:
        return ""
    which = f"The {listed(roles)} of {len(digest.cases)} cases, by the"
    return f"{which} displacement error of {digest.focus}." if digest.compared else f"{which} displacement."


def heading(digest: Digest, role: str, case: CaseResult) -> tuple[str, str]:
    """What a picture of one case shows: the study; the case and the scale."""
    study = digest.run.study.study.title
    scale = plain(displacement_scale(case))
    return study, f"{digest.title(role, case)}, drawn with {scale} times the displacement"


def still(digest: Digest, case: CaseResult) -> tuple[list[Panel], str]:
    """Focus model, reference and their difference at full load, drawn alike, and what they show in words."""
    step, scale, seen_from = case.full_load, displacement_scale(case), azimuth(case)
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
    parts = [
        f"{called[name]} moves by up to {quantity(float(size.max()), 'm')}" for name, size in sizes.items()
    ]
    if len(fields) == 2:
        model, reference = fields
        gap = np.linalg.norm(fields[model] - fields[reference], axis=1)
        panels.append(panel(model, gap, float(gap.max()), COLOUR_MAPS[1], "difference"))
        parts.append(f"they differ by up to {quantity(float(gap.max()), 'm')}")
    order = "Left to right: " if len(panels) > 1 else ""
    told = f"{order}{'; '.join(parts)}."
    drawn = f"The displacement is drawn {plain(scale)} times as large." if scale != 1 else ""
    return panels, " ".join(filter(None, [told[:1].upper() + told[1:], drawn]))
