"""Pictures without OpenGL: matplotlib's rasteriser draws lit triangles; and stills of a case."""

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
from matplotlib.transforms import IdentityTransform
from PIL import Image

from solver_common.arrays import Array

from ..verdict.formatting import scale_of

ELEVATION = np.radians(22.0)
FINER = 2  # oversampling, for smooth outlines
AMBIENT = 0.5  # share of ambient light; the rest comes from above the viewer
_LIGHT = np.array([0.15, 0.6, 0.786])  # unit vector: right, up, towards the viewer
_Renderer: Any = RendererAgg  # matplotlib has no types for it


def directions(azimuth: float, elevation: float = ELEVATION) -> Array:
    """(3, 3) rows: unit vectors to the right, up and towards the viewer, seen from an azimuth about z [rad]."""
    cos, sin, level, rise = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.array([[-sin, cos, 0.0], [-cos * rise, -sin * rise, level], [cos * level, sin * level, rise]])


def drawn(
    seen: Array,
    triangles: np.ndarray,
    colours: Array,
    low: Array,
    size: Array,
    width: int,
    ambient: float = AMBIENT,
) -> np.ndarray:
    """(height, width, 4) pixels, 0 to 255, of lit triangles on a transparent ground.

    Parameters
    ----------
    seen : (N, 3) points in the axes of `directions` [m]
    triangles : (F, 3), outward
    colours : (F, 3, 4) RGBA at the corners, between 0 and 1
    low, size : (2,) lower left corner and size of the drawing [m]
    width : of the drawing [pixels]
    ambient : share of ambient light
    """
    scale = width / size[0]
    height = max(1, round(scale * size[1]))
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
        renderer.new_gc(), FINER * scale * (corners[front, :, :2] - low), shaded, IdentityTransform()
    )
    return np.asarray(Image.fromarray(np.asarray(renderer.buffer_rgba())).reduce(FINER))


COLOUR_MAPS = ("viridis", "inferno")  # of displacements, of differences
_PANEL = 420  # pixels
# labels: dots per inch, height of a line above and of the scale below a panel [pixels], letters in such a line
_DPI, _LINE, _SCALE, _LETTERS = 100, 20, 70, 55
_MARGIN = 1.06  # size of a drawing over the body's extent, seen from the camera
_SHAPES = (0.45, 1.1)  # least and largest height of a panel over its width
_NO_METADATA: Any = {
    "png": {"Software": None},
    "svg": dict.fromkeys(("Date", "Creator", "Format", "Type")),
}
_QUICK = {"compress_type": zlib.Z_RLE}  # a third of the default's time, for a fifteenth more bytes


@dataclass(frozen=True)
class Panel:
    """One drawing: a surface with a value between 0 and 1 at each node."""

    points: np.ndarray  # (N, 3)
    triangles: np.ndarray  # (F, 3), outward
    values: np.ndarray  # (N,)
    colour_map: str
    azimuth: float  # of the viewer, about z [rad]
    title: str = ""
    top: float = 1.0  # displacement that the value 1 stands for [m]


def labelled(panels: Sequence[Panel], heading: Sequence[str] = ()) -> bytes:
    """PNG file of `panels` side by side, each with its title and scale, under lines of `heading`."""
    return written(_figure(panels, heading), "png", pil_kwargs=_QUICK)


def written(figure: Figure, kind: str, **how: Any) -> bytes:
    """A figure as a file; the same figure gives the same bytes."""
    out = io.BytesIO()
    with warnings.catch_warnings():
        # a letter that the font lacks becomes a box; in an SVG the browser draws it
        warnings.filterwarnings("ignore", "Glyph .* missing")
        figure.savefig(out, format=kind, metadata=_NO_METADATA[kind], **how)
    return out.getvalue()


def _figure(panels: Sequence[Panel], heading: Sequence[str]) -> Figure:
    drawings, count = _drawings(panels), len(panels)
    height, width = drawings[0].shape[:2]
    whole = height + _LINE * (len(heading) + 1.5) + _SCALE
    figure = Figure((count * width / _DPI, whole / _DPI), _DPI)
    lines = [shorten(line, count * _LETTERS, placeholder=" …") for line in heading]
    figure.suptitle("\n".join(lines), y=1 - 6 / whole, fontsize="medium", parse_math=False)
    for k, (panel, pixels) in enumerate(zip(panels, drawings, strict=True)):
        axes = figure.add_axes((k / count, _SCALE / whole, 1 / count, height / whole))
        axes.imshow(pixels)
        axes.set_axis_off()
        axes.set_title(panel.title, fontsize="medium", parse_math=False)
        factor, unit = scale_of("m", [panel.top])
        colours = ScalarMappable(Normalize(0.0, panel.top / factor), panel.colour_map)
        below = figure.add_axes(((k + 0.15) / count, 0.7 * _SCALE / whole, 0.7 / count, 0.2 * _SCALE / whole))
        figure.colorbar(colours, cax=below, orientation="horizontal", label=unit)
    return figure


def _drawings(panels: Sequence[Panel]) -> list[np.ndarray]:
    """(height, width, 4) pixels of each panel, all at one scale."""
    everything = np.concatenate([panel.points for panel in panels])
    axes = directions(panels[0].azimuth)
    low, high = (f(everything @ axes.T, axis=0)[:2] for f in (np.min, np.max))
    half = np.maximum(_MARGIN * (high - low) / 2, 1e-12)
    half = np.maximum(half, [half[1] / _SHAPES[1], half[0] * _SHAPES[0]])
    low = (low + high) / 2 - half
    pictures = []
    for panel in panels:
        colours = colormaps[panel.colour_map](np.clip(panel.values, 0.0, 1.0))[panel.triangles]
        pictures.append(drawn(panel.points @ axes.T, panel.triangles, colours, low, 2 * half, _PANEL))
    return pictures
