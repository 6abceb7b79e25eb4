"""How far boundary elements and elements are from exact answers.

A ball under a normal traction P_2 or P_3, and a bar four times as long as thick in pure bending; three meshes of
each, the edges of the next half as long. A part of the surface is held at the exact displacement. Five minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fem_reference.exact import IncompressibleBall
from fem_reference.linear import LinearProblem, Load
from solver_common.arrays import Array, Mask
from solver_common.quadrature import facet_quadrature
from tests.fem.shapes import Body, ball, mapped_box
from tools.documents import ROOT, show, table
from tools.evidence import EVIDENCE, kept
from vdm import Load as SurfaceLoad
from vdm import Model, Parameters, SurfaceMesh
from vdmbench.body.surface_measures import deformations, relative_l2

HEAD = ("exact answer", "nu", "nodes", "bem", "order", "FEM, this mesh", "order")
SHEAR_MODULUS = 1.0
SIDES = np.array([4.0, 1.0, 1.0])


@dataclass(frozen=True)
class Anchor:
    """A body of three meshes under a pressure, all exact: functions of (n, 3) points."""

    name: str
    poisson_ratio: float
    meshes: tuple[Callable[[], Body], ...]
    displacement: Callable[[Array], Array]  # (n, 3)
    pressure: Callable[[Array], Array]  # (n,), along the normal into the body
    held: Callable[[Array], Mask]  # (n,)


def _ball(degree: int) -> Anchor:
    exact = IncompressibleBall(radius=1.0, shear_modulus=SHEAR_MODULUS, degree=degree, traction=1.0)
    return Anchor(
        f"ball under P_{degree}",
        0.5,
        tuple(lambda n=n: ball(n) for n in (2, 3, 4)),
        exact.displacement,
        lambda x: -exact.surface_traction(x),
        lambda x: x[:, 2] < -0.8,
    )


def _bar(nu: float) -> Anchor:
    """Timoshenko and Goodier, Theory of Elasticity, article 102; curvature 1."""

    def displacement(points: Array) -> Array:
        x, y, z = points.T
        return np.stack([x * z, -nu * y * z, -0.5 * (x**2 + nu * z**2 - nu * y**2)], axis=1)

    def pressure(points: Array) -> Array:
        stress = 2.0 * (1.0 + nu) * SHEAR_MODULUS * points[:, 2]
        return np.where(points[:, 0] > SIDES[0] - 1e-9, -stress, 0.0)

    def mesh(n: int) -> Body:
        return mapped_box((4 * n, n, n), lambda x: (x - [0.0, 0.5, 0.5]) * SIDES)

    meshes = tuple(lambda n=n: mesh(n) for n in (2, 4, 8))
    return Anchor("bar in pure bending", nu, meshes, displacement, pressure, lambda x: x[:, 0] < 1e-9)


ANCHORS = (_ball(2), _ball(3), _bar(0.3), _bar(0.5))


def boundary(anchor: Anchor, body: Body, pressure: Array) -> Array:
    """(N, 3) answer of boundary elements to (F, Q) pressures at the points of the facets."""
    points, weights = facet_quadrature()
    surface, held = SurfaceMesh(body.surface, body.triangles), anchor.held(body.surface)
    shares = (pressure * weights) @ points
    force = np.zeros_like(surface.points)
    np.add.at(force, body.triangles, -shares[:, :, None] * body.area_vectors[:, None])
    material = Parameters(shear_modulus=SHEAR_MODULUS, poisson_ratio=anchor.poisson_ratio)
    model = Model(surface.points, body.triangles, material, formulation="bem", constrained=held)
    given = anchor.displacement(body.surface) * held[:, None]
    return model.solve([SurfaceLoad(np.zeros(len(held)), force, given)]).displacement[0]


def elements(anchor: Anchor, body: Body, pressure: Array) -> Array:
    """(N, 3) answer of P2-P1 elements at the vertices of the surface."""
    held, nu = anchor.held(body.surface), anchor.poisson_ratio
    young = 2.0 * (1.0 + nu) * SHEAR_MODULUS
    problem = LinearProblem(*body.arrays, youngs_modulus=young, poisson_ratio=nu, held=held)
    given = anchor.displacement(body.surface) * held[:, None]
    return problem.solve([Load(pressure, given, np.zeros(3))]).displacement[0]


def errors(anchor: Anchor, make: Callable[[], Body]) -> tuple[int, Array]:
    """Nodes, and errors (2, 2) of the form and the elements, in displacement and change of shape."""
    body = make()
    at = body.quadrature_points
    pressure = anchor.pressure(at.reshape(-1, 3)).reshape(at.shape[:2])
    exact, areas = anchor.displacement(body.surface), SurfaceMesh(body.surface, body.triangles).nodal_areas
    found = []
    for answer in (boundary(anchor, body, pressure), elements(anchor, body, pressure)):
        shapes = deformations(body.surface, np.stack([answer, exact]), areas)
        found.append([relative_l2(answer, exact, areas), relative_l2(shapes[0], shapes[1], areas)])
    return len(exact), np.array(found)


def rows_of(anchor: Anchor) -> Iterator[list[str]]:
    """A row for each mesh, with the order from the one before."""
    found = [errors(anchor, make) for make in anchor.meshes]
    orders = [None, *(np.log2(coarse / fine) for (_, coarse), (_, fine) in pairwise(found))]
    for (nodes, error), order in zip(found, orders, strict=True):
        cells = []
        for k in range(2):
            cells.append(" / ".join(f"{100.0 * value:.2g}" for value in error[k]))
            cells.append("" if order is None else " / ".join(f"{value:.1f}" for value in order[k]))
        yield [anchor.name, f"{anchor.poisson_ratio:g}", str(nodes), *cells]


def finest(rows: Sequence[Sequence[str]]) -> list[Sequence[str]]:
    """The rows of the page: of each answer and ratio the last mesh."""
    return list({tuple(row[:2]): row for row in rows}.values())


def main(name: str, _: Sequence[str]) -> None:
    """Solve all and write the table."""
    own = EVIDENCE[name]
    rows = kept(own["all_rows"], HEAD, [row for anchor in ANCHORS for row in rows_of(anchor)])
    show(ROOT / own["document"], own["part"], table(HEAD, finest(rows)))
