"""Rules for double integrals over two triangles, by what the triangles share.

A point of a triangle is given by its barycentric coordinates. Where two triangles touch, the kernel 1/r has a pole
or a line of poles. The maps of Sauter and Schwab (Boundary Element Methods, 2011, section 5.2) take it out: they
write the domain as a few unit cubes whose Jacobian cancels it, so that Gauss points converge exponentially. In one
direction, away from a shared corner, flat triangles scale: there one point is exact.
"""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np

from solver_common.arrays import Array

Rule = tuple[Array, Array, Array]

# Gauss points in each of the three directions of a map in which the triangles do not scale
SINGULAR_ORDER = 6


def three_points() -> tuple[Array, Array]:
    """(3, 3) points and (3,) weights of sum 1, exact to degree 2."""
    points = np.full((3, 3), 1.0 / 6.0)
    np.fill_diagonal(points, 2.0 / 3.0)
    return points, np.full(3, 1.0 / 3.0)


def sixteen_points() -> tuple[Array, Array]:
    """(16, 3) points and (16,) weights of sum 1, exact to degree 8.

    Source: Dunavant 1985, Int. J. Numer. Methods Eng. 21.
    """
    orbits = [
        (0.144315607677787, (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)),
        (0.095091634267285, (0.081414823414554, 0.459292588292723, 0.459292588292723)),
        (0.103217370534718, (0.658861384496480, 0.170569307751760, 0.170569307751760)),
        (0.032458497623198, (0.898905543365938, 0.050547228317031, 0.050547228317031)),
        (0.027230314174435, (0.008394777409958, 0.263112829634638, 0.728492392955404)),
    ]
    points, weights = [], []
    for weight, corners in orbits:
        orbit = sorted(set(permutations(corners)))
        points += orbit
        weights += [weight] * len(orbit)
    total = np.array(weights)
    return np.array(points), total / total.sum()


@cache
def touching() -> tuple[Rule, Rule, Rule]:
    """Rules (points of the first triangle (n, 3), of the second, weights (n,)) for one vertex, one edge or all
    three vertices in common; shared vertices come first, in the same order, in both triangles.

    They integrate kernels of degree -1, and of degree -2 times a function that is linear on either triangle. At
    the share x of the way from the first vertex, with x^3 of the Jacobian, the integrand is x times a linear
    function of x. Its integral is half of that function at 2/3.
    """
    nodes, weights = np.polynomial.legendre.leggauss(SINGULAR_ORDER)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    a, b, c = (part.ravel() for part in np.meshgrid(nodes, nodes, nodes, indexing="ij"))
    x = 2.0 / 3.0
    cube = 0.5 / x * np.prod(np.meshgrid(weights, weights, weights, indexing="ij"), axis=0).ravel()
    one = np.ones_like(a)
    vertex = [((one, a), (b, b * c), b)]
    vertex += [(second, first, share) for first, second, share in vertex]
    edge = [
        ((one, a * c), (1 - a * b, a * (1 - b)), a**2),
        ((one, a), (1 - a * b * c, a * b * (1 - c)), a**2 * b),
        ((1 - a * b, a * (1 - b)), (one, a * b * c), a**2 * b),
        ((1 - a * b * c, a * b * (1 - c)), (one, a), a**2 * b),
        ((1 - a * b * c, a * (1 - b * c)), (one, a * b), a**2 * b),
    ]
    same = [
        ((one, 1 - a + a * b), (1 - a * b * c, 1 - a), a**2 * b),
        ((one, a * (1 - b + b * c)), (1 - a * b, a * (1 - b)), a**2 * b),
        ((1 - a * b * c, a * (1 - b * c)), (one, a * (1 - b)), a**2 * b),
    ]
    same += [(second, first, share) for first, second, share in same]
    return tuple(  # type: ignore[return-value]
        (
            np.concatenate([_barycentric(x * p, x * q) for (p, q), _, _ in cubes]),
            np.concatenate([_barycentric(x * p, x * q) for _, (p, q), _ in cubes]),
            np.concatenate([4.0 * cube * x**3 * share for _, _, share in cubes]),
        )
        for cubes in (vertex, edge, same)
    )


def _barycentric(first: Array, second: Array) -> Array:
    """(n, 3) coordinates of points of the triangle 0 <= second <= first <= 1."""
    return np.stack([1.0 - first, first - second, second], axis=1)
