"""Still pictures of the key cases, for print and where WebGL is missing."""

from __future__ import annotations

import base64
import io
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.image import imsave

from ..verdict.formatting import quantity, scale_of
from . import raster
from .blocks import Still

COLOUR_MAPS = ("viridis", "inferno")  # of displacements, of differences
_PANEL = 420  # pixels
# of a picture with labels: dots per inch, pixels of height for them, letters of a line above one panel
_DPI, _LABELS, _LETTERS = 100, 150, 55
_MARGIN = 1.06  # of the body's extent, seen from the camera
_SHAPES = (0.45, 1.1)  # least and largest height of a panel over its width
_NO_METADATA: Any = {"Software": None}
_QUICK = {"compress_type": zlib.Z_RLE}  # a third of the time of the usual for a fifteenth more bytes


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


def png(panels: Sequence[Panel]) -> bytes:
    """PNG file of panels side by side, all to one scale, on a transparent ground."""
    out = io.BytesIO()
    pixels = np.concatenate(_drawings(panels), axis=1)
    imsave(out, pixels, format="png", metadata=_NO_METADATA, pil_kwargs=_QUICK)
    return out.getvalue()


def still_of(panels: Sequence[Panel], title: str, words: str) -> Still:
    """Panels side by side as a picture of the page; `words` say what they show."""
    url = "data:image/png;base64," + base64.b64encode(png(panels)).decode("ascii")
    shown = [(panel.title, panel.colour_map, quantity(panel.top, "m")) for panel in panels]
    return Still(title, url, words, shown)


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


def _drawings(panels: Sequence[Panel]) -> list[np.ndarray]:
    """(height, width, 4) pixels of each panel, all to one scale."""
    everything = np.concatenate([panel.points for panel in panels])
    axes = raster.directions(panels[0].azimuth)
    low, high = (f(everything @ axes.T, axis=0) for f in (np.min, np.max))
    half_width, half_height = np.maximum(_MARGIN * (high - low)[:2] / 2, 1e-12)
    height = round(_PANEL * float(np.clip(half_height / half_width, *_SHAPES)))
    fine = raster.FINER * np.array([_PANEL, height])
    scale = float(0.5 * np.min(fine / [half_width, half_height]))  # pixels per metre
    shift = fine / 2 - scale * (low + high)[:2] / 2
    pictures = []
    for panel in panels:
        colours = colormaps[panel.colour_map](np.clip(panel.values, 0.0, 1.0))[panel.triangles]
        seen = panel.points @ axes.T
        pictures.append(raster.drawn(seen, panel.triangles, colours, scale, shift, _PANEL, height))
    return pictures
