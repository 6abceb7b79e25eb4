"""A liver-like body as a smooth image of the unit sphere: thick right lobe, thin left lobe, hollow underside."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .shapes import BodyShape, Geometry, ShapeKey, register

if TYPE_CHECKING:
    from .shapes import Array

_FULLNESS = 2.3
# extents, area and volume for size 1, measured on its finest surface
_EXTENTS = (1.0, 0.606, 0.586)
_AREA, _VOLUME = 1.5155, 0.14533


def liver_points(sphere: Array) -> Array:
    """Points (n, 3) of the organ for points of the unit sphere; half its width is about 1.

    x runs from the right lobe (negative) to the left, y from front to back, z upward. The numbers are chosen
    by eye, so that for each x the depth, and for each x and y the height, grows with the sphere's own: the
    map is one to one and the body cannot meet itself.
    """
    import numpy as np  # slow to load: not where a study is only checked

    # Fuller than a sphere: with the exponent 2 the lobes would be pointed.
    x, v, w = (sphere / (np.abs(sphere) ** _FULLNESS).sum(axis=1, keepdims=True) ** (1.0 / _FULLNESS)).T
    left = _smooth_step(x, -0.35, 0.95)  # 0 in the right lobe, 1 at the tip of the left
    # Depth: the right lobe is deep, the left one lies towards the front.
    y = (0.62 - 0.24 * left) * v - 0.12 * left
    # Thickness: from lobe to lobe, and a wedge from the blunt back to the thinner front edge.
    wedge = 1.0 + 0.30 * np.tanh(1.5 * y)
    half_height = (0.60 - 0.36 * left) * wedge
    # The top is a dome nearly level from lobe to lobe, so the lower edge rises to the left.
    middle = 0.30 * left - 0.10 * (x + 0.3) ** 2 - 0.12 * y**2
    # Underside: a broad hollow towards the left, and a furrow between the lobes; they fade towards the top.
    below = 0.5 * (1.0 - w)
    hollow = 0.34 * np.exp(-(((x - 0.15) / 0.42) ** 2) - ((y - 0.05) / 0.36) ** 2)
    furrow = 0.12 * np.exp(-(((x - 0.22) / 0.12) ** 2) - ((y + 0.35) / 0.30) ** 2)
    z = middle + half_height * w + (hollow + furrow) * below
    return np.stack([x, y, z], axis=1)


def _smooth_step(x: Array, start: float, end: float) -> Array:
    """From 0 at `start` to 1 at `end`, with level ends (a cubic)."""
    import numpy as np

    t = np.clip((x - start) / (end - start), 0.0, 1.0)
    step: Array = t * t * (3.0 - 2.0 * t)
    return step


def _extents(body: Geometry) -> tuple[float, float, float]:
    a, b, c = (share * body.number("size") for share in _EXTENTS)
    return a, b, c


register(
    BodyShape(
        name="organ",
        version="1",
        parameters={"size": ShapeKey("its largest extent")},
        extents=_extents,
        area_and_volume=lambda body: (_AREA * body.number("size") ** 2, _VOLUME * body.number("size") ** 3),
        of_sphere=liver_points,
    )
)
