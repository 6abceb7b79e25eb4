"""The paper as printed: equations 10 to 15, 17, 20 and 33, Figure 8, and its time step read as an increment."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, icosphere, model
from vdm import Load, Model, Parameters, SurfaceMesh, printed
from vdm.deformed import DeformableSurface
from vdm.incremental import IncrementalModel

PUSHED = POINTS[:, 2] > 0.03
PUSH = Load(np.where(PUSHED, 200.0, 0.0))


def along_normals(displacement: np.ndarray) -> np.ndarray:
    return np.asarray((displacement * BODY.normals).sum(axis=-1))


def test_outside_and_inside_balance_at_every_free_node() -> None:
    """P_ext = P_int (10, 14, 15), where a contact adds its own pressure outside (24)."""
    environment = 300.0
    body = model("paper", density=1060.0, gravity=(0.0, 0.0, -9.81), environment_pressure=environment)
    solution = body.solve([PUSH])
    displacement = along_normals(solution.displacement[0])
    fluid = float(solution.fluid_pressure[0])
    outside = printed.external_pressure(body.formulation, displacement, environment) + PUSH.contact_pressure
    inside = printed.internal_pressure(BODY.n_nodes, fluid, body.problem.support.hydrostatic)
    free = body.problem.free
    # rounding of a solve, against pressures of some hundred pascals
    assert_allclose(outside[free], inside[free], rtol=0.0, atol=1e-8 * fluid)
    assert np.abs(outside - inside)[~free].max() > 1.0, "the supports push there"
    step = body.solver.step(PUSH)
    assert_allclose(printed.pressure_change(fluid, environment), step.pressure_change, rtol=1e-12, atol=0)


def test_columns_from_the_centre_change_as_the_volume_does_and_displacements_twice_over() -> None:
    """A ball of radius R that grows by s: dV = 4 pi (R + s)^2 ds."""
    points, triangles = icosphere(3, (0.05, 0.05, 0.05))
    rest, radius, s, ds = SurfaceMesh(points, triangles), 0.05, 0.01, 1e-6
    at, after = (SurfaceMesh(points * (1.0 + grown / radius), triangles) for grown in (s, s + ds))
    areas, change = at.nodal_areas, after.nodal_areas - at.nodal_areas
    column = [(mesh.points * mesh.normals).sum(axis=1) / 3.0 for mesh in (at, after)]
    exact = after.volume - at.volume
    found = printed.volume_change(areas, change, column[0], column[1] - column[0]).sum()
    # facets: normals at nodes are off those of the facets by a part of the mesh size squared
    assert_allclose(found, exact, rtol=5e-3, atol=0)
    displaced = np.full(rest.n_nodes, s)
    twice = printed.volume_change(areas, change, displaced, np.full(rest.n_nodes, ds)).sum()
    # A ds + s dA = A ds (1 + 2 s / (R + s))
    assert_allclose(twice / exact, 1.0 + 2.0 * s / (radius + s), rtol=5e-3, atol=0)


@pytest.mark.parametrize("row", ["printed", "corrected"])
def test_the_printed_row_of_the_quasi_linear_solver_is_equation_33(row: str) -> None:
    """Sum A_i dL_i + L_i dA_i = 0 from step to step, on the areas that each step starts from; the volume drifts."""
    solution = model("paper", solver="quasi-linear", volume_row=row).solve(
        [PUSH.scaled(k / 4) for k in range(1, 5)]
    )
    surface = DeformableSurface(BODY)
    length = [along_normals(u) for u in solution.displacement]
    areas = [BODY.nodal_areas, *(surface.at(u).nodal_areas for u in solution.displacement)]
    sums = [
        printed.volume_change(
            areas[k], areas[k] - areas[k - 1], length[k - 1], length[k] - length[k - 1]
        ).sum()
        for k in range(1, 4)
    ]
    size = float(areas[0] @ np.abs(length[-1]))
    largest = np.abs(sums).max() / size
    drift = abs(surface.at(solution.displacement[-1]).volume - BODY.volume) / size
    if row == "printed":
        assert largest < 1e-12, "rounding"
        assert drift > 0.01
    else:
        assert largest > 1e-3
        assert drift < 0.01


RISING = [PUSH.scaled(k / 4) for k in range(1, 5)]
MATERIAL = Parameters.from_tissue(5000.0, BODY, "paper")
WEIGHT = {"density": 1060.0, "gravity": (0.0, 0.0, -9.81)}


def written_out(loads: list[Load], *, row: str = "printed", weight: bool = False) -> list[np.ndarray]:
    """(L_1..L_N, dP) of each time-step by equations 1-4, 12, 24-28 and 33, dense, held nodes left out."""
    n = BODY.n_nodes
    rest = SurfaceMesh(POINTS, TRIANGLES)
    neighbours = [sorted({j for f in TRIANGLES if i in f for j in f if j != i}) for i in range(n)]
    b = np.broadcast_to(MATERIAL.bulk_modulus, n)
    b_ij = float(np.asarray(MATERIAL.connectivity_modulus).flat[0])
    length, before, answers = np.zeros(n), rest.nodal_areas, []
    for load in loads:
        moved = SurfaceMesh(POINTS + length[:, None] * rest.normals, TRIANGLES)
        a, total = moved.nodal_areas, moved.nodal_areas.sum()
        k, r = np.zeros((n + 1, n + 1)), np.zeros(n + 1)
        for i in range(n):
            volume = a[i] * moved.volume / total
            k[i, i] += b[i] / volume * a[i]
            for j in neighbours[i]:
                k[i, i] += b_ij / volume * a[i]
                k[i, j] -= b_ij / volume * a[j]
            k[i, n] = -1.0
            r[i] = -load.contact_pressure[i]
            if weight:
                r[i] += 1060.0 * 9.81 * (POINTS[:, 2].max() - moved.points[i, 2])
            # (33), its known part on the right
            k[n, i] = a[i]
            r[n] += a[i] * length[i] - length[i] * (a[i] - before[i])
        if row == "corrected":  # of the volume to first order as printed: what facets turn away is not kept
            unseen = rest.nodal_areas - (rest.area_vectors * rest.normals).sum(axis=1)
            k[n, :n] = (moved.area_vectors * rest.normals).sum(axis=1) + unseen
            r[n] = k[n, :n] @ length - (moved.volume + unseen @ length - rest.volume)
        free = np.append(~BASE, True)
        answer = np.zeros(n + 1)
        answer[free] = np.linalg.solve(k[np.ix_(free, free)], r[free])
        length, before = answer[:n], a
        answers.append(answer)
    return answers


@pytest.mark.parametrize("row", ["printed", "corrected"])
@pytest.mark.parametrize("weight", [False, True])
def test_figure_8_is_its_equations_written_out(row: str, weight: bool) -> None:
    options = WEIGHT if weight else {}
    body = model("paper", solver="figure-8", stop="residual", tolerance=1e-14, volume_row=row, **options)
    solution = body.solve(RISING)
    for k, right in enumerate(written_out(RISING, row=row, weight=weight)):
        assert solution.status[k].ok, solution.status[k]
        size = np.abs(right[:-1]).max()
        assert_allclose(along_normals(solution.displacement[k]), right[:-1], rtol=0, atol=1e-12 * size)
        assert_allclose(solution.fluid_pressure[k], right[-1], rtol=1e-12, atol=0)


def test_each_stop_leaves_what_its_rule_does_not_see() -> None:
    """Lengths of iterates come to rest before iterates do: on a ball of 642 nodes, eps = 1e-2."""
    points, triangles = icosphere(3, (0.05, 0.05, 0.05))
    rule = lambda surface: Parameters.from_tissue(5000.0, surface, "paper")  # noqa: E731
    push = [Load(np.where(points[:, 2] > 0.045, 200.0, 0.0))]
    linear = Model(points, triangles, rule, fixed=points[:, 2] < -0.03).solve(push).displacement[0]

    def off(stop: str) -> tuple[float, int]:
        body = Model(
            points, triangles, rule, fixed=points[:, 2] < -0.03, solver="figure-8", stop=stop, tolerance=1e-2
        )
        solution = body.solve(push)
        assert solution.status[0].ok
        told = "residual" in solution.status[0].message
        assert told == (stop != "residual"), "an answer that its stop left open says so"
        error = np.abs(solution.displacement[0] - linear).max() / np.abs(linear).max()
        return float(error), int(solution.iterations[0])

    printed, intended, residual = map(off, ("printed", "intended", "residual"))
    assert printed[0] > intended[0] > residual[0]
    assert printed[1] < intended[1] < residual[1]


def test_a_load_that_throws_nodes_off_the_body_fails_with_a_remedy() -> None:
    solution = model("paper", solver="figure-8").solve([PUSH.scaled(1e4), PUSH])
    assert [status.code for status in solution.status] == ["diverged", "diverged"]
    assert "load steps" in solution.status[0].remedy


def test_a_scaled_load_scales_all_of_its_parts() -> None:
    parts = [np.full(BODY.n_nodes, 2.0), *(np.full((BODY.n_nodes, 3), s) for s in (3.0, 4.0, 5.0))]
    half = Load(*parts).scaled(0.5)
    found = (half.contact_pressure, half.contact_force, half.prescribed, half.dead_force)
    for part, whole in zip(found, parts, strict=True):
        assert_allclose(part, 0.5 * whole, rtol=0, atol=0)


HARD = Load(np.where(POINTS[:, 2] > 0.03, 800.0, 0.0))


def incremental(steps: int, load: Load = HARD, **options) -> np.ndarray:
    stepping = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE, **options)
    solution = stepping.solve([load.scaled(k / steps) for k in range(1, steps + 1)])
    assert all(status.ok for status in solution.status)
    return solution.displacement[-1]


def test_one_step_is_the_linear_answer_and_many_small_loads_are_too() -> None:
    linear = model("paper").solve([HARD])
    one = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE).solve([HARD])
    for name in ("displacement", "reaction_force", "fluid_pressure"):
        assert_allclose(getattr(one, name), getattr(linear, name), rtol=1e-12, atol=1e-18)
    # work of the load on the way: that of a linear answer is its energy
    assert_allclose(one.energy, linear.energy, rtol=1e-9, atol=0)
    tiny, size = HARD.scaled(1e-6), 1e-6 * np.abs(linear.displacement).max()
    assert_allclose(
        incremental(5, tiny),
        1e-6 * linear.displacement[0],
        rtol=0,
        atol=1e-5 * size,
    )


def test_each_step_is_a_model_of_the_surface_that_the_last_one_left() -> None:
    half = HARD.scaled(0.5)
    first = model("paper").solve([half]).displacement[0]
    second = Model(POINTS + first, TRIANGLES, MATERIAL, fixed=BASE).solve([half]).displacement[0]
    assert_allclose(incremental(2), first + second, rtol=0, atol=1e-15)
    linear = 2.0 * first
    assert np.abs(incremental(2) - linear).max() > 1e-3 * np.abs(linear).max(), "steps change the answer"


def test_a_surface_that_folds_ends_the_history_and_says_so() -> None:
    stepping = IncrementalModel(POINTS, TRIANGLES, MATERIAL, fixed=BASE)
    solution = stepping.solve([HARD.scaled(100.0 * k) for k in range(1, 6)])
    assert solution.status[0].ok
    assert solution.status[-1].code == "diverged"
    assert "smaller load" in solution.status[-1].remedy
    assert np.isnan(solution.displacement[-1]).all()
