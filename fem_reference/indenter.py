"""Rigid frictionless indenters: a shape that moves along an axis, given by its height above its own tip.

With the unit vector e of the push and a point y measured from the tip of the indenter at rest, the indenter at
depth d fills e.y < d - h(y), h the height. A point is outside where its gap c = e.y + h(y) - d is not negative.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from solver_common.arrays import Array
from solver_common.solution import Status, solver_error

COARSE = 0.1  # of the depth: a surface deeper inside than this share is reported


class Shape(ABC):
    """A shape by its height across the axis."""

    @abstractmethod
    def height(self, across: Array) -> Array:
        """(...,) height above the tip at (..., 3) points across the axis; inf beside the shape [m]."""


@dataclass(frozen=True)
class Sphere(Shape):
    """Sphere, of which the lower half can touch.

    Attributes
    ----------
    radius : [m]
    """

    radius: float

    def height(self, across: Array) -> Array:
        """See `Shape`."""
        return _cap(self.radius, np.einsum("...i,...i->...", across, across))


@dataclass(frozen=True)
class FlatPunch(Shape):
    """Cylinder with a flat end and a sharp edge.

    Attributes
    ----------
    radius : [m]
    """

    radius: float

    def height(self, across: Array) -> Array:
        """See `Shape`."""
        squares = np.einsum("...i,...i->...", across, across)
        return np.where(squares <= self.radius**2, 0.0, np.inf)


@dataclass(frozen=True)
class Capsule(Shape):
    """Cylinder with round ends that lies across the axis, like a finger.

    Attributes
    ----------
    radius : of the cylinder and of its ends [m]
    length : between the centres of its ends [m]
    along : (3,) its direction, of any length
    """

    radius: float
    length: float
    along: tuple[float, float, float]

    def height(self, across: Array) -> Array:
        """See `Shape`."""
        direction = np.array(self.along) / np.linalg.norm(self.along)
        position = np.clip(across @ direction, -0.5 * self.length, 0.5 * self.length)
        apart = across - position[..., None] * direction
        return _cap(self.radius, np.einsum("...i,...i->...", apart, apart))


@dataclass(frozen=True)
class Indenter:
    """A shape, the place of its tip at rest, and the direction in which it is pushed.

    Attributes
    ----------
    shape : `Sphere`, `FlatPunch` or `Capsule`
    tip : (3,) [m]
    direction : (3,) of the push, into the body; of any length

    Raises
    ------
    SolverError
        For sizes that are not positive, and directions of no length.
    """

    shape: Shape
    tip: ArrayLike
    direction: ArrayLike

    def __post_init__(self) -> None:
        sizes = [getattr(self.shape, name, 1.0) for name in ("radius", "length")]
        if not (np.isfinite(sizes).all() and min(sizes) > 0.0):
            raise _bad_indenter(f"an indenter has the sizes {sizes}", "give positive numbers of metres")
        axis, tip = np.asarray(self.direction, dtype=np.float64), np.asarray(self.tip, dtype=np.float64)
        if axis.shape != (3,) or not (np.isfinite(axis).all() and axis.any()) or tip.shape != (3,):
            raise _bad_indenter(
                f"an indenter has the direction {axis.tolist()} and the tip {tip.tolist()}",
                "give three numbers for each, and a direction that is not zero",
            )
        along = getattr(self.shape, "along", None)
        if along is not None and not np.linalg.norm(np.cross(along, axis)) > 0.999 * np.linalg.norm(
            along
        ) * np.linalg.norm(axis):
            raise _bad_indenter("a capsule does not lie across its axis", "give along at a right angle to it")

    @property
    def axis(self) -> Array:
        """(3,) e."""
        direction = np.asarray(self.direction, dtype=np.float64)
        return np.asarray(direction / np.linalg.norm(direction))

    def gap(self, points: Array) -> Array:
        """(...,) gap c at depth zero of (..., 3) points, inf where the indenter passes by [m]."""
        y = points - np.asarray(self.tip, dtype=np.float64)
        along = y @ self.axis
        return along + self.shape.height(y - along[..., None] * self.axis)


def told_sunk(status: Status, inside: float, depth: float) -> Status:
    """The status of a step, with a message if the surface is inside [m] by more than `COARSE` of the depth [m]."""
    if not status.ok or inside <= COARSE * abs(depth):
        return status
    message = f"the surface is up to {1e3 * inside:.2g} mm inside the indenter"
    return replace(status, message=message, remedy="use a finer mesh where the indenter touches")


def _cap(radius: float, squares: Array) -> Array:
    """Height of a circle above its lowest point, without cancellation near it."""
    inside = squares < radius**2
    below = np.sqrt(np.where(inside, radius**2 - squares, 0.0))
    return np.where(inside, squares / (radius + below), np.inf)


_bad_indenter = partial(solver_error, "bad-indenter")
