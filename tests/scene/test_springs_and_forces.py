"""Springs to the ground and dead forces on a line or a part of the surface, by a study: in every model."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from solver_common.quadrature import facet_quadrature
from tests.bodies import shaped, telling_params
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import refined
from vdmbench.body.surface_measures import facet_area_vectors, facet_areas
from vdmbench.measures.reference import level_scene
from vdmbench.scene.regions import SceneError
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.loads import KINDS
from vdmbench.study.registry import is_linear
from vdmbench.study.schema import Study

FORCE = 0.02  # N: moves the top by a thousandth of its height
BED: dict[str, Any] = {"kind": "elastic", "region": "bottom", "stiffness": 2e5}
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-consistent", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "box", "size": [0.06, 0.03, 0.03], "mesh_size": 0.015},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "clamp": {"below": {"axis": "x", "fraction": 0.001}},
        "bottom": {"below": {"axis": "z", "fraction": 0.001}},
        "top": {"box": {"min": [-0.02, -0.02, 0.0149], "max": [0.04, 0.02, 0.0151]}},
        "edge": {"box": {"min": [0.0299, -0.02, 0.0149], "max": [0.0301, 0.02, 0.0151]}},
        "end": {"above": {"axis": "x", "fraction": 0.999}},
    },
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        BED,
        {"kind": "contact", "region": "top", "force": FORCE},
    ],
}

SCALAR = ["vdm-paper", "vdm-consistent"]  # whose nodes move along normals only


def study(*parts: dict[str, Any], **tables: Any) -> Study:
    clamp, _, push = BASE["constraints"]
    given = {"constraints": [clamp, *parts, push]} if parts else {}
    return Study.model_validate(BASE | given | tables)


@pytest.fixture(scope="module")
def box() -> Mesh:
    return build_mesh(study().geometry)


BOWL: dict[str, Any] = {
    "bottom": {"below": {"axis": "z", "fraction": 0.5}},
    "top": {"cap": {"direction": [1.0, 0.3, 0.4], "angle": "25 deg"}},
}


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(shaped("sphere", 0.02, {"radius": 0.05}))


def answer(mesh: Mesh, name: str, *parts: dict[str, Any], **tables: Any) -> ModelResult:
    return models.run_model(build_scene(study(*parts, **tables), mesh), name)


@pytest.mark.parametrize("direction", ["normal", "full"])
@pytest.mark.parametrize("name", telling_params())
def test_every_model_balances_it_or_refuses_it_by_name(box: Mesh, name: str, direction: str) -> None:
    model, solver = models.find(name)
    result = answer(box, name, BED | {"direction": direction})
    if solver not in model.takes.get(f"{direction} springs", ()):
        assert result.status[0].code == models.REFUSED
        assert f"{name} takes no springs" in result.status[0].message
        return
    assert result.status[0].ok, result.status
    on_bottom = build_scene(study(), box).regions["bottom"]
    share = result.reaction_force[0, on_bottom, 2].sum() / FORCE
    if model.name in SCALAR:  # whose foundation is tied to space, and whose forces do not add up
        assert 0.1 < share < 0.4
    else:
        assert 0.4 < share < 1.2, "most of the force goes into the bed"
        # at large displacements the pressure turns with the surface
        tolerance = 1e-6 if is_linear(name) else 5e-3
        assert_allclose(result.reaction_force[0].sum(axis=0), [0, 0, FORCE], atol=tolerance * FORCE)
    if model.name != "vdm-paper":  # whose load does its work on other areas
        work = 0.5 * np.vdot(result.displacement[0], build_scene(study(), box).contact_force)
        assert 0.0 < result.energy[0] < work, "the springs keep a part of the work"


@pytest.mark.parametrize(
    ("name", "limit", "constants"),
    [(name, "fixed", (1e9, 1e10)) for name in ("vdm-consistent", "mass-spring", "fem-linear", "fem")]
    + [(name, "free", (10.0, 1.0)) for name in ("vdm-consistent", "bem", "fem-linear", "fem-condensed")],
)
def test_stiff_springs_tend_to_a_fixed_region_and_soft_ones_to_a_free_one(
    box: Mesh, name: str, limit: str, constants: tuple[float, float]
) -> None:
    """A tenth of the distance is left at the second constant."""
    clamp, _, push = BASE["constraints"]
    held = [{"kind": "fixed", "region": "bottom"}] if limit == "fixed" else []
    there = answer(box, name, constraints=[clamp, *held, push])
    assert there.status[0].ok
    bed = BED | {"direction": "normal" if name in SCALAR else "full"}
    near = [answer(box, name, bed | {"stiffness": k}).displacement for k in constants]
    gaps = [np.abs(u - there.displacement).max() for u in near]
    assert gaps[0] < 0.03 * np.abs(there.displacement).max(), gaps
    assert 8.0 < gaps[0] / gaps[1] < 12.0, gaps


def test_refined_springs_are_the_same_springs(box: Mesh) -> None:
    scene = level_scene(study(), refined(box, 1))
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles[scene.springs[0].facets]
    assert_allclose(facet_areas(points, triangles).sum(), 0.06 * 0.03, rtol=1e-12)


@pytest.mark.parametrize("direction", ["normal", "full"])
@pytest.mark.parametrize("name", ["vdm-vector", "bem", "fem-linear"])
def test_a_stiff_ball_turns_in_its_bed_as_a_rigid_one_would(ball: Mesh, name: str, direction: str) -> None:
    """Springs along the normals of flat facets hold a turn in a round bed by what the facets are off the ball."""
    given = study(
        regions=BOWL,
        constraints=[BED | {"direction": direction}, BASE["constraints"][2]],
        tissue={"youngs_modulus": 1e9, "poisson_ratio": 0.49},
    )
    scene = build_scene(given, ball)
    points, triangles = ball.surface_points, ball.triangles
    bed = scene.springs[0].facets
    at = np.einsum("qa,fac->fqc", facet_quadrature()[0], points[triangles[bed]])
    areas = facet_areas(points, triangles)[bed]
    normals = facet_area_vectors(points, triangles)[bed] / areas[:, None]
    moved = rigid(at)
    if direction == "normal":
        moved = np.einsum("fqcm,fc->fqm", moved, normals)[:, :, None]
    bowl = BED["stiffness"] * np.einsum("fqcm,fqcn,q,f->mn", moved, moved, facet_quadrature()[1], areas)
    push = np.einsum("ncm,nc->m", rigid(points), scene.contact_force)
    exact = rigid(points) @ np.linalg.solve(bowl, push)
    found = models.run_model(scene, name)
    assert found.status[0].ok, found.status
    # what the tissue of 1 GPa gives way
    assert_allclose(found.displacement[0], exact, rtol=0, atol=5e-3 * np.abs(exact).max())


def rigid(points: np.ndarray) -> np.ndarray:
    """(..., 3, 6) displacement of (..., 3) points by the six rigid motions."""
    turns = np.cross(np.eye(3)[:, None], points.reshape(-1, 3)).transpose(1, 2, 0)
    moves = np.broadcast_to(np.eye(3), (len(turns), 3, 3))
    return np.concatenate([moves, turns], axis=2).reshape(*points.shape, 6)


def test_springs_under_held_facets_are_refused(box: Mesh) -> None:
    with pytest.raises(SceneError, match="facets that are fixed or constrained"):
        build_scene(study(BED | {"region": "clamp"}), box)


# --- dead forces ---

PULL = np.array([1e-3, 2e-3, -5e-3])  # N: moves the tip by 0.01 of its width
LINE: dict[str, Any] = {
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        {"kind": "line", "region": "edge", "resultant": PULL.tolist()},
    ],
}


def test_a_line_is_the_edges_between_its_nodes(box: Mesh) -> None:
    scene = build_scene(study(**LINE), box)
    ((edges, force),) = scene.dead
    ends = box.surface_points[edges]
    assert_allclose(ends[:, :, [0, 2]], np.broadcast_to([0.03, 0.015], (len(edges), 2, 2)), atol=1e-12)
    assert_allclose(np.abs(ends[:, 1, 1] - ends[:, 0, 1]).sum(), 0.03, rtol=1e-12)
    nodal = scene.load(2.0).dead_force
    assert_allclose(nodal.sum(axis=0), 2 * PULL, rtol=1e-12)
    # spread by length: its moment is that of the resultant at the middle of the edge
    assert_allclose((box.surface_points[:, 1, None] * nodal).sum(axis=0), 0.0, atol=1e-15)
    assert_allclose(force, PULL)


def test_a_refined_line_is_the_same_line(box: Mesh) -> None:
    scene = level_scene(study(**LINE), refined(box, 1))
    assert len(scene.dead[0][0]) == 2 * len(build_scene(study(**LINE), box).dead[0][0])
    assert_allclose(scene.load(1.0).dead_force.sum(axis=0), PULL, rtol=1e-12)


@pytest.mark.parametrize(
    ("region", "told"),
    [
        ({"above": {"axis": "x", "fraction": 0.9}}, "a line is one node wide"),
        ({"ball": {"center": [0.03, 0.015, 0.015], "radius": 1e-4}}, "has no edge between its nodes"),
        ({"box": {"min": [-0.04, -0.02, 0.0149], "max": [-0.029, 0.02, 0.0151]}}, "nodes that are fixed"),
    ],
)
def test_a_region_that_is_no_line_is_refused(box: Mesh, region: dict[str, Any], told: str) -> None:
    with pytest.raises(SceneError, match=told):
        build_scene(study(**LINE, regions=BASE["regions"] | {"edge": region}), box)


TRACTION: dict[str, Any] = {
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        {"kind": "traction", "region": "end", "resultant": PULL.tolist()},
    ],
}


def test_a_traction_is_even_over_its_facets(box: Mesh) -> None:
    scene = build_scene(study(**TRACTION), box)
    ((facets, force),) = scene.dead
    assert_allclose(box.surface_points[facets][..., 0], 0.03, atol=1e-12)
    nodal = scene.load(2.0).dead_force
    assert_allclose(nodal.sum(axis=0), 2 * PULL, rtol=1e-12)
    # its moment is that of the resultant at the middle of the face
    assert_allclose((box.surface_points[:, 1:, None] * nodal[:, None]).sum(axis=0), 0.0, atol=1e-15)
    corners = box.surface_points[facets]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    by_hand = np.zeros_like(nodal)
    np.add.at(by_hand, facets, (areas / 3 * 2 / 0.03**2)[:, None, None] * force)
    assert_allclose(nodal, by_hand, atol=1e-15)
    finer = level_scene(study(**TRACTION), refined(box, 1))
    assert_allclose(finer.load(1.0).dead_force.sum(axis=0), PULL, rtol=1e-12)


@pytest.fixture(scope="module")
def firsts() -> dict[tuple[str, bool], ModelResult]:
    """What models say with their first solvers under a line or a traction."""
    return {}


@pytest.mark.parametrize("tables", [LINE, TRACTION], ids=["line", "traction"])
@pytest.mark.parametrize("name", telling_params())
def test_every_model_balances_a_dead_force_or_refuses_it_by_name(
    box: Mesh, firsts: dict[tuple[str, bool], ModelResult], name: str, tables: dict[str, Any]
) -> None:
    model, solver = models.find(name)
    result = models.run_model(build_scene(study(**tables), box), name)
    if solver not in model.takes.get("dead forces", ()):
        assert result.status[0].code == models.REFUSED
        assert name in result.status[0].message
        return
    assert result.status[0].ok, result.status
    # a support answers with the opposite force; what rounding of an iterative solver leaves is 1e-6 of it
    assert_allclose(result.reaction_force[0].sum(axis=0), -PULL, atol=1e-5 * np.linalg.norm(PULL))
    key = model.name, tables is LINE
    if key not in firsts:
        firsts[key] = models.run_model(build_scene(study(**tables), box), model.name)
    first = firsts[key]
    rows = build_scene(study(**tables), box).dead[0][0].ravel()
    tip, first_tip = (r.displacement[0, rows].mean(axis=0) for r in (result, first))
    # the tip moves by less than a hundredth of the length: the nonlinear answers are linear to about as much
    tolerance = 0.03 if not is_linear(name) or not is_linear(model.name) else 1e-3
    assert_allclose(tip, first_tip, atol=tolerance * np.linalg.norm(first_tip))
    assert tip @ PULL > 0


def test_what_acts_is_asked_of_a_model_whatever_a_kind_declares(
    box: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A model that takes none would ignore it."""
    monkeypatch.setattr(KINDS["line"], "extra", "")
    assert build_scene(study(**LINE), box).extras == {"dead forces"}
