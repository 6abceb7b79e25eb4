"""What a form and its mesh leave open of an answer, by pure bending and by half the nodes: told beyond a tenth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray
from scipy import sparse

from tests.vdm.vdm_shapes import box, icosphere, pressed
from vdm import Load, Model, Parameters, SurfaceError, SurfaceMesh
from vdm.bending import bendings
from vdm.boundary import coarsening
from vdm.boundary.coarsening import coarsened
from vdm.peers.bem_sparse import HalvedFormulation
from vdm.reservations import LIMIT, reserved
from vdm.solution import CONVERGED
from vdm.surface import rigid_basis

SIDES = (0.04, 0.04, 0.04)


def standing(n: int, load: str, **options: Any) -> tuple[Model, Load]:
    """A cube that stands on its foot, or where `sprung` on springs below it, and a load on its top."""
    points, triangles = box(n, SIDES)
    z, fixed = points[:, 2], points[:, 2] < 1e-9
    top = z > SIDES[2] - 1e-9
    prescribed = None
    if load == "moved":
        options["constrained"] = top
        prescribed = np.where(top[:, None], [0.001, 0.0, 0.0], 0.0)
    given = {"formulation": "bem"} | options
    material = given.pop("parameters", Parameters(shear_modulus=1667.0))
    if load == "sprung":
        on_foot = fixed[triangles].all(axis=1)
        at = np.repeat(triangles[on_foot], 3, axis=1), np.tile(triangles[on_foot], 3)
        shares = (np.ones((3, 3)) + np.eye(3)).ravel() / 12.0  # integrals of two shape functions
        each = SurfaceMesh(points, triangles).facet_areas[on_foot, None] * shares
        bed = sparse.coo_array((5e5 * each.ravel(), (at[0].ravel(), at[1].ravel())), shape=(len(z), len(z)))
        material = replace(material, ground=sparse.csr_array(sparse.kron(bed, sparse.eye_array(3))))
        fixed = None
    model = Model(points, triangles, material, fixed=fixed, **given)
    if load == "moved":
        return model, Load(np.zeros(len(z)), prescribed=prescribed)
    # half of the top, whose edge is an edge of every mesh of an even number of cells
    centres = model.surface.points[triangles].mean(axis=1)
    on_half = (centres[:, 2] > SIDES[2] - 1e-9) & (centres[:, 0] > 0.5 * SIDES[0])
    return model, pressed(model.surface, np.where(on_half, 10.0, 0.0))


@pytest.mark.parametrize(("load", "n", "most"), [("pressed", 2, 1.2), ("sprung", 2, 2.0), ("moved", 3, 2.7)])
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


@pytest.mark.parametrize("load", ["pressed", "sprung"])
def test_the_change_of_shape_is_told_by_integrals_on_half_of_the_nodes(load: str) -> None:
    """Half of the distance to a mesh twice as fine and more, three times it here: its facets are coarser too."""
    (coarse, push), (fine, finer_push) = (standing(n, load, solver="nonlinear") for n in (3, 6))
    solution = coarse.solve([push.scaled(1e-3)])
    surface = coarse.surface
    nearest = np.argmin(np.linalg.norm(surface.points[:, None] - fine.surface.points, axis=2), axis=1)
    finer = fine.solve([finer_push.scaled(1e-3)])
    expected = finer.displacement[0][nearest]
    weights = np.sqrt(surface.nodal_areas)[:, None]
    change, size = (weights * u for u in (solution.displacement[0] - expected, expected))
    motions = (weights[:, :, None] * rigid_basis(surface).reshape(-1, 3, 6)).reshape(-1, 6)
    rigid = np.linalg.qr(motions)[0]
    change, size = (u.reshape(-1) - rigid @ (rigid.T @ u.reshape(-1)) for u in (change, size))
    error = 4.0 / 3.0 * np.linalg.norm(change) / np.linalg.norm(size)
    assert error > 0.01
    assert 0.5 < solution.scalars["shape_error"][0] / error < 4.0
    assert finer.scalars["shape_error"][0] < 0.5 * solution.scalars["shape_error"][0]


def test_a_quarter_of_the_nodes_tells_about_what_half_of_them_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a coarser body is further off is taken out; undivided, both errors are 2.5 times as large."""

    def told() -> NDArray[np.float64]:
        model, push = standing(4, "pressed", solver="nonlinear")
        solution = model.solve([push.scaled(1e-3)])
        return np.array([solution.scalars[name][0] for name in ("mesh_error", "shape_error")])

    half, halved = told(), coarsening.coarsened
    monkeypatch.setattr(coarsening, "coarsened", lambda body, count, *held: halved(body, count // 2, *held))
    assert_allclose(told(), half, rtol=0.4)


def test_no_other_form_has_one_nor_a_load_of_nothing() -> None:
    points, triangles = icosphere(2, (0.05, 0.05, 0.05))
    nothing, foot = Load(np.zeros(len(points))), points[:, 2] < -0.03
    vector = Model(points, triangles, Parameters(surface_tension=1.0), formulation="vector", fixed=foot)
    held = Model(points, triangles, Parameters(shear_modulus=1.0), formulation="bem", fixed=foot)
    for model in (vector, held):
        solution = model.solve([nothing])
        assert "mesh_error" not in solution.scalars
        assert not solution.status[0].message


def test_a_cavity_that_sticks_out_of_every_coarse_surface_leaves_the_answer() -> None:
    """A wall thinner than what coarse facets cut off."""
    (x, outer), (y, inner) = icosphere(2, (0.05, 0.05, 0.05)), icosphere(1, (0.005, 0.005, 0.005))
    under = x[outer[200]].mean(axis=0)
    points = np.vstack([x, y + 0.0435 * under / np.linalg.norm(under)])
    surface = SurfaceMesh(points, np.vstack([outer, inner[:, ::-1] + len(x)]))
    for less in (2, 8):
        with pytest.raises(SurfaceError, match="do not bound one body"):
            coarsened(surface, surface.n_nodes // less)
    material, fixed = Parameters(shear_modulus=1e3), points[:, 2] > 0.03
    model = Model(points, surface.triangles, material, formulation="bem", solver="nonlinear", fixed=fixed)
    solution = model.solve([Load(np.where(np.abs(points[:, 0]) > 0.04, 10.0, 0.0))])
    assert solution.status[0].ok
    assert "mesh_error" not in solution.scalars


@pytest.mark.parametrize("which", ["bending", "mesh", "shape"])
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


def test_a_rod_thinner_than_its_mesh_is_coarse_has_one() -> None:
    model = held_at_one_end(*icosphere(2, THIN))
    message, remedy = told(model)
    assert 0.8 < model.bending_error < 1.1
    assert f"a known bending comes out {100 * model.bending_error:.0f} % wrong" in message
    assert remedy == "refine the surface, above all where it is thin, to about 1,600 nodes"
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
