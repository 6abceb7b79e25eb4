"""The linear problem: outputs, balance, superposition, fibres, condition, and assembly against scikit-fem."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from fem_reference.condition import condition_estimate
from fem_reference.mesh import TetMesh
from fem_reference.moduli import make_moduli
from fem_reference.outputs import OUTPUTS, strain_outputs
from fem_reference.system import LinearSystem
from tests.fem.shapes import Body, ball, cube
from tests.verification.records import Verified


@pytest.fixture(scope="module")
def block() -> Body:
    return cube(3, distort=0.2)


@pytest.mark.anchor("outputs: reactions balance the load, linear", "equilibrium of forces")
@pytest.mark.parametrize(
    ("element", "poisson_ratio"),
    [("P2-P1", nu) for nu in (-0.5, 0.0, 0.3, 0.4999, 0.5)]
    + [(e, nu) for e in ("P2", "P1") for nu in (-0.5, 0.45)],
)
@pytest.mark.parametrize("solver", ["direct", "iterative"])
def test_reactions_balance_pressure_and_weight(
    block: Body, solver: str, element: str, poisson_ratio: float, verified: Verified
) -> None:
    problem = block.problem(
        block.bottom,
        poisson_ratio=poisson_ratio,
        element=element,
        solver=solver,
        density=2.0,
        youngs_modulus=50.0,
    )
    pressure = np.random.default_rng(0).uniform(0.0, 2.0, (len(block.triangles), 6))
    given = np.where(block.bottom[:, None], 0.01 * np.sin(7.0 * block.surface), 0.0)
    s = problem.solve([block.load(pressure, given, (1.0, 2.0, -9.81))])
    q = np.array([0.223381589678011] * 3 + [0.109951743655322] * 3)
    applied = -block.area_vectors.T @ (pressure @ q) + 2.0 * np.array([1.0, 2.0, -9.81])  # volume one
    assert s.status[0].ok
    unbalanced = (s.reaction_force[0].sum(axis=0) + applied) / np.abs(applied).max()
    verified.at_most(f"{solver}, {element}, nu = {poisson_ratio}: share of the load", unbalanced, 1e-9)
    assert_array_equal(s.reaction_force[0][~block.bottom], 0.0)
    assert_allclose(s.displacement[0][block.bottom], given[block.bottom], rtol=0, atol=1e-16)


@pytest.mark.parametrize("solver", ["direct", "iterative"])
def test_many_loads_equal_one_by_one_and_superpose(block: Body, solver: str) -> None:
    problem = block.problem(block.bottom, poisson_ratio=0.4999, solver=solver, density=1.0)
    rng = np.random.default_rng(1)
    loads = [
        block.load(
            rng.standard_normal((len(block.triangles), 6)),
            rng.standard_normal((len(block.surface_nodes), 3)),
            rng.standard_normal(3),
        )
        for _ in range(3)
    ]
    mixed = block.load(
        2.0 * loads[0].facet_pressure - 0.5 * loads[1].facet_pressure,
        2.0 * loads[0].prescribed - 0.5 * loads[1].prescribed,
        2.0 * loads[0].gravity - 0.5 * loads[1].gravity,
    )
    outputs = frozenset(OUTPUTS) - {"condition_estimate"}
    together = problem.solve([*loads, mixed], outputs)
    scale = np.abs(together.displacement).max()
    tolerance = 1e-10 if solver == "direct" else 1e-8
    for step, load in enumerate([*loads, mixed]):
        alone = problem.solve([load], outputs)
        difference = together.displacement[step] - alone.displacement[0]
        assert np.abs(difference).max() <= tolerance * scale
        assert_allclose(together.energy[step], alone.energy[0], rtol=tolerance, atol=0)
        for name in outputs:
            found, expected = together.scalars[name][step], alone.scalars[name][0]
            assert_allclose(found, expected, rtol=10 * tolerance, atol=0, err_msg=name)
    for name in ("displacement", "reaction_force", "fluid_pressure"):
        values = getattr(together, name)
        combined = 2.0 * values[0] - 0.5 * values[1]
        assert_allclose(values[3], combined, rtol=0, atol=10 * tolerance * np.abs(values).max())


@pytest.mark.anchor("direct against iterative path", "each other")
def test_the_two_paths_agree(verified: Verified) -> None:
    b = ball(2, radius=0.05)
    held = b.surface[:, 2] < -0.035
    pressure = 200.0 * b.facets_where(lambda x: x[:, 2] > 0.035)
    given = np.outer(held, [1e-3, 0.0, -1e-3])
    loads = [b.load(pressure), b.load(prescribed=given), b.load(gravity=(0.0, 0.0, -9.81))]
    for poisson_ratio in (0.3, 0.4999, 0.5):
        one, other = (
            b.problem(
                held, youngs_modulus=5e3, poisson_ratio=poisson_ratio, density=1060.0, solver=solver
            ).solve(loads)
            for solver in ("direct", "iterative")
        )
        size = np.linalg.norm(one.displacement, axis=(1, 2))
        difference = np.linalg.norm(one.displacement - other.displacement, axis=(1, 2))
        title = f"linear, pressure, support motion and weight, nu = {poisson_ratio}: displacement"
        verified.at_most(title, difference / size, 1e-8)
        atol = 1e-8 * np.abs(one.fluid_pressure).max()
        assert_allclose(other.fluid_pressure, one.fluid_pressure, rtol=0, atol=atol)
        assert_array_equal(one.iterations, 0)
        assert (other.iterations > 0).all()


@pytest.mark.anchor(
    "outputs of a uniform stretch, linear", "F = I + G; energy and mean stress of Hooke's law"
)
@pytest.mark.parametrize("element", ["P2-P1", "P2", "P1"])
def test_scalars_of_a_uniform_stretch(element: str, verified: Verified) -> None:
    """u = G x held all over: F is uniform, the bar's exact values are known."""
    b = cube(2, distort=0.2)
    stretch = np.diag([0.1, -0.03, -0.02])
    stretch[0, 1] = 0.05
    held = np.ones(len(b.surface_nodes), dtype=bool)
    problem = b.problem(held, youngs_modulus=3.0, poisson_ratio=0.3, element=element)
    s = problem.solve([b.load(prescribed=b.surface @ stretch.T)], frozenset(OUTPUTS))
    f = np.eye(3) + stretch
    strain = 0.5 * (stretch + stretch.T)
    lame, shear = 3.0 * 0.3 / (1.3 * 0.4), 3.0 / 2.6
    energy = 0.5 * lame * np.trace(strain) ** 2 + shear * (strain**2).sum()
    pressure = -3.0 / (3.0 * 0.4) * np.trace(strain)
    green = np.linalg.eigvalsh(0.5 * (f.T @ f - np.eye(3))).max()
    out = s.scalars
    verified.equal(f"{element}: energy", s.energy[0], energy, rtol=1e-11)
    verified.equal(f"{element}: mean pressure", s.fluid_pressure[0], pressure, rtol=1e-11)
    verified.equal(
        f"{element}: det F - 1", out["max_det_f_deviation"][0], abs(np.linalg.det(f) - 1.0), rtol=1e-10
    )
    verified.equal(
        f"{element}: largest Green-Lagrange strain", out["max_principal_strain"][0], green, rtol=1e-10
    )
    assert_allclose(out["p95_principal_strain"][0], green, rtol=1e-10, atol=0)
    verified.equal(f"{element}: volume", out["volume"][0], np.linalg.det(f), rtol=1e-11)


def test_volume_of_a_curved_deformation() -> None:
    """A quadratic displacement of the cube, which P2 holds exactly: the volume is the integral of det F."""
    b = cube(2, distort=0.2)
    problem = b.problem(np.ones(len(b.surface_nodes), dtype=bool))
    x, y, z = problem.mesh.node_points.T
    given = np.column_stack([0.2 * x * y, 0.3 * y * z, 0.1 * x * z])
    # det F = (1 + 0.2 y)(1 + 0.3 z)(1 + 0.1 x) + 0.2 x 0.3 y 0.1 z, averaged over the cube
    expected = 1.1 * 1.15 * 1.05 + 0.2 * 0.3 * 0.1 / 8.0
    found = strain_outputs(problem.mesh, given[None], frozenset({"volume"}))["volume"]
    assert_allclose(found, expected, rtol=1e-13, atol=0)


@pytest.mark.anchor("rigid-motion invariance", "the same answer, turned")
def test_a_rigid_support_motion_moves_the_body_rigidly(block: Body, verified: Verified) -> None:
    spin = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.1], [-0.2, 0.1, 0.0]])
    rigid = block.surface @ spin.T + [1.0, 2.0, 3.0]
    for element, poisson_ratio in (("P2-P1", 0.5), ("P2", 0.3), ("P1", 0.3)):
        problem = block.problem(block.bottom, poisson_ratio=poisson_ratio, element=element)
        s = problem.solve([block.load(prescribed=rigid)])
        title = f"linear, {element}, support turned and moved: displacement"
        verified.at_most(title, s.displacement[0] - rigid, 1e-11)
        assert_allclose(s.energy, 0.0, rtol=0, atol=1e-11 * (rigid**2).sum())


def test_a_load_that_is_not_reached_is_no_success(block: Body) -> None:
    problem = block.problem(block.bottom, poisson_ratio=0.4999999, element="P2", solver="direct")
    s = problem.solve([block.load(1.0 * block.top)])
    assert float(s.parameters["relative_residual"]) > 1e-9
    assert s.status[0].code == "not-converged"
    assert "P2-P1" in s.status[0].remedy


def test_a_direct_solver_that_fails_is_not_offered_as_the_remedy(
    block: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    for solver, offered in (("direct", False), ("iterative", True)):
        problem = block.problem(block.bottom, solver=solver)
        monkeypatch.setattr(problem.solver, "tolerance", 0.0)
        status = problem.solve([block.load(1.0)]).status[0]
        assert status.code == "not-converged"
        assert ('solver="direct"' in status.remedy) == offered


def test_moduli_that_vary_have_means_by_volume() -> None:
    mesh = TetMesh(*cube(2, distort=0.2).arrays)
    share = mesh.volumes / mesh.volumes.sum()
    young, nu = (
        np.where(share > np.median(share), 9000.0, 3000.0),
        np.where(share > np.median(share), 0.49, 0.3),
    )
    found = make_moduli(mesh, young, nu, mixed=True)
    assert_allclose(found.youngs_modulus, share @ young, rtol=1e-12, atol=0)
    assert_allclose(found.poisson_ratio, share @ nu, rtol=1e-12, atol=0)
    unit = found.youngs_modulus / (2.0 * (1.0 + found.poisson_ratio))
    assert_allclose(found.stiffness, young / (2.0 * (1.0 + nu)) / unit, rtol=1e-12, atol=0)


def _tension(b: Body, contrast: float, axis: int, **options: object) -> tuple[np.ndarray, float]:
    """Strain along x, y, z and mean pressure per unit tension along `axis`, fibres along x, on rollers."""
    problem = b.problem(b.surface < 1e-12, fibre_direction=(3.0, 0.0, 0.0), contrast=contrast, **options)
    end = b.facets_where(lambda x: x[:, axis] > 1.0 - 1e-12)
    solution = problem.solve([b.load(-1.0 * end)])
    assert solution.status[0].ok
    far = np.argmax(b.surface.sum(axis=1))
    return solution.displacement[0, far], solution.fluid_pressure[0]


@pytest.mark.parametrize("solver", ["direct", "iterative"])
@pytest.mark.parametrize("contrast", [1.0, 20.0])
@pytest.mark.parametrize(("element", "nu"), [("P2-P1", 0.5), ("P2-P1", 0.3), ("P2", 0.3), ("P1", 0.3)])
def test_tension_along_and_across_is_exact(
    block: Body, solver: str, contrast: float, element: str, nu: float
) -> None:
    """Young's modulus along the fibres is c E; across, by inverting Hooke's law with the fibres' term."""
    shear, fibre = 0.5 / (1.0 + nu), contrast - 1.0
    compliance = (1.0 + nu) * np.eye(3) - nu * np.ones((3, 3))  # of the isotropic part, E = 1
    # Sherman-Morrison of the compliance for stress += fibre e_x along x; finite at nu = 1/2 too
    first = compliance[:, 0]
    compliance = compliance - fibre * np.outer(first, first) / (1.0 + fibre * first[0])
    assert_allclose(1.0 / compliance[0, 0], contrast, rtol=1e-14, atol=0)
    if nu == 0.5:
        m = 1.0 + fibre / (2.0 * shear)
        assert_allclose(1.0 / compliance[2, 2], 2.0 * shear * (1.0 + 2.0 * m) / (1.0 + m), rtol=1e-12, atol=0)
    for axis in range(3):
        strain, pressure = _tension(block, contrast, axis, element=element, poisson_ratio=nu, solver=solver)
        assert_allclose(strain, compliance[:, axis], rtol=0, atol=2e-7)
        assert_allclose(pressure, -1.0 / 3.0, rtol=0, atol=2e-7)


CUBE, BALL = cube(2), ball(1)
CONDITION = frozenset({"condition_estimate"})
BAND = (0.3, 1.0 + 1e-6)  # of a lower bound that is rarely more than three times too small


def low(small: Body) -> np.ndarray:
    return small.surface[:, 2] < small.surface[:, 2].min() + 0.4


def exact_condition(system: LinearSystem) -> float:
    """|M|_1 |M^-1|_1 by numpy: displacements to a unit diagonal, pressures by theirs of the mass matrix."""
    matrix = system.apply(np.eye(system.size))
    n = system.n_displacements
    unit = np.ones(system.size)
    unit[:n] = 1.0 / np.sqrt(np.diag(matrix)[:n])
    if system.mass is not None:
        complement = abs(system.schur_factor) * system.mass.toarray().diagonal()
        unit[n:] = 1.0 / np.sqrt(complement)
    return float(np.linalg.cond(matrix * np.outer(unit, unit), 1))


@pytest.mark.parametrize("small", [CUBE, BALL], ids=["cube", "ball"])
@pytest.mark.parametrize(
    ("element", "ratios"),
    [("P2-P1", (-0.5, 0.0, 0.3, 0.4999, 0.5)), ("P2", (0.0, 0.4999)), ("P1", (0.3, 0.49999))],
)
def test_the_estimate_is_the_condition_number_of_the_scaled_system(
    small: Body, element: str, ratios: tuple[float, ...]
) -> None:
    for ratio in ratios:
        problem = small.problem(low(small), poisson_ratio=ratio, element=element)
        share = problem.condition / exact_condition(problem.system)
        assert BAND[0] <= share <= BAND[1], (element, ratio, share)


def test_the_tangents_condition_follows_the_load() -> None:
    small, held = BALL, low(BALL)
    facets = small.facets_where(lambda x: x[:, 2] > 0.5)
    loads = [small.load(pressure=np.where(facets, p, 0.0)) for p in (0.0, 0.1, 0.2, 100.0)]
    problem = small.finite(held, poisson_ratio=0.49)
    found = problem.solve(loads, CONDITION)
    estimate = found.scalars["condition_estimate"]
    assert [status.ok for status in found.status] == [True, True, True, False]
    assert np.abs(np.diff(estimate[:3]) / estimate[:2]).min() > 0.01
    # the step that failed has that of the last state in equilibrium
    assert np.isfinite(estimate[3])
    # and it is that of the tangent there, computed anew
    [*_, (_, last)] = [item for item in problem.substeps(loads[:3]) if item[1].converged]
    tangent = problem.tangent(last).symmetric()
    assert_allclose(condition_estimate(tangent), estimate[2], rtol=1e-6, atol=0)
    assert BAND[0] <= estimate[2] / exact_condition(tangent) <= BAND[1]
