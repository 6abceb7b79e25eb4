"""The interface of a finite-strain law, and a deformation that keeps all digits of small strains."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from solver_common.arrays import Array
from solver_common.jit import compiled

# below this |x| the series of x - log(1 + x) and exp(x) - 1 - x are exact to rounding; above it the differences are
_SERIES = 1e-3
# The six components of a symmetric tensor: xx, yy, zz, yz, xz, xy.
PAIRS = (np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1]))


@dataclass(frozen=True)
class Kinematics:
    """A deformation at many points, from its displacement gradient.

    Attributes
    ----------
    gradient : (..., 3, 3) H = du_i/dX_J
    """

    gradient: Array

    @cached_property
    def deformation_gradient(self) -> Array:
        """(..., 3, 3) F."""
        return self.gradient + np.eye(3)

    @cached_property
    def doubled_strain(self) -> Array:
        """(..., 3, 3) C - I, twice the Green-Lagrange strain, without cancellation."""
        h = self.gradient
        transposed = np.swapaxes(h, -1, -2)
        return h + transposed + product(transposed, h)

    @cached_property
    def minors(self) -> Array:
        """(...,) second invariant of H plus det H: J - 1 less tr H."""
        h = self.gradient
        second = (
            h[..., 0, 0] * h[..., 1, 1]
            - h[..., 0, 1] * h[..., 1, 0]
            + h[..., 1, 1] * h[..., 2, 2]
            - h[..., 1, 2] * h[..., 2, 1]
            + h[..., 0, 0] * h[..., 2, 2]
            - h[..., 0, 2] * h[..., 2, 0]
        )
        return second + _determinant(h)

    @cached_property
    def dilation(self) -> Array:
        """(...,) J - 1 without cancellation."""
        return self.gradient[..., 0, 0] + self.gradient[..., 1, 1] + self.gradient[..., 2, 2] + self.minors

    @cached_property
    def inverse(self) -> Array:
        """(..., 3, 3) F^-1."""
        deformation = self.deformation_gradient
        inverses = _inverse(deformation.reshape(-1, 3, 3), 1.0 + self.dilation.ravel())
        return np.asarray(inverses.reshape(deformation.shape))

    @cached_property
    def inverse_metric(self) -> Array:
        """(..., 3, 3) C^-1."""
        return product(self.inverse, np.swapaxes(self.inverse, -1, -2))


@dataclass(frozen=True)
class Tangent:
    """dP/dF in factors, from which element matrices are products of short vectors.

    A_iJkL = d_ik metric_JL + crossed F^-1_Jk F^-1_Li + dilational F^-1_Ji F^-1_Lk
              + F_iI F_kK elasticity_IJKL

    Attributes
    ----------
    metric : (3, 3) or (..., 3, 3), symmetric
    crossed : (...,)
    dilational : (...,)
    elasticity : (..., 6, 6) 2 dS/dC at the pairs of indices `PAIRS`, or None for a law that needs no such term
    """

    metric: Array
    crossed: Array
    dilational: Array
    elasticity: Array | None = None


class Law(Protocol):
    """A material as the element needs it; stresses are in the unit of the law's moduli.

    `fibre` is the unit vector a of the fibres, or None.
    """

    @property
    def fibre(self) -> Array | None:
        """(3,) fibre direction in the undeformed body."""
        ...

    def energy(self, k: Kinematics) -> Array:
        """(...,) W."""
        ...

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) first Piola-Kirchhoff stress d(W - p (J - 1))/dF for (...,) pressures."""
        ...

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """Derivative of the stress with respect to F at fixed pressure; that with respect to p is -J F^-T."""
        ...


def less_logarithm(x: Array) -> Array:
    """X - log(1 + x), by its series where the difference would lose digits."""
    small = np.abs(x) < _SERIES
    near = np.where(small, x, 0.0)
    series = near**2 * (1 / 2 - near * (1 / 3 - near * (1 / 4 - near * (1 / 5 - near * (1 / 6 - near / 7)))))
    return np.where(small, series, x - np.log1p(np.where(small, 0.0, x)))


def less_exponential(x: Array) -> Array:
    """exp(x) - 1 - x, by its series where the difference would lose digits."""
    small = np.abs(x) < _SERIES
    near = np.where(small, x, 0.0)
    series = near**2 * (1 / 2 + near * (1 / 6 + near * (1 / 24 + near * (1 / 120 + near / 720))))
    return np.where(small, series, np.expm1(x) - x)


def product(a: Array, b: Array) -> Array:
    """(..., 3, 3) A B at many points, ten times as fast as numpy for such small matrices."""
    return np.asarray(_product(a.reshape(-1, 3, 3), b.reshape(-1, 3, 3)).reshape(a.shape))


@compiled
def _product(a: Array, b: Array) -> Array:
    out = np.empty(a.shape)
    for n in range(len(a)):
        for i in range(3):
            for j in range(3):
                out[n, i, j] = a[n, i, 0] * b[n, 0, j] + a[n, i, 1] * b[n, 1, j] + a[n, i, 2] * b[n, 2, j]
    return out


def _determinant(a: Array) -> Array:
    return np.asarray(
        a[..., 0, 0] * (a[..., 1, 1] * a[..., 2, 2] - a[..., 1, 2] * a[..., 2, 1])
        + a[..., 0, 1] * (a[..., 1, 2] * a[..., 2, 0] - a[..., 1, 0] * a[..., 2, 2])
        + a[..., 0, 2] * (a[..., 1, 0] * a[..., 2, 1] - a[..., 1, 1] * a[..., 2, 0])
    )


@compiled
def _inverse(a: Array, determinant: Array) -> Array:
    """The (n, 3, 3) adjugates over the (n,) determinants."""
    out = np.empty(a.shape)
    for n in range(len(a)):
        for i in range(3):
            for j in range(3):
                r, s = (j + 1) % 3, (j + 2) % 3
                u, v = (i + 1) % 3, (i + 2) % 3
                out[n, i, j] = (a[n, r, u] * a[n, s, v] - a[n, r, v] * a[n, s, u]) / determinant[n]
    return out
