"""What the mesh leaves open of an answer: as large as the distance to a finer mesh, told beyond a tenth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from tests.vdm.vdm_shapes import box, icosphere, pressed
from vdm import Load, Model, Parameters
from vdm.peers.bem_sparse import HalvedFormulation
from vdm.reservations import LIMIT, reserved
from vdm.solution import CONVERGED

SIDES = (0.04, 0.04, 0.04)


def standing(n: int, load: str, **options: Any) -> tuple[Model, Load]:
    """A cube that stands on its foot, and a load on its top."""
    points, triangles = box(n, SIDES)
    z, fixed = points[:, 2], points[:, 2] < 1e-9
    top = z > SIDES[2] - 1e-9
    prescribed = None
    if load == "moved":
        options["constrained"] = top
        prescribed = np.where(top[:, None], [0.001, 0.0, 0.0], 0.0)
    given = {"formulation": "bem"} | options
    material = given.pop("parameters", Parameters(shear_modulus=1667.0))
    model = Model(points, triangles, material, fixed=fixed, **given)
    if load != "pressed":
        return model, Load(np.zeros(len(z)), prescribed=prescribed)
    # half of the top, whose edge is an edge of every mesh of an even number of cells
    centres = model.surface.points[triangles].mean(axis=1)
    on_half = (centres[:, 2] > SIDES[2] - 1e-9) & (centres[:, 0] > 0.5 * SIDES[0])
    return model, pressed(model.surface, np.where(on_half, 10.0, 0.0))


@pytest.mark.parametrize(("load", "n", "most"), [("pressed", 2, 1.2), ("moved", 3, 2.7)])
def test_it_is_as_large_as_the_distance_to_a_finer_mesh(load: str, n: int, most: float) -> None:
    """Half of it and more; nested cubes, so that the nodes of one are those of the other.

    Held at foot and top, half of the nodes do not know the two rims: too much is told of 2 %.
    """
    (coarse, push), (fine, finer_push) = standing(n, load), standing(2 * n, load)
    solution = coarse.solve([push])
    nearest = np.argmin(np.linalg.norm(coarse.surface.points[:, None] - fine.surface.points, axis=2), axis=1)
    assert_allclose(fine.surface.points[nearest], coarse.surface.points, atol=1e-12)
    expected = fine.solve([finer_push]).displacement[0][nearest]
    areas = coarse.surface.nodal_areas[:, None]
    change = (areas * (solution.displacement[0] - expected) ** 2).sum() / (areas * expected**2).sum()
    error = 4.0 / 3.0 * np.sqrt(change)  # of second order, on a mesh twice as fine
    assert error > 0.01
    assert 0.5 < solution.scalars["mesh_error"][0] / error < most


def test_it_falls_with_refinement_and_does_not_depend_on_the_size_of_the_load() -> None:
    def told(n: int, factor: float) -> float:
        model, push = standing(n, "pressed")
        return float(model.solve([push.scaled(factor)]).scalars["mesh_error"][0])

    coarse, fine = told(3, 1.0), told(6, 1.0)
    assert fine < 0.5 * coarse
    assert told(3, 1e3) == pytest.approx(coarse, rel=1e-9)


def test_the_coarse_body_of_the_sparse_form_is_what_is_halved() -> None:
    """The sparse form halves its coarse body: its estimate is larger than that of a body on all nodes."""
    material = Parameters(shear_modulus=1667.0, coarse_nodes=200)
    model, push = standing(6, "pressed", formulation="bem-sparse", parameters=material)
    dense, same = standing(6, "pressed")
    assert HalvedFormulation(model.formulation).n_coarse == 100  # type: ignore[arg-type]
    on_coarse = model.solve([push]).scalars["mesh_error"][0]
    assert dense.solve([same]).scalars["mesh_error"][0] < on_coarse < 1.0


def test_the_nonlinear_solver_is_told_what_the_linear_one_is() -> None:
    found = []
    for solver in ("linear", "nonlinear"):
        model, push = standing(4, "pressed", solver=solver)
        found.append(model.solve([push]).scalars["mesh_error"][0])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


def test_no_other_form_has_one_nor_a_body_on_springs_nor_a_load_of_nothing() -> None:
    points, triangles = icosphere(2, (0.05, 0.05, 0.05))
    nothing, foot = Load(np.zeros(len(points))), points[:, 2] < -0.03
    vector = Model(points, triangles, Parameters(surface_tension=1.0), formulation="vector", fixed=foot)
    bed = sparse.csr_array(sparse.diags_array(np.repeat(np.where(foot, 1.0, 0.0), 3)))
    springs = Parameters(shear_modulus=1.0, ground=bed)
    ground = Model(points, triangles, springs, formulation="bem")
    held = Model(points, triangles, Parameters(shear_modulus=1.0), formulation="bem", fixed=foot)
    for model in (vector, ground, held):
        solution = model.solve([nothing])
        assert "mesh_error" not in solution.scalars
        assert not solution.status[0].message


@pytest.mark.parametrize("which", ["bending", "mesh"])
@pytest.mark.parametrize(("error", "is_told"), [(LIMIT, False), (0.11, True), (np.nan, False)])
def test_a_reservation_begins_beyond_a_tenth(which: str, error: float, is_told: bool) -> None:
    form = standing(2, "pressed")[0].formulation
    errors = {"bending": 0.0, "mesh": 0.0} | {which: error}
    assert (reserved(CONVERGED, **errors, form=form).message != "") == is_told


def test_the_remedy_names_the_nodes_that_bring_it_to_a_tenth() -> None:
    form = standing(4, "pressed")[0].formulation
    nodes = form.surface.n_nodes
    status = reserved(CONVERGED, 0.0, 0.25, form)
    assert status.message == "the mesh leaves about 25 % of the displacement open"
    assert f"to about {100 * int(np.ceil(0.025 * nodes))} nodes" in status.remedy
    assert "finite elements" in reserved(CONVERGED, 0.0, 9.0, form).remedy  # more than the form takes
    points, triangles = icosphere(1, (0.07, 0.05, 0.05))
    foot, top = points[:, 0] < -0.055, points[:, 2] > 0.03
    own = Model(points, triangles, form.parameters, formulation="bem", fixed=foot).solve([Load(1.0 * top)])
    assert own.scalars["mesh_error"][0] > LIMIT
    assert f"leaves about {100 * own.scalars['mesh_error'][0]:.0f} %" in own.status[0].message
