"""Closed-form solutions of finite elasticity that verify the reference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_common.arrays import Array


@dataclass(frozen=True)
class InflatedThickSphere:
    """Incompressible Mooney-Rivlin hollow sphere under inner pressure (Ogden 1984, section 5.3.2).

    A point at radius r0 moves to r with r^3 = r0^3 + a^3 (l_a^3 - 1); l = r / r0 is its hoop stretch. The pressure
    on the deformed inner surface is
    P = c1 [4/l_b + l_b^-4 - 4/l_a - l_a^-4] + c2 [4 l_a - 2/l_a^2 - 4 l_b + 2/l_b^2].

    Attributes
    ----------
    inner_radius, outer_radius : a and b of the undeformed sphere [m]
    shear_modulus : G = 2 (c1 + c2) [Pa]
    inner_stretch : l_a, the hoop stretch at the inner surface
    second_share : c2 / (c1 + c2), zero for the neo-Hookean body
    """

    inner_radius: float
    outer_radius: float
    shear_modulus: float
    inner_stretch: float
    second_share: float = 0.0

    @property
    def pressure(self) -> float:
        """P [Pa]."""
        l_a, l_b = self.inner_stretch, float(self.stretch(self.outer_radius))
        first = 4.0 / l_b + l_b**-4 - 4.0 / l_a - l_a**-4
        second = 4.0 * l_a - 2.0 * l_a**-2 - 4.0 * l_b + 2.0 * l_b**-2
        share = self.second_share
        return 0.5 * self.shear_modulus * ((1.0 - share) * first + share * second)

    @property
    def energy(self) -> float:
        """Elastic energy of the whole sphere, the work of the pressure on the inner volume [J]."""
        # dW = P dV with V = 4/3 pi a^3 l_a^3; Gauss-Legendre is exact to rounding for so smooth an integrand.
        nodes, weights = np.polynomial.legendre.leggauss(40)
        stretches = 1.0 + 0.5 * (self.inner_stretch - 1.0) * (nodes + 1.0)
        pressures = [replace(self, inner_stretch=s).pressure for s in stretches.tolist()]
        integral = 0.5 * (self.inner_stretch - 1.0) * np.sum(weights * pressures * stretches**2)
        return float(4.0 * np.pi * self.inner_radius**3 * integral)

    def stretch(self, radius: Array | float) -> Array:
        """Hoop stretch at undeformed radii."""
        r = np.asarray(radius, dtype=np.float64)
        return np.asarray(np.cbrt(1.0 + (self.inner_stretch**3 - 1.0) * (self.inner_radius / r) ** 3))

    def radial_displacement(self, radius: Array | float) -> Array:
        """Radial displacement at undeformed radii [m]."""
        return np.asarray((self.stretch(radius) - 1.0) * radius)
