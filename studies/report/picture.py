"""Still pictures of the key cases, for print and where WebGL is missing.

Drawn in this process with matplotlib's rasteriser, from the farthest facet to the nearest: no OpenGL and no display
that a machine may lack, and a fraction of the time that a renderer takes to start.
"""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import imsave
from matplotlib.transforms import IdentityTransform

from ..verdict.digest import Array
from ..verdict.formatting import scale_of

_PANEL = 420  # pixels
# of a picture with labels: dots per inch, pixels of height for them, letters of a line above one panel
_DPI, _LABELS, _LETTERS = 100, 150, 55
_FINER = 2  # drawn so many times as large, then averaged: smooth outlines
_MARGIN = 1.06  # of the body's extent, seen from the camera
_SHAPES = (0.45, 1.1)  # least and largest height of a panel over its width
_ELEVATION = np.radians(22.0)
_AMBIENT, _DIFFUSE = 0.5, 0.55  # light from everywhere, and from above the viewer
_LIGHT = np.array([0.15, 0.6, 0.786])  # unit vector: right, up, towards the viewer
_NO_METADATA: Any = {"Software": None}
_QUICK = {"compress_type": zlib.Z_RLE}  # a third of the time of the usual for a fifteenth more bytes
_Renderer: Any = RendererAgg  # which matplotlib has no types of


@dataclass(frozen=True)
class Panel:
    """One drawing: N nodes where they are drawn, and a value at each between 0 and 1."""

    points: np.ndarray  # (N, 3)
    triangles: np.ndarray  # (F, 3), outward
    values: np.ndarray  # (N,)
    colour_map: str
    azimuth: float  # about z, from where it is seen [rad]
    title: str = ""
    top: float = 1.0  # what the value 1 stands for [m]


def render(pictures: Sequence[Sequence[Panel]]) -> list[bytes]:
    """PNG files on a transparent ground, one per picture of panels side by side, all to one scale."""
    return [_png(panels) for panels in pictures]


def labelled(panels: Sequence[Panel], heading: Sequence[str]) -> bytes:
    """PNG file that stands alone: `panels` side by side under lines of `heading`, each with its title and scale."""
    out = io.BytesIO()
    with warnings.catch_warnings():
        # a letter that the font lacks is drawn as a box
        warnings.filterwarnings("ignore", "Glyph .* missing")
        _figure(panels, heading).savefig(out, format="png", metadata=_NO_METADATA)
    return out.getvalue()


def _figure(panels: Sequence[Panel], heading: Sequence[str]) -> Figure:
    drawings, count = _drawings(panels), len(panels)
    height, width = drawings[0].shape[:2]
    figure = Figure((count * width / _DPI, (height + _LABELS) / _DPI), _DPI, layout="constrained")
    lines = [shorten(line, count * _LETTERS, placeholder=" …") for line in heading]
    figure.suptitle("\n".join(lines), fontsize="medium", parse_math=False)
    places = figure.subplots(1, count, squeeze=False)[0]
    for axes, panel, pixels in zip(places, panels, drawings, strict=True):
        axes.imshow(pixels)
        axes.set_axis_off()
        axes.set_title(panel.title, fontsize="medium", parse_math=False)
        factor, unit = scale_of("m", [panel.top])
        colours = ScalarMappable(Normalize(0.0, panel.top / factor), panel.colour_map)
        figure.colorbar(colours, ax=axes, orientation="horizontal", shrink=0.7, label=unit)
    return figure


def _png(panels: Sequence[Panel]) -> bytes:
    out = io.BytesIO()
    pixels = np.concatenate(_drawings(panels), axis=1)
    imsave(out, pixels, format="png", metadata=_NO_METADATA, pil_kwargs=_QUICK)
    return out.getvalue()


def _drawings(panels: Sequence[Panel]) -> list[np.ndarray]:
    """(height, width, 4) pixels of each panel, all to one scale."""
    everything = np.concatenate([panel.points for panel in panels])
    axes = _directions(panels[0].azimuth)
    low, high = (f(everything @ axes.T, axis=0) for f in (np.min, np.max))
    half_width, half_height = np.maximum(_MARGIN * (high - low)[:2] / 2, 1e-12)
    width = _PANEL * _FINER
    height = round(_PANEL * float(np.clip(half_height / half_width, *_SHAPES))) * _FINER
    scale = 0.5 * min(width / half_width, height / half_height)  # pixels per metre
    shift = np.array([width / 2, height / 2]) - scale * (low + high)[:2] / 2
    return [_drawn(panel, axes, scale, shift, width, height) for panel in panels]


def _directions(azimuth: float) -> Array:
    """(3, 3) rows: unit vectors to the right, up and towards the viewer, seen from an azimuth about z [rad]."""
    cos, sin, level, rise = np.cos(azimuth), np.sin(azimuth), np.cos(_ELEVATION), np.sin(_ELEVATION)
    return np.array([[-sin, cos, 0.0], [-cos * rise, -sin * rise, level], [cos * level, sin * level, rise]])


def _drawn(panel: Panel, axes: Array, scale: float, shift: Array, width: int, height: int) -> np.ndarray:
    """(height, width, 4) pixels of 0 to 255, `_FINER` times smaller than drawn."""
    seen = panel.points @ axes.T
    corners = seen[panel.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    front = np.flatnonzero((normals[:, 2] > 0) & (lengths > 0))
    front = front[np.argsort(corners[front, :, 2].mean(axis=1), kind="stable")]
    colours = colormaps[panel.colour_map](np.clip(panel.values, 0.0, 1.0))[panel.triangles[front]]
    lit = np.clip(normals[front] @ _LIGHT / lengths[front], 0.0, None)
    colours[:, :, :3] *= np.minimum(_AMBIENT + _DIFFUSE * lit, 1.0)[:, None, None]
    renderer = _Renderer(width, height, 72)
    renderer.draw_gouraud_triangles(
        renderer.new_gc(), scale * corners[front, :, :2] + shift, colours, IdentityTransform()
    )
    return _averaged(np.asarray(renderer.buffer_rgba()))


def _averaged(drawn: np.ndarray) -> np.ndarray:
    """Blocks of pixels as one; what is transparent has no colour to give."""
    rows = drawn[::_FINER].astype(np.uint16) + drawn[1::_FINER]
    pixels = rows.view(np.uint64)  # the four sums of a pixel as one number: none of them carries
    total = (pixels[:, ::_FINER] + pixels[:, 1::_FINER]).view(np.uint16)
    out = ((total + _FINER**2 // 2) // _FINER**2).astype(np.uint8)
    # at the outline, where pixels of a block differ in alpha, it weighs their colours
    alpha = total[:, :, 3]
    height, width = alpha.shape
    outline = (alpha > 0) & (alpha < 255 * _FINER**2)
    blocks = drawn.reshape(height, _FINER, width, _FINER, 4).swapaxes(1, 2)[outline].astype(np.float32)
    weights = blocks[..., 3:]
    weighed = (blocks[..., :3] * weights).sum(axis=(1, 2)) / weights.sum(axis=(1, 2))
    out[outline, :3] = weighed.round().astype(np.uint8)
    return out
