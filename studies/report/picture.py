"""Still pictures of the key cases, for print and where WebGL is missing.

Drawn in this process, facets from the farthest to the nearest: no OpenGL, no display and no library to start. A
facet becomes rows of pixels, and a row needs only its ends; the colours are looked up for what is left to be seen.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .colours import LEVELS, colour_map
from .digest import Array

_PANEL = 420  # pixels
_FINER = 2  # drawn so many times as large, then averaged: smooth outlines
_MARGIN = 1.06  # of the body's extent, seen from the camera
_SHAPES = (0.45, 1.1)  # least and largest height of a panel over its width
_ELEVATION = np.radians(22.0)
_AMBIENT, _DIFFUSE = 0.5, 0.55  # light from everywhere, and from above the viewer
_LIGHT = np.array([0.15, 0.6, 0.786])  # unit vector: right, up, towards the viewer
_COMPRESSION = 4  # half the time of the usual level for a fifteenth more bytes


@dataclass(frozen=True)
class Panel:
    """One drawing: N nodes where they are drawn, and a value at each between 0 and 1."""

    points: np.ndarray  # (N, 3)
    triangles: np.ndarray  # (F, 3), outward
    values: np.ndarray  # (N,)
    colour_map: str
    azimuth: float  # about z, from where it is seen [rad]


def render(pictures: Sequence[Sequence[Panel]]) -> list[bytes]:
    """PNG files on a transparent ground, one per picture of panels side by side, all to one scale."""
    return [_png(panels) for panels in pictures]


def _png(panels: Sequence[Panel]) -> bytes:
    everything = np.concatenate([panel.points for panel in panels])
    axes = _directions(panels[0].azimuth)
    low, high = (f(everything @ axes.T, axis=0) for f in (np.min, np.max))
    half_width, half_height = np.maximum(_MARGIN * (high - low)[:2] / 2, 1e-12)
    width = _PANEL * _FINER
    height = round(_PANEL * float(np.clip(half_height / half_width, *_SHAPES))) * _FINER
    scale = 0.5 * min(width / half_width, height / half_height)  # pixels per metre
    shift = np.array([width / 2, height / 2]) - scale * (low + high)[:2] / 2
    pixels = np.concatenate([_drawn(panel, axes, scale, shift, width, height) for panel in panels], axis=1)
    return _as_png(pixels)


def _directions(azimuth: float) -> Array:
    """(3, 3) rows: unit vectors to the right, up and towards the viewer, seen from an azimuth about z [rad]."""
    cos, sin, level, rise = np.cos(azimuth), np.sin(azimuth), np.cos(_ELEVATION), np.sin(_ELEVATION)
    return np.array([[-sin, cos, 0.0], [-cos * rise, -sin * rise, level], [cos * level, sin * level, rise]])


def _drawn(
    panel: Panel, axes: Array, scale: float, shift: Array, width: int, height: int
) -> NDArray[np.uint8]:
    """(height, width, 4) pixels of 0 to 255, `_FINER` times smaller than drawn."""
    corners = (panel.points @ axes.T)[panel.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    front = np.flatnonzero((normals[:, 2] > 0) & (lengths > 0))
    front = front[np.argsort(corners[front, :, 2].mean(axis=1), kind="stable")]
    light = np.clip(normals[front] @ _LIGHT / lengths[front], 0.0, None)
    shade = np.minimum(_AMBIENT + _DIFFUSE * light, 1.0)
    place = scale * corners[front, :, :2] + shift
    place[:, :, 1] = height - place[:, :, 1]  # rows count from the top
    values = np.clip(panel.values, 0.0, 1.0)[panel.triangles[front]]
    return _averaged(_filled(place, values, shade, colour_map(panel.colour_map), width, height))


def _filled(
    place: Array, values: Array, shade: Array, colours: Array, width: int, height: int
) -> NDArray[np.uint8]:
    """(height, width, 4) pixels of triangles, the later over the earlier; a pixel belongs where its middle lies.

    Parameters
    ----------
    place : (T, 3, 2) corners [pixels], to the right and down
    values : (T, 3) at the corners, from 0 to 1: linear in between, then coloured
    shade : (T,) what the colours of a triangle are multiplied by
    colours : (LEVELS, 3) from 0 to 1
    """
    triangle, row, left, right = _rows(place, width, height)

    # over a triangle the value is a plane: its slopes, and its start in each row
    edges = place[:, 1:] - place[:, :1]
    rises = values[:, 1:] - values[:, :1]
    across = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    across[across == 0.0] = 1.0  # too small to have the middle of a pixel
    x_slope = (rises[:, 0] * edges[:, 1, 1] - rises[:, 1] * edges[:, 0, 1]) / across
    y_slope = (rises[:, 1] * edges[:, 0, 0] - rises[:, 0] * edges[:, 1, 0]) / across
    start = values[triangle, 0] + y_slope[triangle] * (row + 0.5 - place[triangle, 0, 1])
    start += x_slope[triangle] * (left + 0.5 - place[triangle, 0, 0])

    # every colour under every shade that may be asked for, as four bytes
    palette = np.full((LEVELS, LEVELS, 4), 255, np.uint8)
    palette[:, :, :3] = (np.linspace(0.0, 255.0, LEVELS)[:, None, None] * colours).round()
    shades = (shade * (LEVELS - 1)).round().astype(np.int32)[triangle] * LEVELS

    count = right - left
    along = np.arange(count.sum(), dtype=np.int32) - _repeated(np.cumsum(count) - count, count)
    value = _repeated(start, count) + _repeated(x_slope[triangle], count) * along
    level = np.clip(value * (LEVELS - 1) + 0.5, 0, LEVELS - 1).astype(np.int32)
    drawn = np.zeros(width * height, np.uint32)
    # of several values for one pixel, the last stays
    drawn[_repeated(row * width + left, count) + along] = palette.view(np.uint32).ravel()[
        _repeated(shades, count) + level
    ]
    return drawn.view(np.uint8).reshape(height, width, 4)


def _repeated(values: Array | NDArray[np.integer], count: NDArray[np.intp]) -> NDArray[Any]:
    """Each row's value for each of its pixels, in half the usual width: there are many pixels."""
    return np.repeat(values.astype(np.float32 if values.dtype.kind == "f" else np.int32), count)


def _rows(
    place: Array, width: int, height: int
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Triangle, row of pixels, first pixel and the one after the last, for each row that a triangle covers."""
    top, bottom = (_after(f(place[:, :, 1], axis=1), height) for f in (np.min, np.max))
    count = bottom - top
    triangle = np.repeat(np.arange(len(place)), count)
    row = np.arange(len(triangle)) + np.repeat(top - np.cumsum(count) + count, count)
    middle = row + 0.5
    left, right = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        (x0, y0), (x1, y1) = place[triangle, a].T, place[triangle, b].T
        crossed = (y0 <= middle) != (y1 <= middle)
        x = x0 + (x1 - x0) * (middle - y0) / np.where(crossed, y1 - y0, 1.0)
        left = np.where(crossed, np.minimum(left, x), left)
        right = np.where(crossed, np.maximum(right, x), right)
    return triangle, row, _after(left, width), _after(right, width)


def _after(edge: Array, most: int) -> NDArray[np.intp]:
    """The first pixel whose middle is not before an edge."""
    return np.clip(np.ceil(edge - 0.5), 0, most).astype(np.intp)


def _averaged(drawn: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Blocks of 2 x 2 pixels as one; what is transparent has no colour to give, and is black."""
    rows = drawn[::_FINER].astype(np.uint16) + drawn[1::_FINER]
    total = rows[:, ::_FINER] + rows[:, 1::_FINER]
    count = total[:, :, 3:] // 255
    out = np.empty(total.shape, np.uint8)
    out[:, :, :3] = (total[:, :, :3] + count // 2) // np.maximum(count, 1)
    out[:, :, 3] = (total[:, :, 3] + 2) // _FINER**2
    return out


def _as_png(pixels: NDArray[np.uint8]) -> bytes:
    """A PNG file (W3C Portable Network Graphics, 3rd edition) of (height, width, 4) pixels."""
    height, width, _ = pixels.shape
    lines = np.zeros((height, 1 + 4 * width), np.uint8)
    lines[:, 0] = 2  # each line as its difference from the one above
    flat = pixels.reshape(height, -1)
    lines[0, 1:] = flat[0]
    np.subtract(flat[1:], flat[:-1], out=lines[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)  # eight bits of red, green, blue and alpha
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), _COMPRESSION)), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
