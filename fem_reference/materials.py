"""Finite-strain laws of the mixed displacement-pressure element: energy, stress, tangent, in that order.

F = I + H is the deformation gradient, H the displacement gradient, J = det F, C = F^T F, I1 = tr C, p the pressure
field, lambda = 2 G nu / (1 - 2 nu). Every law is used in the two-field form

    Psi(F, p) = W(F) - p (J - 1) - p^2 / (2 lambda),    so that p = -lambda (J - 1) holds weakly,

which is finite for every Poisson ratio in (-1, 0.5] and whose small-strain limit is stress = 2 G eps - p I with
p = -lambda div u, the linear element's. A law gives W and what follows from W - p (J - 1); it takes H instead of F,
because F - I and J - 1 by subtraction would lose the digits of small strains.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.solution import SolverError, Status

Array = NDArray[np.float64]

MATERIALS = ("neo-hookean", "transversely-isotropic")
# Below this |x| the series of x - log(1 + x) is exact to rounding, above it the difference is.
_SERIES = 1e-3


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
        return h + transposed + transposed @ h

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
        return _adjugate(self.deformation_gradient) / (1.0 + self.dilation)[..., None, None]


@dataclass(frozen=True)
class Tangent:
    """dP/dF in factors, from which element matrices are products of short vectors.

    A_iJkL = d_ik metric_JL + crossed F^-1_Jk F^-1_Li + sum over (c, D) in dyads of c D_iJ D_kL

    Attributes
    ----------
    metric : (3, 3) or (..., 3, 3), symmetric
    crossed : (...,)
    dilational : (...,) coefficient of the dyad with D = F^-T
    along : (...,) coefficient of the dyad with D = (F a) x a, or None for a law without fibres
    """

    metric: Array
    crossed: Array
    dilational: Array
    along: Array | None = None


class Law(Protocol):
    """What the element needs of a material; stresses are in the unit of the law's moduli.

    `fibre` is the unit vector a of the fibres, None where there are none.
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


@dataclass(frozen=True)
class NeoHookean:
    """Neo-Hookean solid (Bonet and Wood, Nonlinear Continuum Mechanics, 2nd ed., eq. 6.27).

    W = G/2 (I1 - 3 - 2 ln J)
    P = G (F - F^-T) - p J F^-T
    dP/dF : dF = G dF + (G + p J) F^-T dF^T F^-T - p J (F^-T : dF) F^-T

    Attributes
    ----------
    shear_modulus : G, positive
    """

    shear_modulus: float

    @property
    def fibre(self) -> Array | None:
        """None: isotropic."""
        return None

    def energy(self, k: Kinematics) -> Array:
        """(...,) W; see `Law`."""
        # (I1 - 3)/2 - ln J = |H|^2/2 - (J - 1 - tr H) + (J - 1 - ln J): each term of second order.
        squares = np.einsum("...ij,...ij->...", k.gradient, k.gradient)
        return self.shear_modulus * (0.5 * squares - k.minors + _less_logarithm(k.dilation))

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) P; see `Law`."""
        # F - F^-T = F^-T (C - I)
        inner = self.shear_modulus * k.doubled_strain
        hydrostatic = pressure * (1.0 + k.dilation)
        for i in range(3):
            inner[..., i, i] -= hydrostatic
        return np.asarray(np.swapaxes(k.inverse, -1, -2) @ inner)

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """dP/dF; see `Law`."""
        hydrostatic = pressure * (1.0 + k.dilation)
        return Tangent(self.shear_modulus * np.eye(3), self.shear_modulus + hydrostatic, -hydrostatic)


@dataclass(frozen=True)
class TransverselyIsotropic:
    """Neo-Hookean solid with one family of fibres along a, the standard reinforcing model.

    W = W_neo-Hookean + k/8 (I4 - 1)^2,  I4 = a.C a    (Merodio and Ogden 2005, doi 10.1016/j.ijsolstr.2004.10.023)
    P = P_neo-Hookean + k/2 (I4 - 1) (F a) x a
    dP/dF : dF = ... + k/2 (I4 - 1) (dF a) x a + k (F a . dF a) (F a) x a

    At small strain the fibres add k (a.eps a) a x a to the stress: Young's modulus along them is E + k, whatever
    the Poisson ratio.

    Attributes
    ----------
    matrix : the isotropic part
    fibre_modulus : k, not negative
    direction : a, a unit vector
    """

    matrix: NeoHookean
    fibre_modulus: float
    direction: tuple[float, float, float]

    @property
    def fibre(self) -> Array:
        """(3,) a."""
        return np.array(self.direction)

    def energy(self, k: Kinematics) -> Array:
        """(...,) W; see `Law`."""
        return self.matrix.energy(k) + 0.125 * self.fibre_modulus * self._stretch(k) ** 2

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) P; see `Law`."""
        tension = 0.5 * self.fibre_modulus * self._stretch(k)
        along = (k.deformation_gradient @ self.fibre) * tension[..., None]
        return self.matrix.stress(k, pressure) + along[..., :, None] * self.fibre

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """dP/dF; see `Law`."""
        base = self.matrix.tangent(k, pressure)
        tension = 0.5 * self.fibre_modulus * self._stretch(k)
        metric = base.metric + tension[..., None, None] * np.outer(self.fibre, self.fibre)
        return Tangent(metric, base.crossed, base.dilational, np.full_like(tension, self.fibre_modulus))

    def _stretch(self, k: Kinematics) -> Array:
        """(...,) I4 - 1."""
        return np.asarray((k.doubled_strain @ self.fibre) @ self.fibre)


def make_law(
    material: str,
    youngs_modulus: float,
    shear_modulus: float,
    fibre_direction: ArrayLike | None,
    contrast: float,
) -> Law:
    """The law by name.

    Parameters
    ----------
    material : one of `MATERIALS`
    youngs_modulus, shear_modulus : of the isotropic part [Pa]
    fibre_direction : (3,), any length; for the transversely isotropic law only
    contrast : Young's modulus along the fibres over that of the isotropic part, 1 or more

    Raises
    ------
    SolverError
        For an unknown name, a direction of no length, or a contrast below one.
    """
    if material not in MATERIALS:
        raise _bad_material(f"material {material!r} is unknown", f"use one of {', '.join(MATERIALS)}")
    matrix = NeoHookean(shear_modulus)
    if material == "neo-hookean":
        if fibre_direction is not None or contrast != 1.0:
            raise _bad_material("a neo-Hookean body has no fibres", 'use material="transversely-isotropic"')
        return matrix
    if fibre_direction is None:
        raise _bad_material("there is no fibre_direction", "give the direction of the fibres")
    direction = np.asarray(fibre_direction, dtype=np.float64)
    length = float(np.linalg.norm(direction)) if direction.shape == (3,) else 0.0
    if not (np.isfinite(length) and length > 0.0):
        raise _bad_material(
            f"fibre_direction {direction.tolist()} is no direction", "give three numbers, not all zero"
        )
    if not (np.isfinite(contrast) and contrast >= 1.0):
        raise _bad_material(f"contrast is {contrast}", "give 1 or more: fibres stiffen the body")
    x, y, z = (direction / length).tolist()
    return TransverselyIsotropic(matrix, (contrast - 1.0) * youngs_modulus, (x, y, z))


def _less_logarithm(x: Array) -> Array:
    """X - log(1 + x), by its series where the difference would lose digits."""
    small = np.abs(x) < _SERIES
    near = np.where(small, x, 0.0)
    series = near**2 * (1 / 2 - near * (1 / 3 - near * (1 / 4 - near * (1 / 5 - near * (1 / 6 - near / 7)))))
    return np.where(small, series, x - np.log1p(np.where(small, 0.0, x)))


def _determinant(a: Array) -> Array:
    return np.asarray(
        a[..., 0, 0] * (a[..., 1, 1] * a[..., 2, 2] - a[..., 1, 2] * a[..., 2, 1])
        + a[..., 0, 1] * (a[..., 1, 2] * a[..., 2, 0] - a[..., 1, 0] * a[..., 2, 2])
        + a[..., 0, 2] * (a[..., 1, 0] * a[..., 2, 1] - a[..., 1, 1] * a[..., 2, 0])
    )


def _adjugate(a: Array) -> Array:
    out = np.empty_like(a)
    for i in range(3):
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            u, v = (i + 1) % 3, (i + 2) % 3
            out[..., i, j] = a[..., r, u] * a[..., s, v] - a[..., r, v] * a[..., s, u]
    return out


def _bad_material(message: str, remedy: str) -> SolverError:
    return SolverError(Status("bad-material", message, remedy))
