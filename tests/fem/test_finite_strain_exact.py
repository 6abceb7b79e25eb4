"""The finite-strain reference against closed forms and manufactured solutions.

As in the linear anchors, flat facets cost an error of order h^2 on a curved body. It is shown apart: with exact
displacements given on the same flat-faceted surface, and with manufactured solutions on a cube, the error inside
falls with the element's own order.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp
from skfem import FacetBasis, LinearForm
from skfem.helpers import dot

from fem_reference.exact_finite_strain import InflatedThickSphere
from fem_reference.materials import MATERIALS
from fem_reference.mesh import TetMesh
from solver_common.quadrature import facet_quadrature
from tests.fem.convergence import Convergence, inner_error, relative_l2
from tests.fem.shapes import cube, pressed_shell
from tests.fem.test_materials import SHAPES, _curves
from tests.verification.records import Verified

Array = np.ndarray

# Order 2 of flat facets, in the maximum norm and on two meshes only.
_GEOMETRY_SLACK = 0.3


a_sphere = pytest.mark.anchor(
    "neo-Hookean thick sphere", "Ogden 1984, Non-Linear Elastic Deformations, section 5.3"
)
a_manufactured = pytest.mark.anchor(
    "manufactured solution, finite strain",
    "Roache 2002, doi 10.1115/1.1436090; orders of Taylor and Hood 1973, doi 10.1016/0045-7930(73)90027-3",
)


def _components_first(f: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """A function of (..., 3) points as scikit-fem has them, (3, ...)."""
    return lambda x: np.moveaxis(f(np.moveaxis(x, 0, -1)), -1, 0)


# ---------------------------------------------------------------- thick sphere


@a_sphere
@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.4999, 0.5])
def test_inflated_sphere(poisson_ratio: float, verified: Verified) -> None:
    """An octant on rollers under follower pressure; 30 % hoop stretch at the inner surface."""
    exact = InflatedThickSphere(1.0, 2.0, 1.0 / 3.0, 1.3)
    record = Convergence(
        f"u(a) on flat facets, l_a = 1.3, nu = {poisson_ratio}", 2.0, 0.0085, _GEOMETRY_SLACK
    )
    for n in (4, 8):
        b, inner = pressed_shell(n)
        problem = b.finite(b.surface == 0.0, poisson_ratio=poisson_ratio)
        s = problem.solve([b.load(exact.pressure * inner)])
        assert s.status[0].ok, s.status
        record.add(1.0 / n, inner_error(b, s.displacement[0], float(exact.radial_displacement(1.0))))
    record.check(verified)
    # What the facets cut off is missing from the energy too: order 2.
    verified.equal(f"energy, l_a = 1.3, nu = {poisson_ratio}", 8.0 * s.energy[0], exact.energy, rtol=0.012)


@a_sphere
@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.4999])
def test_inflated_sphere_without_its_geometry_error(poisson_ratio: float, verified: Verified) -> None:
    """Compressible: the radial boundary value problem by collocation, its solution given at the surface."""
    shear = 0.5 / (1.0 + poisson_ratio)
    lame = 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio)

    def radial_stress(radial: Array, hoop: Array) -> Array:
        return shear * (radial - 1.0 / radial) + lame * (radial * hoop**2 - 1.0) * hoop**2

    def slopes(r0: Array, y: Array) -> Array:
        r, radial = y
        hoop = r / r0
        hoop_slope = (radial - hoop) / r0
        hoop_stress = shear * (hoop - 1.0 / hoop) + lame * (radial * hoop**2 - 1.0) * radial * hoop
        # P_r' + 2 (P_r - P_h) / r0 = 0, with P_r' = dP_r/dradial radial' + dP_r/dhoop hoop'
        by_radial = shear * (1.0 + 1.0 / radial**2) + lame * hoop**4
        by_hoop = lame * (4.0 * radial * hoop**3 - 2.0 * hoop)
        balance = -2.0 * (radial_stress(radial, hoop) - hoop_stress) / r0 - by_hoop * hoop_slope
        return np.array([radial, balance / by_radial])

    grid = np.linspace(1.0, 2.0, 41)
    start = InflatedThickSphere(1.0, 2.0, 1.0, 1.3)
    guess = np.array([grid + start.radial_displacement(grid), start.stretch(grid) ** -2])
    result = solve_bvp(
        slopes,
        lambda ya, yb: np.array([ya[0] - 1.3, radial_stress(yb[1], yb[0] / 2.0)]),
        grid,
        guess,
        tol=1e-9,
        max_nodes=20000,
    )
    assert result.success

    def displacement(x: Array) -> Array:
        """(..., 3)"""
        r0 = np.linalg.norm(x, axis=-1, keepdims=True)
        return np.asarray(x * (result.sol(r0)[0] / r0 - 1.0))

    record = Convergence(f"L2 of u without geometry error, nu = {poisson_ratio}", 3.0, 3.2e-4)
    for n in (4, 8):
        b, _ = pressed_shell(n)
        everywhere = np.ones(len(b.surface), dtype=bool)
        problem = b.finite(everywhere, poisson_ratio=poisson_ratio)
        given = displacement(problem.mesh.node_points)
        fields = problem.solve_nodal(np.zeros((1, *given.shape)), given[None])
        basis, _ = problem.mesh.bases(intorder=6)
        found = fields.displacement[0].ravel()
        record.add(1.0 / n, relative_l2(basis, found, _components_first(displacement)))
    record.check(verified)


# ---------------------------------------------------------------- manufactured solutions


@dataclass(frozen=True)
class Manufactured:
    """A smooth deformation of the unit cube for any Poisson ratio, with the forces that hold it.

    A stretch along z with J = 1 + (1 - 2 nu) c h'(z), followed by two shears that keep the volume:
    (x, y, z) -> (x + A sin y', y, z') -> z'' = z' + B sin x'. The pressure p = -lambda (J - 1) = -2 G nu c h'(z) is
    finite for every nu, and at nu = 1/2 the deformation keeps the volume at every point.
    Derivatives of the stress by complex steps, exact to rounding. G = 1.
    """

    poisson_ratio: float
    shear_x: float = 0.25
    shear_z: float = 0.2
    dilation: float = 0.6

    def position(self, x: Array) -> Array:
        """(..., 3), real or complex."""
        first, second, third = x[..., 0], x[..., 1], x[..., 2]
        z = third + (1.0 - 2.0 * self.poisson_ratio) * self.dilation * np.sin(2.0 * third) / 2.0
        moved = first + self.shear_x * np.sin(2.0 * second + z)
        return np.stack([moved, second, z + self.shear_z * np.sin(2.0 * moved + second)], axis=-1)

    def displacement(self, x: Array) -> Array:
        return self.position(x) - x

    def pressure(self, x: Array) -> Array:
        return -2.0 * self.poisson_ratio * self.dilation * np.cos(2.0 * x[..., 2])

    def gradient(self, x: Array) -> Array:
        """(..., 3, 3) F, real or complex, by the chain rule."""
        compress = (1.0 - 2.0 * self.poisson_ratio) * self.dilation
        z = x[..., 2] + compress * np.sin(2.0 * x[..., 2]) / 2.0
        stretch = 1.0 + compress * np.cos(2.0 * x[..., 2])
        moved = x[..., 0] + self.shear_x * np.sin(2.0 * x[..., 1] + z)
        tilt = self.shear_x * np.cos(2.0 * x[..., 1] + z)
        lift = self.shear_z * np.cos(2.0 * moved + x[..., 1])
        f = np.zeros((*x.shape, 3), dtype=x.dtype)
        f[..., 0, 0] = 1.0
        f[..., 0, 1] = 2.0 * tilt
        f[..., 0, 2] = tilt * stretch
        f[..., 1, 1] = 1.0
        f[..., 2, :] = 2.0 * lift[..., None] * f[..., 0, :]
        f[..., 2, 1] += lift
        f[..., 2, 2] += stretch
        return f

    def stress(self, x: Array) -> Array:
        """(..., 3, 3) first Piola-Kirchhoff stress, written down independently of the law under test."""
        f = self.gradient(x)
        inverse = np.swapaxes(np.linalg.inv(f), -1, -2)
        j = 1.0 + (1.0 - 2.0 * self.poisson_ratio) * self.dilation * np.cos(2.0 * x[..., 2])
        return f - inverse - (self.pressure(x) * j)[..., None, None] * inverse

    def body_force(self, x: Array) -> Array:
        """(..., 3) -Div P."""
        out = np.zeros(x.shape)
        for k in range(3):
            shifted = x.astype(complex)
            shifted[..., k] += 1e-30j
            out -= self.stress(shifted)[..., k].imag / 1e-30
        return out


def _nodal_forces(mesh: TetMesh, case: Manufactured) -> Array:
    """Consistent nodal forces of the body force and of the traction on the top."""
    basis, _ = mesh.bases(intorder=8)
    points, weights = facet_quadrature()
    top = FacetBasis(
        mesh.skfem_mesh,
        basis.elem,
        facets=mesh.skfem_mesh.facets_satisfying(lambda x: x[2] > 1.0 - 1e-9),
        quadrature=(points[:, 1:].T, 0.5 * weights),
    )
    stress = case.stress(np.moveaxis(np.asarray(top.global_coordinates()), 0, -1))
    traction = np.einsum("fqij,jfq->ifq", stress, np.asarray(top.normals))
    body_force = _components_first(case.body_force)(np.asarray(basis.global_coordinates()))
    work = LinearForm(lambda v, w: dot(w.force, v))
    force = work.assemble(basis, force=body_force) + work.assemble(top, force=traction)
    return np.asarray(force).reshape(-1, 3)


def _manufactured_errors(case: Manufactured, n: int) -> tuple[float, float]:
    b = cube(n, distort=0.1)
    held = b.surface[:, 2] < 1.0
    held |= (b.surface[:, :2] == 0.0).any(axis=1) | (b.surface[:, :2] == 1.0).any(axis=1)
    problem = b.finite(
        held, youngs_modulus=2.0 * (1.0 + case.poisson_ratio), poisson_ratio=case.poisson_ratio
    )
    mesh = problem.mesh
    fields = problem.solve_nodal(_nodal_forces(mesh, case)[None], case.displacement(mesh.node_points)[None])
    assert fields.residual[0] <= 1e-9
    basis, pressures = mesh.bases(intorder=6)
    return (
        relative_l2(basis, fields.displacement[0].ravel(), _components_first(case.displacement)),
        relative_l2(pressures, fields.pressure[0], lambda x: case.pressure(np.moveaxis(x, 0, -1))),
    )


def _check_manufactured(
    verified: Verified,
    poisson_ratio: float,
    levels: tuple[int, ...],
    caps: tuple[float, float],
    slack: float,
) -> None:
    case = Manufactured(poisson_ratio)
    displacement = Convergence(f"nu = {poisson_ratio}: displacement", 3.0, caps[0], slack)
    pressure = Convergence(f"nu = {poisson_ratio}: pressure", 2.0, caps[1], slack)
    for n in levels:
        u, p = _manufactured_errors(case, n)
        displacement.add(1.0 / n, u)
        pressure.add(1.0 / n, p)
    displacement.check(verified)
    pressure.check(verified)


@a_manufactured
def test_manufactured_solution(verified: Verified) -> None:
    _check_manufactured(verified, 0.4999, (4, 8), (2e-4, 2.7e-3), 0.3)


@a_manufactured
@pytest.mark.slow
@pytest.mark.parametrize("poisson_ratio", [0.3, 0.4999, 0.5])
def test_manufactured_solution_on_fine_meshes(poisson_ratio: float, verified: Verified) -> None:
    _check_manufactured(verified, poisson_ratio, (8, 12), (6e-5, 1.15e-3), 0.15)


a_law = pytest.mark.anchor(
    "hyperelastic thick sphere", "Ogden 1984, Non-Linear Elastic Deformations, section 5.3.2"
)
_INNER_STRETCH = 1.3


def _pressure(name: str) -> float:
    """P = integral from l_b to l_a of W'(l)/(l^3 - 1), W' twice the equibiaxial stress at stretch l; G = 1/3."""
    outer = float(InflatedThickSphere(1.0, 2.0, 1.0, _INNER_STRETCH).stretch(2.0))

    def slope(stretch: float) -> float:
        equibiaxial = float(_curves(name, np.array([stretch]))[1][0]) / 6.0
        return 2.0 * equibiaxial / (stretch**3 - 1.0)

    return float(quad(slope, outer, _INNER_STRETCH, epsabs=1e-13)[0])


def test_the_shapes_are_those_of_every_law() -> None:
    assert set(SHAPES) | {"neo-hookean", "transversely-isotropic"} == set(MATERIALS)


@a_law
@pytest.mark.parametrize(("name", "share"), [("neo-hookean", 0.0), ("mooney-rivlin", 0.3)])
def test_pressure_by_quadrature_and_in_closed_form(name: str, share: float, verified: Verified) -> None:
    exact = InflatedThickSphere(1.0, 2.0, 1.0 / 3.0, _INNER_STRETCH, share)
    verified.equal(f"formula, {name}: P at l_a = 1.3", _pressure(name), exact.pressure, rtol=1e-12)


@a_law
@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_inflated_sphere_of_other_laws(name: str, verified: Verified) -> None:
    """An octant on rollers under follower pressure, incompressible; laws at a point are in `test_materials`."""
    exact = InflatedThickSphere(1.0, 2.0, 1.0 / 3.0, _INNER_STRETCH)
    record = Convergence(f"{name}: u(a) on flat facets, l_a = 1.3", 2.0, 0.016, 0.3)
    for n in (4, 6):
        b, inner = pressed_shell(n)
        law = {"material": name, "material_parameters": SHAPES[name]}
        s = b.finite(b.surface == 0.0, poisson_ratio=0.5, **law).solve([b.load(_pressure(name) * inner)])
        assert s.status[0].ok, s.status
        record.add(1.0 / n, inner_error(b, s.displacement[0], float(exact.radial_displacement(1.0))))
    record.check(verified)
