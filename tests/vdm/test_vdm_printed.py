"""Equations 10 to 15, 17, 20 and 33 as printed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BODY, POINTS, icosphere, model
from vdm import Load, SurfaceMesh, printed
from vdm.deformed import DeformableSurface

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
