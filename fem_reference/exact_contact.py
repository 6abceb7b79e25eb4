"""Solutions of contact without friction that verify the reference: half-spaces, and a bonded layer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array

_POINTS = 32  # of Gauss and Legendre; the integrands are smooth


@dataclass(frozen=True)
class Hertz:
    """Sphere on a half-space (Johnson 1985, Contact Mechanics, section 4.2).

    F = 4/3 E' sqrt(R) d^(3/2), contact radius a = sqrt(R d), largest pressure 3 F / (2 pi a^2); E' = E/(1 - nu^2).

    Attributes
    ----------
    radius : R [m]
    depth : d [m]
    modulus : E' [Pa]
    """

    radius: float
    depth: float
    modulus: float

    @property
    def force(self) -> float:
        """F [N]."""
        return float(4.0 / 3.0 * self.modulus * np.sqrt(self.radius) * self.depth**1.5)

    @property
    def contact_radius(self) -> float:
        """The radius a [m]."""
        return float(np.sqrt(self.radius * self.depth))

    def pressure(self, r: Array) -> Array:
        """Pressure at distances from the axis [Pa]."""
        a = self.contact_radius
        largest = 1.5 * self.force / (np.pi * a**2)
        return np.asarray(largest * np.sqrt(np.clip(1.0 - (r / a) ** 2, 0.0, None)))


@dataclass(frozen=True)
class BondedLayer:
    """Paraboloid r^2 / (2 R) on an incompressible layer that is bonded to a rigid ground.

    The surface answers a pressure of wave number k by 2 L(k h) / (E' k), L(t) = (sinh 2t - 2t)/(cosh 2t + 1 + 2t^2)
    (Johnson 1985, Contact Mechanics, section 5.8). With the transform P(k) = 1/pi integral of q(s) cos(k s) over
    the contact 0 < s < a of the pressure, the displacement under the indenter is d - r^2 / (2 R) where

        q(s) - 2/pi integral of q(t) K(s, t) dt = E' (d - s^2/R),   K = integral of (1 - L) cos(k s) cos(k t) dk,

    a Fredholm equation of the second kind (Lebedev and Ufliand 1958); q(a) = 0 gives d, and F = 2 integral of q.

    Attributes
    ----------
    radius : R [m]
    thickness : h [m]
    contact_radius : a [m]
    youngs_modulus : E; E' = 4/3 E [Pa]
    """

    radius: float
    thickness: float
    contact_radius: float
    youngs_modulus: float

    @property
    def depth_and_force(self) -> tuple[float, float]:
        """d [m] and F [N]."""
        nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
        a, modulus = self.contact_radius, 4.0 / 3.0 * self.youngs_modulus
        s, weights = 0.5 * a * (nodes + 1.0), 0.5 * a * weights
        ends = np.append(s, a)
        kernel = 0.5 * (self._kernel(ends[:, None] + s) + self._kernel(ends[:, None] - s))
        matrix = np.eye(_POINTS) - 2.0 / np.pi * kernel[:-1] * weights
        # q is linear in d: q = E' (d one - two)
        one, two = np.linalg.solve(matrix, np.column_stack([np.ones(_POINTS), s**2 / self.radius])).T
        edge = 2.0 / np.pi * kernel[-1] * weights
        depth = (a**2 / self.radius + edge @ two) / (1.0 + edge @ one)
        return float(depth), float(2.0 * modulus * weights @ (depth * one - two))

    def _kernel(self, x: Array) -> Array:
        """Integral of (1 - L(k h)) cos(k x) dk, to k h = 25, where 1 - L is below 1e-18."""
        nodes, weights = np.polynomial.legendre.leggauss(200)
        k, weights = 12.5 * (nodes + 1.0), 12.5 * weights
        small = np.exp(-2.0 * k)
        share = 2.0 * small * (1.0 + 2.0 * k + 2.0 * k**2 + small)  # times e^(2 k), free of overflow
        share /= 1.0 + 2.0 * small * (1.0 + 2.0 * k**2) + small**2
        return np.asarray(np.cos(x[..., None] * k / self.thickness) @ (weights * share) / self.thickness)
