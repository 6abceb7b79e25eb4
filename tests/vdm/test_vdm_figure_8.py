"""Figure 8 against its equations written out node by node, and what each of its switches does."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, icosphere, model
from vdm import Load, Model, Parameters, SurfaceMesh

PUSH = Load(np.where(POINTS[:, 2] > 0.03, 200.0, 0.0))
RISING = [PUSH.scaled(k / 4) for k in range(1, 5)]
MATERIAL = Parameters.from_tissue(5000.0, BODY, "paper")
WEIGHT = {"density": 1060.0, "gravity": (0.0, 0.0, -9.81)}


def lengths(displacement: np.ndarray) -> np.ndarray:
    return np.asarray((displacement * BODY.normals).sum(axis=-1))


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
        assert_allclose(lengths(solution.displacement[k]), right[:-1], rtol=0, atol=1e-12 * size)
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
