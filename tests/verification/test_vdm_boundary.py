"""Boundary elements against exact answers: potentials, the incompressible ball, mixed finite elements."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import eval_legendre

from tests.vdm.vdm_shapes import box, icosphere
from tests.verification.records import Verified
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.boundary.operators import Facets, surface_stiffness
from vdm.material import ball_compliance
from vdm.surface import rigid_basis


def ball(level: int) -> SurfaceMesh:
    return SurfaceMesh(*icosphere(level))


def ball_error(degree: int, level: int) -> float:
    """Relative error of u_r under P_n against the exact c_n; no resultant, so rigid motions may be held."""
    surface = ball(level)
    stiffness = surface_stiffness(Facets.of(surface.points, surface.triangles), 0.5)
    harmonic = eval_legendre(degree, surface.points[:, 2])
    areas = surface.vector_areas
    # the pressure is linear on each facet: a twelfth of a corner's own value and of all three
    corners = harmonic[surface.triangles]
    shares = (corners + corners.sum(axis=1, keepdims=True)) / 12.0
    force = np.zeros_like(surface.points)
    np.add.at(force, surface.triangles, shares[:, :, None] * surface.facet_vectors[:, None])
    force = force.reshape(-1)
    gradient = surface.area_vectors.reshape(-1)
    rigid = rigid_basis(surface)
    stiffness = stiffness + np.abs(np.diagonal(stiffness)).max() * rigid @ rigid.T
    both = np.linalg.solve(stiffness, np.stack([force, gradient], axis=1))
    u = both[:, 0] - both[:, 1] * (gradient @ both[:, 0]) / (gradient @ both[:, 1])
    radial = np.einsum("ic,ic->i", u.reshape(-1, 3), surface.normals)
    return float(
        (areas * harmonic) @ radial / ((areas * harmonic) @ harmonic) / ball_compliance(degree) - 1.0
    )


@pytest.mark.anchor("VDM: convergence with the mesh", "exact ball, `fem_reference.exact.IncompressibleBall`")
@pytest.mark.slow
@pytest.mark.parametrize("degree", [2, 3, 4])
def test_incompressible_ball_without_a_fit(degree, verified: Verified):
    errors = np.abs([ball_error(degree, level) for level in (1, 2, 3)])
    orders = np.log2(errors[:-1] / errors[1:])
    print(degree, errors, orders)
    # 642 nodes: wave length over mesh size falls as 1 / n
    verified.at_most(f"boundary: gain at 42 nodes, n = {degree}", errors[0], 0.1)
    verified.at_most(f"boundary: gain at 642 nodes, n = {degree}", errors[-1], 0.01 * (degree - 1))
    assert orders[-1] > 1.4


FORCE = np.array([0.3, -0.2, 1.0])


def kelvin(x: np.ndarray, normal: np.ndarray, nu: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and traction (n, 3) at x of FORCE at the origin, mu = 1 (Brebbia et al. 1984, section 5.2)."""
    r = np.linalg.norm(x, axis=-1, keepdims=True)
    e, c = x / r, 1.0 - 2.0 * nu
    along = (e @ FORCE)[..., None]
    out, into = (e * normal).sum(axis=-1, keepdims=True), (normal @ FORCE)[..., None]
    u = ((3.0 - 4.0 * nu) * FORCE + e * along) / (16.0 * np.pi * (1.0 - nu) * r)
    t = -(out * (c * FORCE + 3.0 * e * along) + c * (e * into - normal * along))
    return u, t / (8.0 * np.pi * (1.0 - nu) * r**2)


def block_error(n: int, nu: float) -> tuple[int, float]:
    """Nodes, and relative error of the deformation of a block 2 : 2 : 2 with a flat base held at Kelvin's field."""
    points, triangles = box(n)
    surface = SurfaceMesh(points, triangles)
    points = points - [0.5, 0.4, 1.6]
    weights, at = np.polynomial.legendre.leggauss(6)[::-1]
    at, weights = 0.5 * (at + 1.0), 0.5 * weights
    a, b = (part.ravel() for part in np.meshgrid(at, at, indexing="ij"))
    shares = np.stack([1.0 - a, a * (1.0 - b), a * b], axis=1)
    weights = np.outer(weights, weights).ravel() * 2.0 * a
    samples = np.einsum("qa,fac->fqc", shares, points[triangles])
    normals = surface.facet_vectors / surface.facet_areas[:, None]
    t = kelvin(samples, np.broadcast_to(normals[:, None], samples.shape), nu)[1]
    force = np.zeros_like(points)
    np.add.at(force, triangles, np.einsum("fqc,q,qa,f->fac", t, weights, shares, surface.facet_areas))
    exact = kelvin(points, np.zeros_like(points), nu)[0]
    base = surface.points[:, 2] < 1e-9
    model = Model(
        surface.points,
        triangles,
        Parameters(shear_modulus=1.0, poisson_ratio=nu),
        formulation="bem",
        constrained=base,
    )
    found = model.solve([Load(np.zeros(len(points)), force, exact * base[:, None])]).displacement[0]
    rigid = rigid_basis(surface)
    deformed = exact.reshape(-1) - rigid @ (rigid.T @ exact.reshape(-1))
    areas = surface.nodal_areas[:, None]
    error = (areas * (found - exact) ** 2).sum() / (areas * deformed.reshape(-1, 3) ** 2).sum()
    return len(points), float(np.sqrt(error))


@pytest.mark.anchor("VDM: convergence with the mesh", "exact field, Kelvin's point force outside a block")
@pytest.mark.slow
@pytest.mark.parametrize("nu", [-0.3, 0.0, 0.3, 0.45, 0.49, 0.5])
def test_the_error_falls_with_the_square_of_the_mesh_size(nu: float, verified: Verified):
    """A block has its exact geometry on every mesh. Linear displacements: order 2."""
    sizes = (3, 6, 9)
    nodes, errors = zip(*(block_error(n, nu) for n in sizes), strict=True)
    orders = np.log(np.divide(errors[:-1], errors[1:])) / np.log(np.divide(sizes[1:], sizes[:-1]))
    print(nu, nodes, errors, orders)
    verified.at_most(f"boundary: error of a block at {nodes[-1]} nodes, nu = {nu}", errors[-1], 0.0135)
    verified.equal(f"boundary: order on a block, nu = {nu}", orders[-1], 2.0, rtol=0.0, atol=0.25)


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_weight_stretches_a_hanging_block(nu: float):
    """Its top is held at the exact field: u_z = rho g (z^2 + nu (x^2 + y^2)) / 2E, u_x = -nu rho g z x / E."""
    errors = []
    for n in (3, 6):
        points, triangles = box(n)
        points = points - [0.5, 0.5, 0.0]
        weight, modulus = 1.0, 2.0 * (1.0 + nu)
        x, y, z = points.T
        exact = np.stack([-nu * x * z, -nu * y * z, 0.5 * (z**2 + nu * (x**2 + y**2))], axis=1)
        exact *= weight / modulus
        top = z > 1.0 - 1e-9
        model = Model(
            points,
            triangles,
            Parameters(shear_modulus=1.0, poisson_ratio=nu),
            formulation="bem",
            constrained=top,
            density=1.0,
            gravity=(0.0, 0.0, -weight),
        )
        found = model.solve([Load(np.zeros(len(points)), prescribed=exact * top[:, None])])
        errors.append(np.abs(found.displacement[0] - exact).max() / np.abs(exact).max())
        # the whole weight hangs on the top
        resultant = found.reaction_force[0].sum(axis=0)
        assert_allclose(resultant, [0.0, 0.0, weight], rtol=0.0, atol=1e-4)
    print(nu, errors)
    assert errors[1] < 0.05
    assert errors[0] > 2.5 * errors[1]


def test_a_ratio_next_to_a_half_is_taken_as_a_half_and_less_has_a_mean_pressure():
    points, triangles = icosphere(2, (0.05, 0.04, 0.045))
    fixed = points[:, 2] < -0.03
    load = Load(np.where(points[:, 2] > 0.03, 100.0, 0.0))

    def solved(nu: float):
        parameters = Parameters.from_tissue(3000.0, SurfaceMesh(points, triangles), "bem", poisson_ratio=nu)
        model = Model(points, triangles, parameters, formulation="bem", fixed=fixed)
        return model.solve([load])

    fluid, next_to_it, less, far = (solved(nu) for nu in (0.5, 0.4999, 0.4997, 0.3))
    gradient = SurfaceMesh(points, triangles).area_vectors
    assert abs(np.vdot(gradient, next_to_it.displacement[0])) < 1e-18
    scale = np.abs(fluid.displacement).max()
    assert_allclose(less.displacement, next_to_it.displacement, rtol=0.0, atol=2e-3 * scale)
    assert_allclose(less.fluid_pressure, next_to_it.fluid_pressure, rtol=0.02, atol=0.0)
    assert np.vdot(gradient, far.displacement[0]) < 0.0 < far.fluid_pressure[0]
