"""Every form is tried on pure bending: right where it knows the body, a reservation with a size where not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from tests.vdm.vdm_shapes import box, icosphere
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.bending import bendings
from vdm.reservations import LIMIT

Array = NDArray[np.float64]
Index = NDArray[np.int64]
THICK, THIN = (0.1, 0.05, 0.05), (0.1, 0.015, 0.015)


def held_at_one_end(points: Array, triangles: Index, **options: Any) -> Model:
    """A body whose lowest tenth along x is held."""
    x = points[:, 0]
    parameters = Parameters(shear_modulus=1667.0)
    fixed = x < x.min() + 0.15 * np.ptp(x)
    return Model(points, triangles, parameters, formulation="bem", fixed=fixed, **options)


def told(model: Model) -> tuple[str, str]:
    """What the status of a small push says, and the remedy; the step is usable whatever it says."""
    solution = model.solve([Load(np.where(model.surface.points[:, 2] > 0.0, 1.0, 0.0))])
    assert solution.status[0].ok
    assert solution.parameters["bending_error"] == model.bending_error
    return solution.status[0].message, solution.status[0].remedy


def test_the_bendings_are_those_of_an_incompressible_solid() -> None:
    """Their forces balance, the volume stays, and they do the work of the stress b on the strain b, E = 1.

    A box has flat sides, so that all this is exact on any mesh; what is left is rounding.
    """
    sides = np.array([0.3, 0.5, 0.8])
    for n in (4, 8):
        surface = SurfaceMesh(*box(n, tuple(sides)))
        moved, forces = bendings(surface)
        assert_allclose(forces.sum(axis=1), 0.0, rtol=0.0, atol=1e-15)
        moments = np.cross(surface.points - surface.points.mean(axis=0), forces).sum(axis=1)
        assert_allclose(moments, 0.0, rtol=0.0, atol=1e-15)
        work = np.einsum("kic,kic->k", moved, forces)
        # the axis b of each of the six, the longest side the third of them
        along = np.array([1, 2, 0, 2, 0, 1])
        order = np.argsort([np.abs(surface.points[:, a] ** 2 * surface.nodal_areas).sum() for a in range(3)])
        exact = sides.prod() * sides[order][along] ** 2 / 12.0
        change = np.einsum("kic,ic->k", moved, surface.area_vectors)
        assert_allclose(work, exact, rtol=2e-14)
        assert_allclose(change, 0.0, rtol=0.0, atol=1e-15)


def test_a_mesh_that_knows_its_body_bends_right_and_better_when_refined() -> None:
    coarse, fine = (held_at_one_end(*icosphere(n, (0.05, 0.05, 0.05))).bending_error for n in (1, 2))
    assert 0.04 < coarse < 0.08
    assert fine < 0.45 * coarse


def test_bodies_thick_enough_for_their_mesh_have_no_reservation() -> None:
    for points, triangles in (icosphere(2, THICK), icosphere(2, (0.05, 0.05, 0.05))):
        model = held_at_one_end(points, triangles)
        assert 0.0 < model.bending_error < 0.7 * LIMIT
        assert "bending" not in told(model)[0]


def test_a_rod_thinner_than_its_mesh_is_coarse_has_one() -> None:
    model = held_at_one_end(*icosphere(2, THIN))
    message, remedy = told(model)
    assert 0.8 < model.bending_error < 1.1
    assert f"a known bending comes out {100 * model.bending_error:.0f} % wrong" in message
    assert remedy == "refine the surface, above all where it is thin, to about 1,500 nodes"
    assert held_at_one_end(*icosphere(2, THIN), solver="nonlinear").bending_error == model.bending_error


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [("paper", "lu"), *((name, "linear") for name in ("consistent", "vector", "mass-spring"))],
)
def test_a_form_that_does_not_know_the_inside_says_how_wrong_it_is(formulation: str, solver: str) -> None:
    """On a bar held at one end, bent by a push on its side: wrong by a third and more, and said to be."""
    points, triangles = icosphere(2, THICK)
    surface, fixed = SurfaceMesh(points, triangles), points[:, 0] < -0.07
    parameters = Parameters.from_tissue(5000.0, surface, formulation, held=fixed)
    model = Model(points, triangles, parameters, formulation=formulation, solver=solver, fixed=fixed)
    right = Model(points, triangles, Parameters(shear_modulus=5000.0 / 3.0), formulation="bem", fixed=fixed)
    push = Load(np.where((points[:, 2] > 0.0) & (points[:, 0] > 0.0), 10.0, 0.0))
    found, expected = (m.solve([push]).displacement[0] for m in (model, right))
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert right.bending_error < LIMIT < 0.3 < error
    assert error < model.bending_error
    message, remedy = told(model)
    assert f"a known bending comes out {100 * model.bending_error:.0f} % wrong" in message
    assert remedy.startswith("take boundary elements or finite elements")


def test_the_error_is_that_of_the_tissue_that_the_parameters_stand_for() -> None:
    """A form is right about one tissue and as wrong about another as the two moduli are apart, free nodes alone."""
    points, triangles = icosphere(2, (0.05, 0.05, 0.05))
    few = np.linalg.norm(points - points[0], axis=1) < 0.02
    errors = [
        Model(
            points,
            triangles,
            Parameters(shear_modulus=1.0, youngs_modulus=e),
            formulation="bem",
            fixed=few,
        ).bending_error
        for e in (3.0, 4.5, 6.0)
    ]
    assert errors[0] < 0.1 < errors[1]
    # error ~ (E / 3 mu - 1): the second step of the modulus adds what the first did
    assert_allclose(errors[2] / errors[1], 2.0, rtol=0.05, atol=0.0)


def test_nothing_is_judged_without_a_tissue() -> None:
    points, triangles = icosphere(1, (0.05, 0.05, 0.05))
    surface = SurfaceMesh(points, triangles)
    fitted = Parameters(surface_tension=1.0)
    fibres = Parameters.from_tissue(5000.0, surface, "vector").anisotropic(surface, (1.0, 0.0, 0.0), 3.0)
    for parameters in (fitted, fibres):
        model = Model(points, triangles, parameters, formulation="vector", fixed=points[:, 2] < 0.0)
        solution = model.solve([Load(np.zeros(len(points)))])
        assert "bending_error" not in solution.parameters
        assert solution.status[0].message == ""


def test_a_weight_that_bends_a_body_far_is_brought_on_in_steps() -> None:
    """A quarter of its length: from rest under its whole weight the solver does not get there in one step."""
    points, triangles = box(4, (0.06, 0.03, 0.03))
    density, gravity = 1000.0, np.array([0.0, 0.0, -3.0])
    weighs = {"density": density, "gravity": gravity}
    nonlinear, linear = (
        held_at_one_end(points, triangles, solver=solver, **weighs) for solver in ("nonlinear", "linear")
    )
    found, straight = (model.solve([Load(np.zeros(len(points)))]) for model in (nonlinear, linear))
    assert found.status[0].ok, found.status
    sag = [-solution.displacement[0, :, 2].min() for solution in (found, straight)]
    assert sag[0] > 0.15 * 0.06
    assert sag[0] == pytest.approx(sag[1], rel=0.1)
    assert_allclose(found.reaction_force[0].sum(axis=0), -density * 0.06 * 0.03**2 * gravity, atol=1e-9)
