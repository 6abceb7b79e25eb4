"""The scene in a window that can be turned: body, regions and loads."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from solver_common.arrays import Array

from .scene_picture import BODY, KINDS, OTHER, Part


def has_display() -> bool:
    """Whether a window can be opened here."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def scene_plotter(
    points: Array, triangles: np.ndarray, parts: Sequence[Part], *, title: str, off_screen: bool = False
) -> Any:
    """A pyvista.Plotter with the body, its regions in their colours and an arrow for each load.

    Parameters
    ----------
    points : (N, 3) nodes [m]
    triangles : (F, 3) facets
    parts : regions with their kinds and loads
    """
    import pyvista

    coloured = [part.nodes[triangles].all(axis=1) for part in parts]
    plain = ~np.any(coloured, axis=0) if coloured else np.ones(len(triangles), bool)
    body = pyvista.PolyData.from_regular_faces(points, triangles[plain] if plain.any() else triangles)
    plotter = pyvista.Plotter(off_screen=off_screen, title=title)
    plotter.add_mesh(body, color=BODY, show_edges=True, edge_color="#9aa0a6", name="body")
    size = float(np.ptp(points, axis=0).max())
    for part, mask in zip(parts, coloured, strict=True):
        name, colour = KINDS.get(part.kind, (part.kind, OTHER))
        facets = triangles[mask]
        if len(facets):
            region = pyvista.PolyData.from_regular_faces(points, facets)
            plotter.add_mesh(region, color=colour, name=part.name, label=f"{name}: {part.name} {part.label}")
        if part.vector is not None and part.nodes.any():
            middle, length = points[part.nodes].mean(axis=0), np.linalg.norm(part.vector)
            arrow = part.vector / length if length else part.vector
            plotter.add_arrows((middle - 0.3 * size * arrow)[None], 0.3 * size * arrow[None], color=colour)
    if parts:
        plotter.add_legend(bcolor="white")  # type: ignore[call-arg]
    plotter.add_axes()  # type: ignore[call-arg]
    return plotter
