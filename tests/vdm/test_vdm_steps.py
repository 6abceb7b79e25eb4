"""A frame computes what is asked of it and no more; of a resting contact it is a shortened product."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import BASE, POINTS, icosphere, model
from vdm import FORMULATIONS, ConstraintError, Load, Model, Parameters, SurfaceMesh
from vdm.solvers import columns
from vdm.solvers.columns import ContactColumns, contact_columns

TOP = POINTS[:, 2] > 0.04
RANDOM = np.random.default_rng(5)
FORMS = [*FORMULATIONS]
PRODUCTS = ("apply", "internal_force", "nodal_force", "displacement")


def on_coarse_nodes() -> Model:
    """The sparse form of a body with more nodes than it makes dense."""
    points, triangles = icosphere(3, (0.05, 0.06, 0.045))
    parameters = Parameters(shear_modulus=1667.0, coarse_nodes=200)
    return Model(points, triangles, parameters, formulation="bem-sparse", fixed=points[:, 2] < -0.03)


def a_load() -> Load:
    """Pressures and forces at all nodes, and displacements of the top."""
    n = len(POINTS)
    force, moved = 1e-3 * RANDOM.standard_normal((n, 3)), 1e-4 * RANDOM.standard_normal((n, 3))
    return Load(20.0 * RANDOM.random(n), force, moved)


@pytest.mark.parametrize("solver", ["linear", "quasi-linear"])
@pytest.mark.parametrize("form", FORMS)
def test_a_frame_that_asks_for_nothing_computes_nothing(form, solver, monkeypatch):
    body = on_coarse_nodes() if (form, solver) == ("bem-sparse", "linear") else model(form, solver=solver)
    seen: list[str] = []
    for name in PRODUCTS:
        original = getattr(type(body.formulation), name)

        def counted(self, *arguments, name=name, original=original):
            seen.append(name)
            return original(self, *arguments)

        monkeypatch.setattr(type(body.formulation), name, counted)
    step = body.solver.step(Load(20.0 * (body.surface.points[:, 2] > 0.04)))
    # the quasi-linear solver asks where the surface of the last step is, and for nothing else
    assert seen == ([] if solver == "linear" else ["displacement"])
    seen.clear()
    first = step.reaction_force, step.energy, step.displacement
    # the sparse form's factor gives the force at the supports with the answer: no product with the whole operator
    products = [] if (form, solver) == ("bem-sparse", "linear") else ["apply"]
    assert [name for name in seen if name == "apply"] == products
    seen.clear()
    assert all(
        a is b for a, b in zip(first, (step.reaction_force, step.energy, step.displacement), strict=True)
    )
    assert not seen


@pytest.mark.parametrize("form", FORMS)
def test_reactions_and_energy_are_those_of_the_whole_operator(form):
    body = model(form, constrained=TOP, density=1060.0, gravity=(1.0, 0.0, -9.81))
    load = a_load()
    step = body.solver.step(load)
    form_of, problem = body.formulation, body.problem
    # K x column by column of its identity, whatever the formulation keeps of it
    unit = np.eye(step.unknown.size).reshape(-1, *step.unknown.shape)
    matrix = np.stack([form_of.apply(column).reshape(-1) for column in unit], axis=1)
    product = (matrix @ step.unknown.reshape(-1)).reshape(step.unknown.shape)
    columns = form_of.columns.dense()
    internal = product - columns[:, :, 1:] @ step.border[1:]
    lacking = internal - columns[:, :, 0] * step.border[0] - problem.force(load)
    size = np.abs(product).max()
    assert np.abs(lacking[problem.free]).max() < 1e-9 * size
    lacking[problem.free] = 0.0
    reaction = form_of.nodal_force(lacking)
    assert_allclose(step.reaction_force, reaction, rtol=1e-9, atol=1e-9 * np.abs(reaction).max())
    work = 0.5 * np.vdot(form_of.displacement(step.unknown), form_of.nodal_force(internal))
    assert_allclose(step.energy, work, rtol=1e-9, atol=1e-12 * abs(work))
    solution = body.solve([load])
    assert np.array_equal(solution.reaction_force[0], step.reaction_force)
    assert solution.energy[0] == step.energy


@pytest.mark.parametrize("form", FORMS)
def test_what_the_caller_does_to_a_load_afterwards_changes_no_step(form):
    body = model(form, constrained=TOP)
    load = a_load()
    first, second = body.solver.step(load), body.solver.step(load)
    before = first.reaction_force.copy(), first.energy
    for part in (load.contact_pressure, load.contact_force, load.prescribed):
        part[...] = np.nan
    assert np.array_equal(second.reaction_force, before[0])
    assert second.energy == before[1]


@pytest.mark.parametrize("solver", ["linear", "quasi-linear", "nonlinear"])
@pytest.mark.parametrize("formulation", ["vector", "bem"])
def test_the_block_is_factored_once_for_a_whole_history(formulation, solver, monkeypatch):
    made: list[tuple[str, int]] = []
    original = FORMULATIONS[formulation].factor

    def counted(self, free, *options):
        made.append((type(self).__name__, int(free.sum())))
        return original(self, free, *options)

    monkeypatch.setattr(FORMULATIONS[formulation], "factor", counted)
    body = model(formulation, solver=solver)
    history = body.solve([Load(20.0 * TOP).scaled(s) for s in (0.5, 1.0, 0.2)])
    body.solve([Load(20.0 * TOP)])
    assert [status.code for status in history.status] == ["converged"] * 3
    assert len(set(made)) == len(made)  # the error of the mesh needs a body of its own, once
    assert made[0] == (FORMULATIONS[formulation].__name__, np.count_nonzero(~BASE))


FINE, FINE_FACETS = icosphere(4, (0.06, 0.05, 0.045))
FINE_BODY = SurfaceMesh(FINE, FINE_FACETS)
FINE_BASE = FINE[:, 2] < -0.035
PATCH = np.argsort(-FINE[:, 2])[:50]


@pytest.fixture(scope="module", params=["paper", "consistent", "vector"])
def solver(request) -> Model:
    material = Parameters.from_tissue(5000.0, FINE_BODY, request.param)
    return Model(FINE, FINE_FACETS, material, formulation=request.param, fixed=FINE_BASE)


def error_of_a_frame(contact: ContactColumns, body: Model, nodes, pressure) -> float:
    """Of displacement and fluid's pressure against the full solve, the larger in parts of its largest value."""
    load = np.zeros(len(FINE))
    load[nodes] = pressure
    solution = body.solve([Load(load)])
    unknown, fluid = contact.frame(pressure)
    moved, full = body.formulation.displacement(unknown), solution.displacement[0]
    size = np.abs(full).max()
    if not size:
        return float(np.abs(moved).max())
    return max(np.abs(moved - full).max() / size, abs(fluid / solution.fluid_pressure[0] - 1.0))


def test_frames_of_a_resting_contact_equal_the_full_solve(solver):
    contact = contact_columns(solver.solver, PATCH)
    rng = np.random.default_rng(5)
    pressures = [rng.random(50), rng.random(50) ** 8, np.eye(50)[7], np.eye(50)[49], np.zeros(50)]
    for k, pressure in enumerate(100.0 * np.array(pressures)):
        assert error_of_a_frame(contact, solver, PATCH, pressure) < 1e-6
        assert (contact._short is not None) == (k > 0), "shortened at the second frame"
    short = contact._short
    assert len(short.bases) == solver.formulation.components
    assert all(basis.shape[1] < 30 for basis in short.bases)
    assert sum(basis.shape[1] for basis in short.bases) == len(short.mixes)
    assert contact.nbytes < 0.75 * contact.columns.nbytes


def test_a_contact_all_over_the_body_is_not_shortened(solver):
    nodes = np.flatnonzero(~FINE_BASE)[::50]
    contact = contact_columns(solver.solver, nodes)
    for _ in range(3):
        assert error_of_a_frame(contact, solver, nodes, np.full(len(nodes), 50.0)) < 1e-6
    assert contact._short is None
    with pytest.raises(ConstraintError, match="contact nodes"):
        contact_columns(solver.solver, np.array([len(FINE)]))


@pytest.mark.parametrize(("axis", "least"), [(0, 0.5), (2, 0.3)])
def test_a_contact_is_shortened_from_where_it_reads_least(axis, least, monkeypatch):
    """Amid a long body more of its nodes stay whole than at its end; no other reach gives less."""
    points, triangles = icosphere(4, (0.02, 0.02, 0.12))
    body = SurfaceMesh(points, triangles)
    material = Parameters.from_tissue(5000.0, body, "vector")
    model = Model(points, triangles, material, formulation="vector", fixed=points[:, 2] < -0.1)
    nodes = np.argsort(-points[:, axis])[:20]
    sizes = []
    for reaches in (columns.REACHES, *columns.REACHES[:, None]):
        monkeypatch.setattr(columns, "REACHES", reaches)
        contact = contact_columns(model.solver, nodes)
        for _ in range(2):
            contact.frame(np.full(len(nodes), 50.0))
        sizes.append(contact.nbytes)
    assert sizes[0] == min(sizes[1:])
    assert least < sizes[0] / contact.columns.nbytes < least + 0.4


def test_the_printed_sign_holds_for_columns_too():
    material = Parameters.from_tissue(5000.0, FINE_BODY, "consistent")
    body = Model(
        FINE, FINE_FACETS, material, formulation="consistent", fixed=FINE_BASE, contact_sign="printed"
    )
    pressure = np.linspace(1.0, 50.0, len(PATCH))
    contact = contact_columns(body.solver, PATCH)
    assert error_of_a_frame(contact, body, PATCH, pressure) < 1e-6
    found = body.formulation.displacement(contact.frame(pressure)[0])
    assert found[PATCH[0]] @ FINE_BODY.normals[PATCH[0]] > 0.0, "bulges towards the finger"


def test_the_sparse_form_leaves_out_what_its_own_error_hides():
    """Its columns look alike only but for their interpolation, 1e-4 of them."""
    body = Model(
        FINE,
        FINE_FACETS,
        Parameters(shear_modulus=2e3, coarse_nodes=400),
        formulation="bem-sparse",
        fixed=FINE_BASE,
    )
    contact, pressure = contact_columns(body.solver, PATCH), np.random.default_rng(7).random(50)
    contact.frame(pressure)
    error = error_of_a_frame(contact, body, PATCH, pressure)
    assert contact.nbytes < 0.8 * contact.columns.nbytes
    assert 1e-7 < error < 1e-4
