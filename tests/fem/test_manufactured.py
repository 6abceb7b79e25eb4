"""Manufactured solutions: observed orders, the error estimate, patch tests.

u = curl part + grad(chi) / lambda with p = -laplace(chi): smooth for every Poisson ratio, at nu = 0.5 without the
gradient part. Five faces of a distorted cube are held at exact values, the sixth carries the exact traction;
body force and traction enter through scikit-fem's own forms.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose
from skfem import ElementTetP1, FacetBasis, LinearForm
from skfem.helpers import dot

from fem_reference.linear import ELEMENTS
from tests.fem.convergence import Convergence, relative_l2
from tests.fem.shapes import Body, cube
from tests.verification.records import Verified

a_manufactured = pytest.mark.anchor(
    "manufactured solution, linear",
    "Roache 2002, doi 10.1115/1.1436090; orders of Taylor and Hood 1973, doi 10.1016/0045-7930(73)90027-3",
)
a_patch = pytest.mark.anchor(
    "patch tests, linear", "Taylor, Simo, Zienkiewicz and Chan 1986, doi 10.1002/nme.1620220105"
)

_A, _B, _C = 2.0, 1.5, 0.3  # wave numbers of the two parts, size of chi


@dataclass(frozen=True)
class Manufactured:
    """Exact fields at (3, ...) points, Young's modulus 1."""

    poisson_ratio: float

    @property
    def shear(self) -> float:
        return 0.5 / (1.0 + self.poisson_ratio)

    @property
    def compliance(self) -> float:
        """1 / lambda."""
        nu = self.poisson_ratio
        return (1.0 - 2.0 * nu) * (1.0 + nu) / nu

    def displacement(self, x: np.ndarray) -> np.ndarray:
        return self._curl(x) + self.compliance * self._chi_gradient(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        zero = np.zeros_like(x[0])
        curl = np.array(
            [
                [zero, _A * np.cos(_A * x[1] + 0.3), zero],
                [zero, zero, _A * np.cos(_A * x[2] + 0.1)],
                [_A * np.cos(_A * x[0] + 0.2), zero, zero],
            ]
        )
        return curl + self.compliance * self._chi_hessian(x)

    def pressure(self, x: np.ndarray) -> np.ndarray:
        return -np.trace(self._chi_hessian(x))

    def body_force(self, x: np.ndarray) -> np.ndarray:
        """-div(2 G strain - p I): the curl part has laplacian -A^2, chi -3 B^2."""
        gradient_share = 3.0 * _B**2 * (1.0 + 2.0 * self.shear * self.compliance)
        return self.shear * _A**2 * self._curl(x) + gradient_share * self._chi_gradient(x)

    def traction(self, x: np.ndarray, normal: np.ndarray) -> np.ndarray:
        g = self.gradient(x)
        return (
            self.shear * np.einsum("ij...,j...->i...", g + np.swapaxes(g, 0, 1), normal)
            - self.pressure(x) * normal
        )

    @staticmethod
    def _curl(x: np.ndarray) -> np.ndarray:
        return np.array([np.sin(_A * x[1] + 0.3), np.sin(_A * x[2] + 0.1), np.sin(_A * x[0] + 0.2)])

    @staticmethod
    def _chi_gradient(x: np.ndarray) -> np.ndarray:
        s, c = np.sin(_B * x + 0.2), np.cos(_B * x + 0.2)
        return _C * _B * np.array([c[0] * s[1] * s[2], s[0] * c[1] * s[2], s[0] * s[1] * c[2]])

    @staticmethod
    def _chi_hessian(x: np.ndarray) -> np.ndarray:
        s, c = np.sin(_B * x + 0.2), np.cos(_B * x + 0.2)
        d, xy = -s[0] * s[1] * s[2], c[0] * c[1] * s[2]
        xz, yz = c[0] * s[1] * c[2], s[0] * c[1] * c[2]
        return _C * _B**2 * np.array([[d, xy, xz], [xy, d, yz], [xz, yz, d]])


def _solve(element: str, poisson_ratio: float, n: int) -> dict[str, float]:
    """Relative L2 errors of displacement, pressure and strain."""
    exact = Manufactured(poisson_ratio)
    b = cube(n, distort=0.2)
    inside_free_face = (b.surface[:, 0] > 1.0 - 1e-9) & np.all(
        (b.surface[:, 1:] > 1e-9) & (b.surface[:, 1:] < 1.0 - 1e-9), axis=1
    )
    problem = b.problem(~inside_free_face, poisson_ratio=poisson_ratio, element=element, solver="direct")
    mesh = problem.mesh
    basis, _ = mesh.bases(intorder=4)
    free_face = mesh.skfem_mesh.facets_satisfying(lambda x: x[0] > 1.0 - 1e-9)
    face = FacetBasis(mesh.skfem_mesh, basis.elem, facets=free_face, intorder=6)
    force = LinearForm(lambda v, w: dot(exact.body_force(w.x), v)).assemble(basis)
    force = force + LinearForm(lambda v, w: dot(exact.traction(w.x, w.n), v)).assemble(face)
    given = exact.displacement(mesh.node_points.T).T
    fields = problem.solve_nodal(force.reshape(1, -1, 3), given[None])
    assert fields.residual[0] <= 1e-9

    u = fields.displacement[0].ravel()
    x, gradient = np.asarray(basis.global_coordinates()), basis.interpolate(u).grad
    strain, strain_h = (0.5 * (g + np.swapaxes(g, 0, 1)) for g in (exact.gradient(x), gradient))
    wrong, size = (np.sqrt((e**2 * basis.dx).sum()) for e in (strain_h - strain, strain))
    errors = {"displacement": relative_l2(basis, u, exact.displacement), "strain": float(wrong / size)}
    if problem.system.mixed:
        pressures = basis.with_element(ElementTetP1())
        errors["pressure"] = relative_l2(pressures, fields.pressure[0], exact.pressure)
    return errors


# element, Poisson ratio, caps on the finest error of displacement, strain and pressure at n = 8.
# The expected orders follow from the element: p + 1, p and, for the P1 pressure, 2.
ORDERS = [
    pytest.param("P2-P1", 0.3, (9e-5, 4e-3, 4e-3), marks=pytest.mark.slow),
    ("P2-P1", 0.4999, (8e-5, 3.5e-3, 4e-3)),
    pytest.param("P2-P1", 0.5, (8e-5, 3.5e-3, 4e-3), marks=pytest.mark.slow),
    ("P2-P1", 0.001, (2e-4, 6e-3, 5e-3)),  # lambda next to nothing: the gradient part dominates
    ("P2", 0.3, (9e-5, 4e-3, None)),
    ("P1", 0.3, (9e-3, 0.12, None)),
]


def _check_orders(
    verified: Verified, element: str, poisson_ratio: float, levels: tuple[int, ...], caps: list[float | None]
) -> None:
    order, mixed = ELEMENTS[element]
    title = f"{element}, nu = {poisson_ratio}"
    records = {
        name: Convergence(f"{title}: {name}", expected, cap)
        for name, expected, cap in zip(
            ("displacement", "strain", "pressure"), (order + 1, order, 2), caps, strict=True
        )
        if cap is not None
    }
    assert ("pressure" in records) == mixed
    for n in levels:
        errors = _solve(element, poisson_ratio, n)
        for name, record in records.items():
            record.add(1.0 / n, errors[name])
    for record in records.values():
        record.check(verified)


@a_manufactured
@pytest.mark.parametrize(("element", "poisson_ratio", "caps"), ORDERS)
def test_observed_orders(
    element: str, poisson_ratio: float, caps: tuple[float, float, float | None], verified: Verified
) -> None:
    _check_orders(verified, element, poisson_ratio, (4, 8), list(caps))


@a_manufactured
@pytest.mark.slow
@pytest.mark.parametrize(("element", "poisson_ratio", "caps"), ORDERS)
def test_observed_orders_on_fine_meshes(
    element: str, poisson_ratio: float, caps: tuple[float, float, float | None], verified: Verified
) -> None:
    order, _ = ELEMENTS[element]
    finer = [2.0 ** -(order + 1), 2.0**-order, 0.25]
    tightened = [None if cap is None else 1.1 * cap * factor for cap, factor in zip(caps, finer, strict=True)]
    _check_orders(verified, element, poisson_ratio, (8, 16), tightened)


@a_patch
@pytest.mark.parametrize("element", list(ELEMENTS))
def test_patch_under_given_displacement(element: str, verified: Verified) -> None:
    """Any linear field is reproduced inside a distorted mesh, stress and energy included."""
    b = cube(3, distort=0.3)
    g = np.random.default_rng(2).uniform(-0.1, 0.1, (3, 3))
    held = np.ones(len(b.surface_nodes), dtype=bool)
    problem = b.problem(held, poisson_ratio=0.3, element=element)
    given = problem.mesh.node_points @ g.T
    fields = problem.solve_nodal(np.zeros((1, *given.shape)), given[None])
    verified.at_most(f"{element}: linear field on a distorted mesh", fields.displacement[0] - given, 1e-11)
    if problem.system.mixed:
        lame = 0.3 / (1.3 * 0.4)
        assert_allclose(fields.pressure[0], -lame * np.trace(g), rtol=1e-10, atol=0)


def test_weight_and_its_hydrostatic_pressure() -> None:
    """Under gravity a column at nu = 0 on rollers shortens as w = rho g (z^2/2 - z) / E."""
    b: Body = cube(3, distort=0.3)
    rollers = b.surface < 1e-12
    problem = b.problem(rollers, poisson_ratio=0.0, youngs_modulus=4.0, density=2.0)
    s = problem.solve([b.load(gravity=(0.0, 0.0, -3.0))])
    z = b.surface[:, 2]
    exact = np.outer(2.0 * 3.0 * (0.5 * z**2 - z) / 4.0, [0.0, 0.0, 1.0])
    assert_allclose(s.displacement[0], exact, rtol=0, atol=1e-11)
    # Incompressible and floating in its own hydrostatic pressure it does not deform at all.
    depth = 1.0 - b.quadrature_points[:, :, 2]
    floating = b.problem(rollers, poisson_ratio=0.5, youngs_modulus=4.0, density=2.0)
    s = floating.solve([b.load(6.0 * depth, gravity=(0.0, 0.0, -3.0))])
    assert_allclose(s.displacement[0], 0.0, rtol=0, atol=1e-11)
    assert_allclose(s.fluid_pressure, 6.0 * 0.5, rtol=1e-12, atol=0)
