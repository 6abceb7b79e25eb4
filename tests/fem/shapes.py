"""Tetrahedral test bodies by numpy and scikit-fem, and short cuts to set problems up on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.testing import assert_allclose
from numpy.typing import ArrayLike, NDArray
from skfem import MeshTet

from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.linear import LinearProblem, Load
from solver_common.quadrature import facet_quadrature
from solver_common.solution import Solution

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Body:
    """Points, tetrahedra and their outward boundary."""

    points: Array
    tetrahedra: Index
    surface_nodes: Index
    triangles: Index

    @property
    def arrays(self) -> tuple[Array, Index, Index, Index]:
        return self.points, self.tetrahedra, self.surface_nodes, self.triangles

    @property
    def surface(self) -> Array:
        return self.points[self.surface_nodes]

    @property
    def quadrature_points(self) -> Array:
        """(F, Q, 3) facet quadrature points."""
        return np.einsum("qa,fai->fqi", facet_quadrature()[0], self.surface[self.triangles])

    @property
    def area_vectors(self) -> Array:
        x = self.surface[self.triangles]
        return 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])

    @property
    def bottom(self) -> NDArray[np.bool_]:
        """(N,) vertices in the plane z = 0."""
        return self.surface[:, 2] == 0.0

    @property
    def top(self) -> NDArray[np.bool_]:
        """(F,) facets in the plane z = 1."""
        return self.facets_where(lambda x: x[:, 2] == 1.0)

    def facets_where(self, on: Callable[[Array], NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """(F,) facets whose three vertices all satisfy `on`."""
        return on(self.surface)[self.triangles].all(axis=1)

    def held_at(self, *places: tuple[ArrayLike, Sequence[int]]) -> NDArray[np.bool_]:
        """(N, 3) single components held at the nodes nearest to some points."""
        held = np.zeros((len(self.surface_nodes), 3), dtype=bool)
        for point, components in places:
            held[np.argmin(np.linalg.norm(self.surface - np.asarray(point), axis=1)), list(components)] = True
        return held

    def load(
        self, pressure: ArrayLike = 0.0, prescribed: ArrayLike = 0.0, gravity: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Load:
        """A load from anything that broadcasts; an (F,) pressure is uniform on each facet."""
        pressure = np.asarray(pressure, dtype=float)
        if pressure.shape == (len(self.triangles),):
            pressure = pressure[:, None]
        return Load(
            facet_pressure=np.broadcast_to(pressure, (len(self.triangles), len(facet_quadrature()[1]))),
            prescribed=np.broadcast_to(np.asarray(prescribed, dtype=float), (len(self.surface_nodes), 3)),
            gravity=np.asarray(gravity, dtype=float),
        )

    def problem(self, held: ArrayLike, **options: object) -> LinearProblem:
        """A problem with E = 1 and nu = 0.3 unless told otherwise."""
        settings: dict[str, object] = {"youngs_modulus": 1.0, "poisson_ratio": 0.3, **options}
        return LinearProblem(*self.arrays, held=held, **settings)  # type: ignore[arg-type]

    def finite(self, held: ArrayLike, **options: object) -> FiniteStrainProblem:
        """The same at finite strain."""
        settings: dict[str, object] = {"youngs_modulus": 1.0, "poisson_ratio": 0.3, **options}
        return FiniteStrainProblem(*self.arrays, held=held, **settings)  # type: ignore[arg-type]


FIELDS = ("displacement", "reaction_force", "fluid_pressure", "energy")


def assert_same(found: Solution, expected: Solution, tolerance: float) -> None:
    """Outcomes and all fields, each to a share of its largest value."""
    assert [status.code for status in found.status] == [status.code for status in expected.status]
    for name in FIELDS:
        value = getattr(expected, name)
        atol = tolerance * np.abs(value).max()
        assert_allclose(getattr(found, name), value, rtol=0, atol=atol, err_msg=name)


def body(points: ArrayLike, tetrahedra: ArrayLike) -> Body:
    """Orient the tetrahedra and find their boundary."""
    p = np.array(points, dtype=float)
    t = np.array(tetrahedra, dtype=np.int64)
    edges = p[t[:, 1:]] - p[t[:, :1]]
    inverted = np.linalg.det(edges) < 0.0
    t[inverted] = t[inverted][:, [0, 2, 1, 3]]
    faces = np.concatenate([t[:, [1, 2, 3]], t[:, [0, 3, 2]], t[:, [0, 1, 3]], t[:, [0, 2, 1]]])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    boundary = faces[first[count == 1]]
    nodes = np.unique(boundary)
    return Body(p, t, nodes, np.searchsorted(nodes, boundary))


def cube(n: int, *, distort: float = 0.0) -> Body:
    """Unit cube with n cells a side; inner points moved by up to `distort` of a cell."""
    ticks = np.linspace(0.0, 1.0, n + 1)
    mesh = MeshTet.init_tensor(ticks, ticks, ticks)
    points = mesh.p.T.copy()
    inner = ((points > 1e-9) & (points < 1.0 - 1e-9)).all(axis=1)
    points[inner] += np.random.default_rng(1).uniform(-distort, distort, (inner.sum(), 3)) / n
    return body(points, mesh.t.T)


def ball(refinements: int, radius: float = 1.0) -> Body:
    """Ball with vertices on the sphere: 8 * 8^refinements tetrahedra."""
    mesh = MeshTet.init_ball(refinements)
    return body(radius * mesh.p.T, mesh.t.T)


def mapped_box(cells: tuple[int, int, int], shape: Callable[[Array], Array]) -> Body:
    """The image of a structured unit box under `shape`, (n, 3) to (n, 3)."""
    mesh = MeshTet.init_tensor(*(np.linspace(0.0, 1.0, n + 1) for n in cells))
    return body(shape(mesh.p.T), mesh.t.T)


def octant_shell(inner: float, outer: float, layers: int, rows: int) -> Body:
    """Octant of a hollow sphere: `layers` of prisms under a triangle cut into rows^2, each into three."""
    corner = {}
    for i in range(rows + 1):
        for j in range(rows + 1 - i):
            corner[i, j] = len(corner)
    flat = np.array([(i, j, rows - i - j) for i, j in corner], dtype=float) / rows
    # Equal angles instead of equal chords: the facets on the sphere come out nearly alike.
    directions = np.sin(0.5 * np.pi * flat)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    cells = []
    for i in range(rows):
        for j in range(rows - i):
            cells.append((corner[i, j], corner[i + 1, j], corner[i, j + 1]))
            if i + j < rows - 1:
                cells.append((corner[i + 1, j], corner[i + 1, j + 1], corner[i, j + 1]))
    triangles = np.sort(np.array(cells), axis=1)
    radii = np.linspace(inner, outer, layers + 1)
    points = (radii[:, None, None] * directions).reshape(-1, 3)
    points[np.abs(points) < 1e-12] = 0.0
    n = len(directions)
    # Splitting every prism along the order of its vertices makes neighbours agree on their diagonals.
    a, b, c = triangles.T
    split = [(a, b, c, c + n), (a, b, b + n, c + n), (a, a + n, b + n, c + n)]
    single = np.concatenate([np.column_stack(parts) for parts in split])
    return body(points, np.concatenate([single + layer * n for layer in range(layers)]))


def pressed_shell(n: int) -> tuple[Body, NDArray[np.bool_]]:
    """Octant of the shell between radii 1 and 2 in n layers, and its inner facets."""
    b = octant_shell(1.0, 2.0, n, 3 * n // 2)
    return b, b.facets_where(lambda x: np.linalg.norm(x, axis=1) < 1.0 + 1e-9)
