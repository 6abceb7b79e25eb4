"""Lit triangles as pixels, drawn in this process with matplotlib's rasteriser.

The farthest facet comes first: no OpenGL and no display that a machine may lack, the same bytes everywhere, and a
fraction of the time that a renderer takes to start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.transforms import IdentityTransform

from solver_common.arrays import Array

ELEVATION = np.radians(22.0)
FINER = 2  # drawn so many times as large, then averaged: smooth outlines
AMBIENT = 0.5  # share of the light that comes from everywhere; the rest comes from above the viewer
_LIGHT = np.array([0.15, 0.6, 0.786])  # unit vector: right, up, towards the viewer
_Renderer: Any = RendererAgg  # which matplotlib has no types of


def directions(azimuth: float, elevation: float = ELEVATION) -> Array:
    """(3, 3) rows: unit vectors to the right, up and towards the viewer, seen from an azimuth about z [rad]."""
    cos, sin, level, rise = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.array([[-sin, cos, 0.0], [-cos * rise, -sin * rise, level], [cos * level, sin * level, rise]])


def drawn(
    seen: Array,
    triangles: np.ndarray,
    colours: Array,
    scale: float,
    shift: Array,
    width: int,
    height: int,
    ambient: float = AMBIENT,
) -> np.ndarray:
    """(height, width, 4) pixels of 0 to 255 of lit triangles on a transparent ground.

    `seen` are (N, 3) points along `directions`, of which `scale * right + shift` and so on are pixels before
    averaging, counted from the lower left; `colours` are (F, 3, 4) RGBA of the corners, between 0 and 1. Width and
    height are those of the result.
    """
    corners = seen[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    front = np.flatnonzero((normals[:, 2] > 0) & (lengths > 0))
    front = front[np.argsort(corners[front, :, 2].mean(axis=1), kind="stable")]
    lit = np.clip(normals[front] @ _LIGHT / lengths[front], 0.0, None)
    shaded = np.array(colours[front], dtype=np.float64)
    shaded[:, :, :3] *= np.minimum(ambient + (1.05 - ambient) * lit, 1.0)[:, None, None]
    renderer = _Renderer(FINER * width, FINER * height, 72)
    renderer.draw_gouraud_triangles(
        renderer.new_gc(), scale * corners[front, :, :2] + shift, shaded, IdentityTransform()
    )
    return averaged(np.asarray(renderer.buffer_rgba()))


def averaged(drawn: np.ndarray) -> np.ndarray:
    """Blocks of pixels as one, their colours weighed by their alpha: what is transparent has no colour to give."""
    height, width, _ = drawn.shape
    blocks = drawn.reshape(height // FINER, FINER, width // FINER, FINER, 4).astype(np.float32)
    alpha = blocks[..., 3:]
    colours = (blocks[..., :3] * alpha).sum(axis=(1, 3)) / np.maximum(alpha.sum(axis=(1, 3)), 1.0)
    pixels = np.concatenate([colours, alpha.mean(axis=(1, 3))], axis=2)
    return np.floor(pixels + 0.5).astype(np.uint8)
