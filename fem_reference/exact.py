"""Closed-form solutions of linear elasticity that verify the reference.

Displacements are in metres, stresses in pascals; every body is centred at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Legendre

from solver_common.arrays import Array


@dataclass(frozen=True)
class ThickSphere:
    """Hollow sphere under inner pressure (Lame; Timoshenko and Goodier, Theory of Elasticity, art. 136).

    Attributes
    ----------
    inner_radius, outer_radius : [m]
    youngs_modulus : [Pa]
    poisson_ratio : in (-1, 0.5]
    pressure : on the inner surface [Pa]
    """

    inner_radius: float
    outer_radius: float
    youngs_modulus: float
    poisson_ratio: float
    pressure: float

    def radial_displacement(self, radius: Array | float) -> Array:
        """Radial displacement at the given radii, u = A r + B / r^2."""
        a, b, nu = self.inner_radius**3, self.outer_radius**3, self.poisson_ratio
        r = np.asarray(radius, dtype=np.float64)
        dilation = (1.0 - 2.0 * nu) * r  # over E: 1 / (3 K)
        shear = 0.5 * (1.0 + nu) * b / r**2  # over E: 1 / (4 G)
        return np.asarray(self.pressure * a / (b - a) * (dilation + shear) / self.youngs_modulus)

    @property
    def mean_pressure(self) -> float:
        """-tr(stress)/3, the same everywhere and for every material [Pa]."""
        a, b = self.inner_radius**3, self.outer_radius**3
        return -self.pressure * a / (b - a)


@dataclass(frozen=True)
class LayeredSphere:
    """Hollow sphere of concentric layers under inner pressure: Lame's solution in each (see `ThickSphere`).

    In a layer u = s (1 - 2 nu) r / E + B / r^2 and the radial stress is s - 4 G B / r^3; displacement and radial
    stress are continuous, the outer surface is free.

    Attributes
    ----------
    radii : of the surfaces, from the inside out, one more than layers [m]
    youngs_moduli : [Pa]
    poisson_ratios : in (-1, 0.5]
    pressure : on the inner surface [Pa]
    """

    radii: tuple[float, ...]
    youngs_moduli: tuple[float, ...]
    poisson_ratios: tuple[float, ...]
    pressure: float

    def radial_displacement(self, radius: Array | float) -> Array:
        """Radial displacement at the given radii [m]."""
        r = np.asarray(radius, dtype=np.float64)
        constants = self._constants
        layer = np.clip(np.searchsorted(self.radii, r, side="right") - 1, 0, len(constants) - 1)
        compliance = np.array(self._compliances)
        return np.asarray(constants[layer, 0] * compliance[layer] * r + constants[layer, 1] / r**2)

    @property
    def _compliances(self) -> list[float]:
        return [(1.0 - 2.0 * nu) / e for e, nu in zip(self.youngs_moduli, self.poisson_ratios, strict=True)]

    @property
    def _constants(self) -> Array:
        """(layers, 2) s and B."""
        count = len(self.youngs_moduli)
        matrix, rhs = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        shear = [e / (2.0 + 2.0 * nu) for e, nu in zip(self.youngs_moduli, self.poisson_ratios, strict=True)]
        for k, radius in enumerate(self.radii):
            # the stress of the layer outside less that of the layer inside, and the displacement alike
            for layer, sign in ((k, 1.0), (k - 1, -1.0)):
                if 0 <= layer < count:
                    columns = slice(2 * layer, 2 * layer + 2)
                    matrix[2 * k - 1 if k else 0, columns] = sign, -4.0 * sign * shear[layer] / radius**3
                    if 0 < k < count:
                        matrix[2 * k, columns] = sign * self._compliances[layer] * radius, sign / radius**2
        rhs[0] = -self.pressure
        return np.asarray(np.linalg.solve(matrix, rhs).reshape(count, 2))


@dataclass(frozen=True)
class ThickCylinder:
    """Hollow cylinder under inner pressure in plane strain (Lame; MacNeal and Harder 1985).

    Attributes as in `ThickSphere`; the axis is free of axial strain.
    """

    inner_radius: float
    outer_radius: float
    youngs_modulus: float
    poisson_ratio: float
    pressure: float

    def radial_displacement(self, radius: Array | float) -> Array:
        """Radial displacement at the given distances from the axis, u = A r + B / r."""
        a, b, nu = self.inner_radius**2, self.outer_radius**2, self.poisson_ratio
        r = np.asarray(radius, dtype=np.float64)
        factor = self.pressure * a / (b - a) * (1.0 + nu) / self.youngs_modulus
        return np.asarray(factor * ((1.0 - 2.0 * nu) * r + b / r))

    @property
    def mean_pressure(self) -> float:
        """-tr(stress)/3, the same everywhere [Pa]."""
        a, b = self.inner_radius**2, self.outer_radius**2
        return -2.0 / 3.0 * (1.0 + self.poisson_ratio) * self.pressure * a / (b - a)


@dataclass(frozen=True)
class IncompressibleBall:
    """Solid incompressible ball under the normal traction `traction * P_n(cos theta)`, outward positive.

    Lamb's solution, regular at the centre: with the pressure p = alpha r^n P_n and the harmonic
    phi = beta r^n P_n the displacement is u_r = U P_n, u_theta = W dP_n/dtheta with

        U = n a r^(n+1) + n beta r^(n-1),  W = a (n+3)/(n+1) r^(n+1) + beta r^(n-1),  alpha = 2 G (2n+3) a.

    No shear at r = R gives beta = -a R^2 n(n+2) / ((n+1)(n-1)); the normal traction gives a. At the surface
    u_r = t n(2n+1) R / (2 G (n-1)(2n^2+4n+3)) P_n.

    Attributes
    ----------
    radius : [m]
    shear_modulus : [Pa]
    degree : n >= 2, since n = 0 moves nothing and n = 1 is no equilibrium
    traction : [Pa]
    """

    radius: float
    shear_modulus: float
    degree: int
    traction: float

    def __post_init__(self) -> None:
        if self.degree < 2:
            raise ValueError(f"degree is {self.degree}; give 2 or more")

    @property
    def surface_coefficient(self) -> float:
        """u_r / P_n at the surface [m]."""
        n = self.degree
        factor = n * (2 * n + 1) / (2.0 * (n - 1) * (2 * n * n + 4 * n + 3))
        return factor * self.traction * self.radius / self.shear_modulus

    def surface_traction(self, points: Array) -> Array:
        """(k,) outward normal traction in the direction of (k, 3) points [Pa]."""
        cosine = points[:, 2] / np.linalg.norm(points, axis=1)
        return np.asarray(self.traction * self._legendre(cosine))

    def displacement(self, points: Array) -> Array:
        """(k, 3) displacement at (k, 3) points other than the centre."""
        n, a, beta = self.degree, self._a, self._beta
        r = np.linalg.norm(points, axis=1)
        outward = points / r[:, None]
        cosine = outward[:, 2]
        radial = n * a * r ** (n + 1) + n * beta * r ** (n - 1)
        polar = a * (n + 3) / (n + 1) * r ** (n + 1) + beta * r ** (n - 1)
        # dP_n/dtheta e_theta = P_n'(cos theta) (e_z - cos theta e_r), regular on the axis.
        south = np.array([0.0, 0.0, 1.0]) - cosine[:, None] * outward
        return np.asarray(
            (radial * self._legendre(cosine))[:, None] * outward
            + (polar * self._legendre.deriv()(cosine))[:, None] * south
        )

    @property
    def _legendre(self) -> Legendre:
        return Legendre.basis(self.degree)

    @property
    def _a(self) -> float:
        n = self.degree
        denominator = 2.0 * self.shear_modulus * self.radius**n * (2 * n * n + 4 * n + 3)
        return -self.traction * (n + 1) / denominator

    @property
    def _beta(self) -> float:
        n = self.degree
        return -self._a * self.radius**2 * n * (n + 2) / ((n + 1) * (n - 1))
