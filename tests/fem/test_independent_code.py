"""The element solutions against NGSolve, an independent code, on the very same mesh.

Needs the extra `benchmark`. Both codes get the same points, tetrahedra, supports and loads, and in finite strain
the same quadrature points, so that they must agree to what their solvers reach and not only to the mesh's error.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet

from fem_reference import finite_strain_assembly
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.loads import nodal_forces
from tests.fem.shapes import Body, cube
from tests.fem.test_materials import SHAPES

ngs = pytest.importorskip("ngsolve", reason="needs NGSolve: pip install '.[benchmark]'")
netgen_meshing = pytest.importorskip("netgen.meshing", reason="needs NGSolve: pip install '.[benchmark]'")

Array = NDArray[np.float64]

YOUNG, DENSITY, GRAVITY = 3000.0, 300.0, (0.4, -0.7, 0.5)
PARTS = ("base", "top", "side")


def _facet_parts(b: Body) -> NDArray[np.int64]:
    """(F,) number of the part of each facet of the unit cube: held below, pressed above, free."""
    below, above = (b.facets_where(lambda x, z=z: np.abs(x[:, 2] - z) < 1e-12) for z in (0.0, 1.0))
    return np.where(below, 0, np.where(above, 1, 2))


def ngsolve_mesh(b: Body) -> ngs.Mesh:
    """The body with the parts of its surface by name; vertex v of one is vertex v of the other."""
    out = netgen_meshing.Mesh(dim=3)
    numbers = [out.Add(netgen_meshing.MeshPoint(netgen_meshing.Pnt(*x))) for x in b.points.tolist()]
    for part, name in enumerate(PARTS, start=1):
        out.Add(netgen_meshing.FaceDescriptor(bc=part, domin=1, surfnr=part))
        out.SetBCName(part - 1, name)
    for tetrahedron in b.tetrahedra.tolist():
        out.Add(netgen_meshing.Element3D(1, [numbers[v] for v in tetrahedron]))
    corners = b.surface_nodes[b.triangles].tolist()
    for part, triangle in zip(_facet_parts(b).tolist(), corners, strict=True):
        out.Add(netgen_meshing.Element2D(part + 1, [numbers[v] for v in triangle]))
    return ngs.Mesh(out)


def _stored(material: str, mu: float, deformation: ngs.CF) -> ngs.CF:
    """Strain energy; each law in the words of its paper, with the shapes of `SHAPES`."""
    volume = ngs.Det(deformation)
    c = deformation.trans * deformation
    if material == "neo-hookean":
        return 0.5 * mu * (ngs.Trace(c) - 3.0 - 2.0 * ngs.log(volume))
    first = volume ** (-2.0 / 3.0) * ngs.Trace(c) - 3.0
    second = volume ** (-4.0 / 3.0) * 0.5 * (ngs.Trace(c) ** 2 - ngs.InnerProduct(c, c)) - 3.0
    distortion = {
        "mooney-rivlin": 0.7 * first + 0.3 * second,
        "yeoh": first + 0.7 * first**2 + 0.4 * first**3,
        "fung": (ngs.exp(1.8 * first) - 1.0) / 1.8,
    }
    return 0.5 * mu * distortion[material] + mu / 3.0 * (volume - 1.0) ** 2


def _solve_in_ngsolve(
    b: Body, nu: float, pressure: float, *, large: bool, material: str = "neo-hookean"
) -> tuple[Array, Array]:
    """(n, 3) vertex displacements and (n,) vertex pressures, from its own forms, assembly and solver."""
    mesh = ngsolve_mesh(b)
    space = ngs.VectorH1(mesh, order=2, dirichlet="base") * ngs.H1(mesh, order=1)
    (u, p), state = space.TrialFunction(), ngs.GridFunction(space)
    mu = YOUNG / (2.0 * (1.0 + nu))
    inverse_lame = (1.0 - 2.0 * nu) / (2.0 * mu * nu)
    share = ngs.Parameter(1.0)  # of the load
    force = share * DENSITY * ngs.CF(GRAVITY)
    normal = ngs.specialcf.normal(3)
    gradient = ngs.Grad(u)
    form = ngs.BilinearForm(space, symmetric=False)
    if large:
        points, weights = get_quadrature(RefTet, finite_strain_assembly._DEGREE)
        rule = ngs.IntegrationRule([tuple(x) for x in points.T.tolist()], weights.tolist())
        inside = ngs.dx(intrules={ngs.TET: rule})
        deformation = ngs.Id(3) + gradient
        volume = ngs.Det(deformation)
        stored = _stored(material, mu, deformation)
        form += ngs.Variation((stored - p * (volume - 1.0) - 0.5 * inverse_lame * p * p) * inside)
    else:
        strain = 0.5 * (gradient + gradient.trans)
        stored = mu * ngs.InnerProduct(strain, strain)
        form += ngs.Variation((stored - p * ngs.Trace(gradient) - 0.5 * inverse_lame * p * p) * ngs.dx)
    form += ngs.Variation(-ngs.InnerProduct(force, u) * ngs.dx)
    form += ngs.Variation(share * pressure * ngs.InnerProduct(normal, u) * ngs.ds("top"))
    residual, step = state.vec.CreateVector(), state.vec.CreateVector()
    for factor in (0.25, 0.5, 0.75, 1.0) if large else (1.0,):
        share.Set(factor)
        for _ in range(7 if large else 2):  # the second step of the linear problem refines the first
            form.Apply(state.vec, residual)
            form.AssembleLinearization(state.vec)
            step.data = form.mat.Inverse(space.FreeDofs(), inverse="umfpack") * residual
            state.vec.data -= step
    displacement, multiplier = state.components
    n = len(b.points)
    u_all = np.array([np.asarray(c.vec)[:n] for c in displacement.components]).T
    return u_all, np.asarray(multiplier.vec)[:n].copy()


def _assert_same(ours: tuple[Array, Array], theirs: tuple[Array, Array], tolerance: float) -> None:
    for a, t in zip(ours, theirs, strict=True):
        assert_allclose(a, t, rtol=0, atol=tolerance * np.abs(t).max())


@pytest.mark.parametrize("nu", [0.45, 0.4999, 0.5])
def test_linear_solution_equals_ngsolve(nu: float) -> None:
    b = cube(3, distort=0.25)
    held = np.abs(b.surface[:, 2]) < 1e-12
    problem = b.problem(held, youngs_modulus=YOUNG, poisson_ratio=nu, density=DENSITY, solver="direct")
    pressure = 250.0
    load = b.load(np.where(_facet_parts(b) == 1, pressure, 0.0), gravity=GRAVITY)
    forces = nodal_forces(problem.mesh, [load], DENSITY)
    ours = problem.solve_nodal(forces, np.zeros_like(forces))
    n = len(b.points)
    theirs = _solve_in_ngsolve(b, nu, pressure, large=False)
    _assert_same((ours.displacement[0, :n], ours.pressure[0]), theirs, 1e-9)


@pytest.mark.parametrize(
    ("nu", "material"),
    [
        *((nu, "neo-hookean") for nu in (0.45, 0.4999, 0.5)),
        *((0.5, "mooney-rivlin"), (0.3, "yeoh"), (0.5, "fung")),
    ],
)
def test_finite_strain_solution_equals_ngsolve(nu: float, material: str) -> None:
    b = cube(2, distort=0.25)
    held = np.abs(b.surface[:, 2]) < 1e-12
    problem = FiniteStrainProblem(
        *b.arrays,
        youngs_modulus=YOUNG,
        poisson_ratio=nu,
        density=DENSITY,
        held=held,
        pressure="dead",
        material=material,
        material_parameters=SHAPES.get(material),
    )
    pressure = 400.0
    load = b.load(np.where(_facet_parts(b) == 1, pressure, 0.0), gravity=GRAVITY)
    *_, (_, last) = problem.substeps([load])
    assert last.converged
    assert last.load_factor == 1.0
    u = last.state.displacement * problem.mesh.mean_edge
    p = last.state.pressure * problem.system.pressure_scale * problem.shear_modulus
    n = len(b.points)
    assert np.abs(u).max() > 0.1, "the deformation is large"
    _assert_same((u[:n], p), _solve_in_ngsolve(b, nu, pressure, large=True, material=material), 1e-8)
