"""The registry: every name that a study can write runs and agrees with its siblings; frames; fibres."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.loads import Load
from solver_common.quadrature import facet_quadrature
from tests.bodies import telling_params
from vdm.solvers import SOLVERS
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.surface_measures import Surface, facet_area_vectors, relative_l2
from vdmbench.measures.metrics import METRICS, History
from vdmbench.models.frames import contact_frame
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.registry import DISPLACEMENT_ELEMENTS, Family, family_of, is_linear, split
from vdmbench.study.schema import Study, VdmTable

STUDY: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-paper"]},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.016},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.4999},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.5}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.002},
    ],
    "load": {"factors": [0.5, 1.0]},
}


@pytest.fixture(scope="module")
def scene() -> Scene:
    study = Study.model_validate(STUDY)
    return build_scene(study, build_mesh(study.geometry))


@pytest.fixture(scope="module")
def firsts() -> dict[str, ModelResult]:
    """What models say with their first solvers, by their names."""
    return {}


@pytest.mark.parametrize("name", [*telling_params(), *(f"vdm-vector:{solver}" for solver in SOLVERS)])
def test_every_name_runs(scene: Scene, firsts: dict[str, ModelResult], name: str) -> None:
    result = models.run_model(scene, name)
    assert all(status.ok for status in result.status), result.status
    model, solver = models.find(name)
    if model.name not in firsts:
        firsts[model.name] = models.run_model(scene, model.name)
    first = firsts[model.name]
    areas = Surface(scene.mesh.surface_points, scene.mesh.triangles).areas
    # at 2 mN, some 10 micrometres, all solvers of a formulation are in the linear range
    difference = relative_l2(result.displacement[-1], first.displacement[-1], areas)
    allowed = {"quasi-linear": 5e-3, "nonlinear": 5e-3, "incremental": 5e-3, "figure-8": 5e-3, "single": 1e-4}
    assert difference < allowed.get(solver, 1e-6)
    assert result.version == model.version
    assert (result.seconds_per_step > 0).all()
    assert result.seconds_setup > 0


def test_what_a_name_tells_is_what_the_registry_knows() -> None:
    names = [name for name in models.model_names() if family_of(name) is not Family.ENGINES]
    assert [split(name) for name in names] == [(m.name, s) for m, s in map(models.find, names)]
    nonlinear = [name for name in names if not is_linear(name)]
    assert [name for name in nonlinear if split(name)[1] == "linear"] == ["fem", "fem:linear"]
    solvers = {"linear", "plain", "quasi-linear", "nonlinear", "incremental", "figure-8"}
    assert {split(name)[1] for name in nonlinear} == solvers
    assert split("fem refined") == ("fem", "linear")


@pytest.mark.parametrize("name", ["vdm", "vdm-paper:magic", "fem-linear:lu", ""])
def test_other_names_are_unknown(name: str) -> None:
    with pytest.raises(KeyError):
        models.find(name)


def test_parameters_come_from_the_study_the_model_or_the_rule() -> None:
    study = Study.model_validate(
        STUDY
        | {
            "vdm": {"bulk_modulus": 300.0},
            "models": {"vdm-paper:lu": {"bulk_modulus": 500.0, "penalty": 1e9}},
        }
    )
    scene = build_scene(study, build_mesh(study.geometry))
    plain, own = (models.run_model(scene, name) for name in ("vdm-paper", "vdm-paper:lu"))
    assert plain.parameters["bulk_modulus"] == 300.0
    assert own.parameters["bulk_modulus"] == 500.0
    assert plain.parameters["connectivity_modulus"] == own.parameters["connectivity_modulus"] > 0, "by rule"
    # a penalty lets held nodes move a little; elimination does not
    assert_allclose(plain.displacement[:, scene.fixed], 0.0, rtol=0, atol=0)
    assert 0 < np.abs(own.displacement[:, scene.fixed]).max() < 1e-6


@pytest.mark.parametrize(
    ("name", "moves"),
    [("vdm-vector", True), ("vdm-paper:lu", True), ("vdm-vector:bicg", False), ("vdm-paper:bicg", False),
     ("vdm-consistent:bicg", False), ("mass-spring:bicg", False), ("bem:nonlinear", False)],
)  # fmt: skip
def test_a_penalty_is_solved_by_lu_and_read_by_no_other_solver(scene: Scene, name: str, moves: bool) -> None:
    penalised = dataclasses.replace(scene, parameters={"penalty": 1e3})
    result = models.run_model(penalised, name)
    assert all(status.ok for status in result.status)
    most = np.abs(result.displacement[:, scene.fixed]).max()
    assert (most > 0) == moves, "a penalty lets held nodes move"


VALUES = {
    "bulk_modulus": 300.0,
    "connectivity_modulus": 4000.0,
    "foundation": 5e4,
    "surface_tension": 40.0,
    "stretch_stiffness": 30.0,
    "shear_modulus": 1000.0,
    "coarse_nodes": 120,
    "compressibility": "fluid",
    "rotation": "none",
    "penalty": 1e3,
    "tolerance": 1e-3,
    "stop": "residual",
    "volume_row": "printed",
    "parts": 2,
}
SOLVER = {
    "tolerance": "bicg",
    "stop": "figure-8",
    "volume_row": "quasi-linear",
    "parts": "nonlinear",
}  # of a key that the default solver has no use for


@pytest.mark.parametrize("name", sorted(name for name, m in models.all_models().items() if not m.volumetric))
def test_a_model_reads_the_keys_that_change_its_answer_and_no_others(name: str) -> None:
    """Against solves: the list that study files are held against is what the models do."""
    assert set(VALUES) == set(VdmTable.model_fields)
    model = models.all_models()[name]
    fine = "coarse_nodes" in model.parameters  # enough nodes for a skin on a coarse body of 120
    geometry = {"shape": "sphere", "radius": 0.05, "mesh_size": 0.016 if fine else 0.025}
    study = Study.model_validate(STUDY | {"geometry": geometry})
    scene = build_scene(study, build_mesh(study.geometry))
    assert len(scene.fixed) > 120 or not fine
    asked_for = {key: f"{name}:{SOLVER[key]}" if SOLVER.get(key) in model.solvers else name for key in VALUES}
    answers = {asked: models.run_model(scene, asked) for asked in set(asked_for.values())}
    assert all(np.isfinite(plain.displacement).all() for plain in answers.values())

    def are_read(keys: Sequence[str], asked: str) -> bool:
        given = dataclasses.replace(scene, parameters={key: VALUES[key] for key in keys})
        other, plain = models.run_model(given, asked), answers[asked]
        return not np.array_equal(other.displacement, plain.displacement, equal_nan=True)

    for key in model.parameters:
        assert are_read([key], asked_for[key]), key
    for asked in answers:
        others = [key for key in VALUES if key not in models.reads(asked)]
        assert not are_read(others, asked), others


@pytest.mark.parametrize("gravity", [None, {"acceleration": [0.0, 0.0, -9.81]}], ids=["scaled", "solved"])
def test_a_history_equals_its_steps_one_by_one(gravity: dict[str, object] | None) -> None:
    """Steps that are multiples of one load are scaled, others are solved; both against studies of one step."""
    tool = {"kind": "constrained", "region": "finger", "displacement": [0.0, 0.0002, -0.001]}
    for constraint in (STUDY["constraints"][1], tool):
        tables = STUDY | {
            "geometry": STUDY["geometry"] | {"mesh_size": 0.025},
            "constraints": [STUDY["constraints"][0], constraint],
            "load": {"factors": [0.3, -1.0, 2.0]},
        }
        tables |= {"gravity": gravity} if gravity else {}
        study = Study.model_validate(tables)
        mesh = build_mesh(study.geometry)
        together = models.run_model(build_scene(study, mesh), "fem-linear")
        for step, factor in enumerate((0.3, -1.0, 2.0)):
            alone = Study.model_validate(tables | {"load": {"factors": [factor]}})
            single = models.run_model(build_scene(alone, mesh), "fem-linear")
            for field in ("displacement", "reaction_force", "energy", "fluid_pressure", "volume"):
                a, b = getattr(together, field)[step], getattr(single, field)[0]
                assert_allclose(a, b, rtol=1e-9, atol=1e-11 * np.abs(b).max(), err_msg=field)


@pytest.mark.parametrize("name", ["vdm-consistent", "fem-linear", "fem-condensed", "fem"])
def test_the_condition_is_estimated_where_it_is_asked_for(name: str, scene: Scene) -> None:
    plain, asked = (
        models.run_model(dataclasses.replace(scene, condition=condition), name) for condition in (False, True)
    )
    assert "condition_estimate" not in plain.scalars
    estimate = asked.scalars["condition_estimate"]
    assert estimate.shape == (len(scene.load_factors),)
    assert (estimate > 1.0).all()
    assert (asked.scalars["relative_residual"] < 1e-8).all()
    assert np.array_equal(plain.displacement, asked.displacement)


@pytest.mark.parametrize("name", models.all_models())
def test_a_contact_without_force_leaves_the_body_at_rest(name: str, scene: Scene) -> None:
    result = models.run_model(
        dataclasses.replace(scene, facet_pressure=np.zeros_like(scene.facet_pressure)), name
    )
    assert [status.code for status in result.status] == ["converged"] * len(scene.load_factors)
    for field in ("displacement", "reaction_force", "energy"):
        assert not getattr(result, field).any(), field


def test_which_elements_have_no_answer_for_an_incompressible_body_is_known(scene: Scene) -> None:
    tissue = scene.tissue.model_copy(update={"poisson_ratio": 0.5})
    scene = dataclasses.replace(scene, tissue=tissue, load_factors=scene.load_factors[-1:])
    names = [m.name for m in models.all_models().values() if m.family is Family.ELEMENTS]
    refused = {name for name in names if models.run_model(scene, name).status[0].code == models.REFUSED}
    assert refused == set(DISPLACEMENT_ELEMENTS)


PRESSED = {
    "geometry": {"shape": "ellipsoid", "semi_axes": [0.06, 0.04, 0.05], "mesh_size": 0.016},
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.1, "profile": "hertz"},
    ],
}


@pytest.fixture(scope="module")
def pressed() -> Scene:
    study = Study.model_validate({key: value for key, value in STUDY.items() if key != "load"} | PRESSED)
    return build_scene(study, build_mesh(study.geometry))


def problem_of(scene: Scene, name: str) -> Any:
    """What answers contact pressures linearly, set up."""
    set_up = models.Prepared(scene, name).set_up
    assert set_up is not None
    return set_up.problem if models.superposes(name) else None


@pytest.mark.parametrize("name", ["vdm-paper", "vdm-vector", "bem", "fem-linear", "fem-condensed"])
def test_a_frame_is_the_answer_of_the_model(pressed: Scene, name: str) -> None:
    result = models.run_model(pressed, name)
    problem = problem_of(pressed, name)
    frame = contact_frame(problem, pressed)
    pressure = pressed.contact_pressure[pressed.contact]
    largest = np.abs(result.displacement[-1]).max()
    for factor in (1.0, 1.0, -0.5):  # the second frame may shorten the columns
        displacement, fluid_pressure = frame(factor * pressure)
        assert displacement.shape == (len(pressed.fixed), 3)
        assert displacement.dtype == (np.float64 if name == "vdm-paper" else np.float32)
        assert_allclose(displacement, factor * result.displacement[-1], rtol=0, atol=1e-6 * largest)
        assert_allclose(fluid_pressure, factor * result.fluid_pressure[-1], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["fem-linear", "fem-condensed"])
def test_a_node_has_its_share_of_the_contact(pressed: Scene, name: str) -> None:
    """100 Pa at one node: the contact's pressure times the node's share of each point, 100 Pa A_i in all."""
    points, triangles = pressed.mesh.surface_points, pressed.mesh.triangles
    problem = problem_of(pressed, name)
    node = int(np.argmax(pressed.contact_pressure))
    pressure = np.where(np.flatnonzero(pressed.contact) == node, 100.0, 0.0)
    displacement, fluid_pressure = contact_frame(problem, pressed)(pressure)
    corners, weights = facet_quadrature()
    part = np.zeros_like(pressed.facet_pressure)
    for facet, corner in zip(*np.nonzero(triangles == node), strict=True):
        part[facet] = pressed.facet_pressure[facet] * corners[:, corner]
    part *= 100.0 / pressed.contact_pressure[node]
    areas = np.linalg.norm(facet_area_vectors(points, triangles), axis=1)
    around = areas[(triangles == node).any(axis=1)].sum() / 3.0
    assert_allclose(areas @ part @ weights, 100.0 * around, rtol=1e-12, atol=0)
    solved = problem.solve([Load(part, np.zeros_like(pressed.prescribed), np.zeros(3))])
    size = np.abs(solved.displacement).max()
    assert_allclose(displacement, solved.displacement[0], rtol=0, atol=1e-6 * size)
    assert_allclose(fluid_pressure, solved.fluid_pressure[0], rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("name", "penalty"), [("fem", 0), ("vdm-vector:nonlinear", 0), ("vdm-paper:bicg", 0), ("vdm-paper", 1e8)]
)
def test_other_models_have_no_columns(pressed: Scene, name: str, penalty: float) -> None:
    parameters = {"penalty": penalty} if penalty else {}
    assert problem_of(dataclasses.replace(pressed, parameters=parameters), name) is None


X, Y, Z = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0])
TOUCHED: dict[str, Any] = {key: value for key, value in STUDY.items() if key != "load"} | {
    "geometry": STUDY["geometry"] | {"mesh_size": 0.014},
    "regions": STUDY["regions"] | {"finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.5}}},
    "constraints": [STUDY["constraints"][0], STUDY["constraints"][1] | {"force": 0.02}],
}


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return build_mesh(Study.model_validate(TOUCHED).geometry)


def of_fibres(mesh: Mesh, model: str, anisotropy: dict[str, Any] | None) -> ModelResult:
    study = Study.model_validate(TOUCHED | ({"anisotropy": anisotropy} if anisotropy else {}))
    return models.run_model(build_scene(study, mesh), model)


def strains(mesh: Mesh, result: ModelResult) -> np.ndarray:
    """Mean strain along x, y, z."""
    assert result.status[0].ok, result.status
    surface = Surface(mesh.surface_points, mesh.triangles)
    history = History(result.displacement, result.reaction_force, np.ones(1))
    return np.array([METRICS[f"mean_strain_{axis}"].function(surface, history)[0] for axis in "xyz"])


@pytest.mark.parametrize("model", ["vdm-paper", "vdm-consistent", "vdm-vector", "fem-linear", "fem"])
def test_the_bulge_turns_with_the_fibres(mesh: Mesh, model: str) -> None:
    """A ball pressed from above bulges sideways, less along the fibres than across them."""
    plain = strains(mesh, of_fibres(mesh, model, None))
    along_x, along_y = (
        strains(mesh, of_fibres(mesh, model, {"fibre_direction": d, "contrast": 4})) for d in (X, Y)
    )
    assert plain[2] < 0.0 < plain[0]
    assert_allclose(plain[0], plain[1], rtol=0.02, atol=0)  # a body of revolution
    assert along_x[0] < 0.85 * along_x[1]
    assert along_y[1] < 0.85 * along_y[0]
    # the mesh has no preferred direction: the answer turns with the fibres
    assert_allclose(along_x[[1, 0, 2]], along_y, rtol=0.05, atol=0)
    one = strains(mesh, of_fibres(mesh, model, {"fibre_direction": X, "contrast": 1}))
    assert_allclose(one, plain, rtol=1e-7, atol=0)


def test_a_model_without_fibres_is_refused_by_itself(mesh: Mesh) -> None:
    boundary = of_fibres(mesh, "bem", {"fibre_direction": Z, "contrast": 2})
    assert boundary.status[0].code == models.REFUSED
    assert "isotropic; use another model for fibres" in boundary.status[0].message
    assert np.isnan(boundary.displacement).all()
    for model in ("fem-linear", "fem"):
        softer = of_fibres(mesh, model, {"fibre_direction": Z, "contrast": 0.5})
        assert softer.status[0].code == models.REFUSED
        assert softer.status[0].message == "contrast is 0.5"
        assert softer.status[0].remedy == "give 1 or more: fibres stiffen the body"
    assert of_fibres(mesh, "vdm-paper", {"fibre_direction": Z, "contrast": 0.5}).status[0].ok
