"""Isotropic hyperelastic laws of the distortion: an energy, and one stress and one tangent for all of them.

With C = F^T F, J = det F, I1 = tr C, I2 = (I1^2 - tr C^2)/2 and the stretches l_i, the distortion C' has

    I1' = J^(-2/3) I1,   I2' = J^(-4/3) I2,   l_i' = J^(-1/3) l_i,

and every law here is W = w(C') + G/3 (J - 1)^2 (Holzapfel, Nonlinear Solid Mechanics, section 6.4). The second term
gives all of them the small-strain limit 2 G eps of `fem_reference.materials`; it is zero where J = 1.
With S = 2 dw/dC, the elasticity L = 4 d2w/dCdC, M = C S and the pressure p' = p - 2 G/3 (J - 1),

    P = F^-T (M - p' J I)
    dP/dF : dF = dF S + F (L : F^T dF) + p' J F^-T dF^T F^-T + (2 G/3 J^2 - p' J) (F^-T : dF) F^-T.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from fem_reference.kinematics import (
    PAIRS,
    Kinematics,
    Tangent,
    less_exponential,
    less_logarithm,
    product,
)
from solver_common.arrays import Array

_I, _J = PAIRS
_UNIT = np.eye(3)[_I, _J]
# larger exponents occur only in iterates far from equilibrium, where a finite force shortens the step
_LARGEST_EXPONENT = 200.0


class Hyperelastic(ABC):
    """An isotropic law by its energy w of the distortion."""

    fibre: Array | None = None

    @property
    @abstractmethod
    def shear_modulus(self) -> float:
        """G at small strain."""

    @abstractmethod
    def distortion_energy(self, k: Kinematics) -> Array:
        """(...,) w."""

    @abstractmethod
    def mixed_stress(self, k: Kinematics) -> Array:
        """(..., 3, 3) M = C S, symmetric since the law is isotropic."""

    @abstractmethod
    def elasticity(self, k: Kinematics) -> Array:
        """(..., 6, 6) L at the pairs of indices of `fem_reference.kinematics.PAIRS`."""

    def energy(self, k: Kinematics) -> Array:
        """(...,) W; see `fem_reference.kinematics.Law`."""
        return self.distortion_energy(k) + self.shear_modulus / 3.0 * k.dilation**2

    def stress(self, k: Kinematics, pressure: Array) -> Array:
        """(..., 3, 3) P; see `fem_reference.kinematics.Law`."""
        inner = self.mixed_stress(k)
        hydrostatic = self._pressure(k, pressure) * (1.0 + k.dilation)
        for i in range(3):
            inner[..., i, i] -= hydrostatic
        return product(np.swapaxes(k.inverse, -1, -2), inner)

    def tangent(self, k: Kinematics, pressure: Array) -> Tangent:
        """dP/dF; see `fem_reference.kinematics.Law`."""
        volume = 1.0 + k.dilation
        hydrostatic = self._pressure(k, pressure) * volume
        metric = product(k.inverse_metric, self.mixed_stress(k))
        dilational = 2.0 / 3.0 * self.shear_modulus * volume**2 - hydrostatic
        return Tangent(metric, hydrostatic, dilational, elasticity=self.elasticity(k))

    def _pressure(self, k: Kinematics, pressure: Array) -> Array:
        return pressure - 2.0 / 3.0 * self.shear_modulus * k.dilation


class _OfInvariants(Hyperelastic):
    """w = f(I1' - 3) + c (I2' - 3).

    M = 2 f' J^(-2/3) dev C + 2 c J^(-4/3) dev (I1 C - C^2)
    """

    @property
    def shear_modulus(self) -> float:
        """G = 2 (f'(0) + c)."""
        return 2.0 * (float(self.first(np.zeros(()))[1]) + self.second)

    @property
    def second(self) -> float:
        """The modulus c of I2'."""
        return 0.0

    @abstractmethod
    def first(self, a: Array) -> tuple[Array, Array, Array]:
        """F, f' and f'' at a = I1' - 3."""

    def distortion_energy(self, k: Kinematics) -> Array:
        """(...,) w; see `Hyperelastic`."""
        first, second = _distortions(k)
        return self.first(first)[0] + self.second * second

    def mixed_stress(self, k: Kinematics) -> Array:
        """(..., 3, 3) M; see `Hyperelastic`."""
        slope = self.first(_distortions(k)[0])[1]
        shrink = _shrink(k)
        d = k.doubled_strain
        out = (2.0 * slope * shrink)[..., None, None] * d
        if self.second:
            trace = np.trace(d, axis1=-2, axis2=-1)[..., None, None]
            out = out + (2.0 * self.second * shrink**2)[..., None, None] * ((1.0 + trace) * d - product(d, d))
        return _deviator(out)

    def elasticity(self, k: Kinematics) -> Array:
        """(..., 6, 6) L; see `Hyperelastic`.

        With A = dI1'/dC, K = C^-1 and K o K_IJKL = (K_IK K_JL + K_IL K_JK)/2:
        d2I1'/dCdC = -(A x K + K x A)/3 - I1'/9 K x K + I1'/3 K o K; of I2' alike, and J^(-4/3) (I x I - I o I).
        """
        first, second = _distortions(k)
        _, slope, curve = self.first(first)
        shrink = _shrink(k)
        d, inverse = k.doubled_strain, k.inverse_metric
        flat = inverse[..., _I, _J]
        square, crossed = _outer(flat, flat), _symmetric_product(inverse)

        def scaled(factor: Array, tensor: Array) -> Array:
            return factor[..., None, None] * tensor

        a = (scaled(shrink, product(inverse, _deviator(d))))[..., _I, _J]
        mixed = _outer(a, flat)
        out = scaled(4.0 * curve, _outer(a, a))
        out += scaled(
            -4.0 / 3.0 * slope,
            mixed + np.swapaxes(mixed, -1, -2) - scaled(first + 3.0, crossed - square / 3.0),
        )
        if self.second:
            trace = np.trace(d, axis1=-2, axis2=-1)[..., None, None]
            b = scaled(shrink**2, product(inverse, _deviator((1.0 + trace) * d - product(d, d))))[..., _I, _J]
            mixed = _outer(b, flat)
            identity = np.outer(_UNIT, _UNIT) - _symmetric_product(np.eye(3))
            bracket = scaled(second + 3.0, crossed - 2.0 / 3.0 * square) - mixed - np.swapaxes(mixed, -1, -2)
            out += 4.0 * self.second * (scaled(shrink**2, identity) + 2.0 / 3.0 * bracket)
        return out


@dataclass(frozen=True)
class MooneyRivlin(_OfInvariants):
    """Mooney-Rivlin solid (Mooney 1940, doi 10.1063/1.1712836; Rivlin 1948, doi 10.1098/rsta.1948.0024).

    w = c1 (I1' - 3) + c2 (I2' - 3),   G = 2 (c1 + c2)

    Attributes
    ----------
    c1, c2 : moduli
    """

    c1: float
    c2: float

    @property
    def second(self) -> float:
        """c2."""
        return self.c2

    def first(self, a: Array) -> tuple[Array, Array, Array]:
        """See the law."""
        return self.c1 * a, np.full_like(a, self.c1), np.zeros_like(a)


@dataclass(frozen=True)
class Yeoh(_OfInvariants):
    """Yeoh's solid (Yeoh 1993, doi 10.5254/1.3538343).

    w = c1 a + c2 a^2 + c3 a^3,   a = I1' - 3,   G = 2 c1

    Attributes
    ----------
    c1, c2, c3 : moduli
    """

    c1: float
    c2: float
    c3: float

    def first(self, a: Array) -> tuple[Array, Array, Array]:
        """See the law."""
        return (
            a * (self.c1 + a * (self.c2 + a * self.c3)),
            self.c1 + a * (2.0 * self.c2 + 3.0 * a * self.c3),
            2.0 * self.c2 + 6.0 * a * self.c3,
        )


@dataclass(frozen=True)
class FungDemiray(_OfInvariants):
    """The isotropic exponential law of soft tissue (Demiray 1972, doi 10.1016/0021-9290(72)90047-4).

    w = G/(2 b) (exp(b a) - 1),   a = I1' - 3

    Attributes
    ----------
    modulus : G
    exponent : b, positive
    """

    modulus: float
    exponent: float

    def first(self, a: Array) -> tuple[Array, Array, Array]:
        """See the law."""
        b = self.exponent
        power = np.minimum(b * a, _LARGEST_EXPONENT)
        slope = 0.5 * self.modulus * np.exp(power)
        return 0.5 * self.modulus / b * np.expm1(power), slope, b * slope


@dataclass(frozen=True)
class Ogden(Hyperelastic):
    """Ogden's solid (Ogden 1972, doi 10.1098/rspa.1972.0026).

    w = sum over p of m_p / a_p (l_1'^a_p + l_2'^a_p + l_3'^a_p - 3),   G = 1/2 sum of m_p a_p

    With e_i = ln l_i', f_i = sum of m_p exp(a_p e_i) and their mean f, the principal values are M_i = f_i - f and
    S_i = M_i / l_i^2. The elasticity consists of their derivatives and of (S_i - S_j)/(l_i^2 - l_j^2), for the
    rotation of the principal axes.

    Attributes
    ----------
    moduli : m_p
    exponents : a_p, none of them zero
    """

    moduli: tuple[float, ...]
    exponents: tuple[float, ...]

    @property
    def shear_modulus(self) -> float:
        """G at small strain."""
        return 0.5 * float(np.dot(self.moduli, self.exponents))

    def distortion_energy(self, k: Kinematics) -> Array:
        """(...,) w; see `Hyperelastic`."""
        e = _logarithms(np.asarray(np.linalg.eigvalsh(k.doubled_strain)), k)
        # the logarithms sum to zero: subtracting them leaves terms of second order
        return sum(
            (m / a * less_exponential(a * e).sum(axis=-1) for m, a in self._terms()), np.zeros(e.shape[:-1])
        )

    def mixed_stress(self, k: Kinematics) -> Array:
        """(..., 3, 3) M; see `Hyperelastic`."""
        strain, axes = np.linalg.eigh(k.doubled_strain)
        e = _logarithms(strain, k)
        f = sum((m * np.expm1(a * e) for m, a in self._terms()), np.zeros_like(e))
        principal = f - f.mean(axis=-1, keepdims=True)
        return np.asarray((axes * principal[..., None, :]) @ np.swapaxes(axes, -1, -2))

    def elasticity(self, k: Kinematics) -> Array:
        """(..., 6, 6) L; see `Hyperelastic`."""
        strain, axes = np.linalg.eigh(k.doubled_strain)
        e, squares = _logarithms(strain, k), 1.0 + strain
        powers = [m * np.exp(a * e) for m, a in self._terms()]
        f = sum(powers, np.zeros_like(e))
        slope = sum((a * power for power, a in zip(powers, self.exponents, strict=True)), np.zeros_like(e))
        mean = f.mean(axis=-1)
        inner = slope[..., None, :] + slope[..., :, None]
        principal = slope.sum(axis=-1)[..., None, None] / 18.0 - inner / 6.0
        for i in range(3):
            principal[..., i, i] += 0.5 * slope[..., i] - (f[..., i] - mean)
        principal /= squares[..., None, :] * squares[..., :, None]
        own = (axes[..., _I, :] * axes[..., _J, :]).swapaxes(-1, -2)  # (..., 3, 6) N_i x N_i
        out = 2.0 * np.swapaxes(own, -1, -2) @ principal @ own
        for i, j in ((0, 1), (1, 2), (0, 2)):
            turned = 0.5 * (axes[..., _I, i] * axes[..., _J, j] + axes[..., _I, j] * axes[..., _J, i])
            # (S_i - S_j)/(l_i^2 - l_j^2), by divided differences that stay exact for equal stretches
            gap = np.log1p((strain[..., j] - strain[..., i]) / squares[..., i])
            ratio = sum(
                (
                    power[..., i] / squares[..., i] ** 2 * _divided_difference(0.5 * a - 1.0, gap)
                    for power, a in zip(powers, self.exponents, strict=True)
                ),
                mean / (squares[..., i] * squares[..., j]),
            )
            out += 4.0 * ratio[..., None, None] * _outer(turned, turned)
        return np.asarray(out)

    def _terms(self) -> list[tuple[float, float]]:
        return list(zip(self.moduli, self.exponents, strict=True))


def _distortions(k: Kinematics) -> tuple[Array, Array]:
    """(...,) I1' - 3 and I2' - 3, each a sum of terms of second order."""
    d, x = k.doubled_strain, k.dilation
    trace = np.trace(d, axis1=-2, axis2=-1)
    minors = 0.5 * (trace**2 - np.einsum("...ij,...ij->...", d, d))
    # tr(C - I) - 2 (J - 1): terms of first order cancel
    gap = np.einsum("...ij,...ij->...", k.gradient, k.gradient) - 2.0 * k.minors
    y, rest = 2.0 / 3.0 * np.log1p(x), 2.0 * less_logarithm(x)
    first = np.exp(-y) * (gap - 3.0 * less_exponential(y) + rest)
    second = np.exp(-2.0 * y) * (2.0 * (gap + rest) + minors - 3.0 * less_exponential(2.0 * y))
    return first, second


def _logarithms(strain: Array, k: Kinematics) -> Array:
    """(..., 3) ln l_i' from the principal values of C - I; they sum to zero."""
    whole = 0.5 * np.log1p(strain)
    return np.asarray(whole - np.log1p(k.dilation)[..., None] / 3.0)


def _divided_difference(power: float, gap: Array) -> Array:
    """(y^power - 1)/(y - 1) with y = exp(gap)."""
    same = gap == 0.0
    safe = np.where(same, 1.0, gap)
    return np.where(same, power, np.expm1(power * safe) / np.expm1(safe))


def _shrink(k: Kinematics) -> Array:
    """(...,) J^(-2/3)."""
    return np.exp(-2.0 / 3.0 * np.log1p(k.dilation))


def _deviator(a: Array) -> Array:
    mean = np.trace(a, axis1=-2, axis2=-1) / 3.0
    return np.asarray(a - mean[..., None, None] * np.eye(3))


def _outer(a: Array, b: Array) -> Array:
    return np.asarray(a[..., :, None] * b[..., None, :])


def _symmetric_product(a: Array) -> Array:
    """(..., 6, 6) of (a_IK a_JL + a_IL a_JK)/2 for (..., 3, 3)."""
    straight = a[..., _I[:, None], _I] * a[..., _J[:, None], _J]
    return np.asarray(0.5 * (straight + a[..., _I[:, None], _J] * a[..., _J[:, None], _I]))
