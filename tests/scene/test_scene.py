"""A study's scene on real meshes: regions, the same load for every model, wherever the body lies."""

from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from solver_common.quadrature import facet_quadrature
from tests.bodies import shaped
from tests.work.shared_work import TABLES, plan_of, run
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import refine
from vdmbench.body.surface_measures import Surface, facet_area_vectors, nodal_sum
from vdmbench.report.export import surface_fields
from vdmbench.scene.regions import SceneError, select
from vdmbench.scene.scene import Scene, build_scene
from vdmbench.study.errors import Loc
from vdmbench.study.schema import Region, Study
from vdmbench.work.keys import wanted

BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-paper", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.015},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": 0.6}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "pressure": 200.0},
    ],
}


def study(**tables: Any) -> Study:
    return Study.model_validate(BASE | tables)


@pytest.fixture(scope="module")
def sphere() -> Mesh:
    return build_mesh(study().geometry)


def contact(**keys: Any) -> list[dict[str, Any]]:
    return [{"kind": "fixed", "region": "base"}, {"kind": "contact", "region": "finger", **keys}]


def exact_resultant(scene: Scene) -> np.ndarray:
    """Minus the integral of p n over the facets, summed facet by facet."""
    _, weights = facet_quadrature()
    vectors = facet_area_vectors(scene.mesh.surface_points, scene.mesh.triangles)
    return -((scene.facet_pressure @ weights) @ vectors)


# --- regions ---


def nodes(mesh: Mesh, region: dict[str, Any]) -> np.ndarray:
    return select(Region.model_validate(region), mesh)


def test_half_spaces_by_value_and_fraction(sphere: Mesh) -> None:
    z = sphere.surface_points[:, 2]
    level = z.min() + 0.3 * np.ptp(z)
    assert (nodes(sphere, {"below": {"axis": "z", "value": 0.01}}) == (z <= 0.01)).all()
    assert (nodes(sphere, {"above": {"axis": "z", "value": 0.01}}) == (z >= 0.01)).all()
    assert (nodes(sphere, {"below": {"axis": "z", "fraction": 0.3}}) == (z <= level)).all()
    assert nodes(sphere, {"above": {"axis": "x", "fraction": 0.0}}).all()
    lowest = nodes(sphere, {"below": {"axis": "z", "fraction": 0.0}})
    assert lowest.sum() == (z == z.min()).sum(), "nodes on the border belong to the region"


def test_ball_box_and_cap(sphere: Mesh) -> None:
    points = sphere.surface_points
    centre = np.array([0.05, 0, 0])
    ball = nodes(sphere, {"ball": {"center": centre.tolist(), "radius": 0.03}})
    assert (ball == (np.linalg.norm(points - centre, axis=1) <= 0.03)).all()
    box = nodes(sphere, {"box": {"min": [-1, 0.01, -1], "max": [1, 1, 0.02]}})
    assert (box == ((points[:, 1] >= 0.01) & (points[:, 2] <= 0.02))).all()
    cap = nodes(sphere, {"cap": {"direction": [0, 0, 2], "angle": np.pi / 2}})
    # the body's centroid lies within 1e-5 m of the origin, nodes nearer to the plane may fall on either side
    clear = np.abs(points[:, 2]) > 1e-4
    assert (cap == (points[:, 2] > 0))[clear].all()


def test_all_keys_of_a_region_hold(sphere: Mesh) -> None:
    parts: dict[str, Any] = {
        "below": {"axis": "z", "fraction": 0.6},
        "above": {"axis": "x", "value": 0.0},
        "ball": {"center": [0.03, 0.0, 0.0], "radius": 0.045},
        "cap": {"direction": [0, 1, 0], "angle": 2.0},
        "box": {"min": [-1, -1, -0.02], "max": [1, 1, 1]},
    }
    alone = [nodes(sphere, {key: part}) for key, part in parts.items()]
    together = nodes(sphere, parts)
    assert (together == np.logical_and.reduce(alone)).all()
    assert 0 < together.sum() < min(mask.sum() for mask in alone)


def test_groups_come_from_the_mesh(sphere: Mesh) -> None:
    mask = np.arange(len(sphere.surface_nodes)) < 5
    marked = Mesh(
        sphere.points, sphere.tetrahedra, sphere.surface_nodes, sphere.triangles, {"ligament": mask}
    )
    assert (nodes(marked, {"group": "ligament"}) == mask).all()
    third = float(sphere.surface_points[2, 0])
    both = nodes(marked, {"group": "ligament", "above": {"axis": "x", "value": third}})
    assert (both == mask & (sphere.surface_points[:, 0] >= third)).all()
    assert both.sum() < 5
    with pytest.raises(SceneError, match="no group 'hook'; it has: ligament"):
        nodes(marked, {"group": "hook"})


# --- the load is the same for every model; what each does with it: test_springs_and_forces ---


LOADS = [
    contact(pressure=200.0),
    contact(pressure=200.0, profile="hertz"),
    contact(force=0.3, profile="gaussian"),
    contact(force=0.3),
    contact(force=0.3, profile="hertz"),
]


@pytest.mark.parametrize("constraints", LOADS, ids=lambda c: "-".join(map(str, c[1].values())))
def test_nodes_and_facets_get_the_same_resultant(sphere: Mesh, constraints: list[dict[str, Any]]) -> None:
    scene = build_scene(study(constraints=constraints), sphere)
    exact = exact_resultant(scene)
    assert np.linalg.norm(exact) > 0.05
    assert exact[2] < 0, "a finger on top pushes down"
    assert constraints[1].get("force") in (None, pytest.approx(np.linalg.norm(exact), rel=1e-12))
    # nodal forces; the nodal pressures have the same thrust
    assert_allclose(scene.contact_force.sum(axis=0), exact, rtol=1e-12, atol=1e-15)
    _, weights = facet_quadrature()
    areas = np.linalg.norm(facet_area_vectors(sphere.surface_points, sphere.triangles), axis=1)
    nodal_areas = nodal_sum(areas, sphere.triangles, len(scene.fixed))
    thrust = areas @ (scene.facet_pressure @ weights)
    assert_allclose(nodal_areas @ scene.contact_pressure, thrust, rtol=1e-12, atol=0)


def test_a_contact_all_around_has_no_resultant_to_be_given(sphere: Mesh) -> None:
    closed = {**BASE["regions"], "finger": {"cap": {"direction": [0, 0, 1], "angle": np.pi}}}
    with pytest.raises(SceneError, match="no resultant to be given by force; give pressure"):
        build_scene(study(regions=closed, constraints=contact(force=0.1)[1:]), sphere)
    pressed = build_scene(study(regions=closed, constraints=contact(pressure=200.0)[1:]), sphere)
    assert_allclose(pressed.facet_pressure, 200.0, rtol=1e-12, atol=0)
    assert_allclose(exact_resultant(pressed), 0.0, rtol=0, atol=1e-12 * 200.0 * 4 * np.pi * 0.05**2)


def test_uniform_pressure_acts_on_whole_facets_only(sphere: Mesh) -> None:
    scene = build_scene(study(), sphere)
    inside = scene.regions["finger"][sphere.triangles].all(axis=1)
    assert 0 < inside.sum() < len(inside)
    assert (scene.facet_pressure == np.where(inside, 200.0, 0.0)[:, None]).all()


@pytest.mark.parametrize(
    ("profile", "mean"),
    # means over the disc rho < 1 of sqrt(1 - rho^2), and of exp(-9/2 rho^2)
    [("hertz", 2 / 3), ("gaussian", (1 - np.exp(-4.5)) / 4.5)],
)
def test_smooth_profiles_have_their_exact_resultant(profile: str, mean: float) -> None:
    """On the flat top of a box a ball region is a disc: the resultant is known, and does not depend on the mesh."""
    geometry = {"shape": "box", "size": [0.1, 0.1, 0.04], "mesh_size": 0.008}
    regions = {
        "base": {"below": {"axis": "z", "value": -0.02}},
        "finger": {"ball": {"center": [0, 0, 0.02], "radius": 0.03}},
    }
    scene_study = study(
        geometry=geometry, regions=regions, constraints=contact(pressure=100.0, profile=profile)
    )
    for mesh_size in (0.008, 0.005):
        mesh = build_mesh(study(geometry=geometry | {"mesh_size": mesh_size}).geometry)
        scene = build_scene(scene_study, mesh)
        assert_allclose(
            -scene.contact_force.sum(axis=0)[2], 100.0 * mean * np.pi * 0.03**2, rtol=1e-6, atol=0
        )
        assert_allclose(scene.contact_force.sum(axis=0)[:2], 0.0, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("profile", "angle"), [("hertz", 0.6), ("gaussian", 0.12)]
)  # many facets; less than two
def test_a_profile_has_one_resultant_on_every_mesh_level(profile: str, angle: float) -> None:
    """Force, and moment with linear and quadratic shape functions: what models get is the same on each level."""
    regions = BASE["regions"] | {"finger": {"cap": {"direction": [0.3, 0.0, 1.0], "angle": angle}}}
    pressed = study(regions=regions, constraints=contact(pressure=200.0, profile=profile))
    barycentric, weights = facet_quadrature()
    forces, squares = [], []
    mesh = build_mesh(pressed.geometry, volume=False)
    for _ in range(3):
        scene = build_scene(pressed, mesh)
        assert (scene.contact_pressure >= 0.0).all()
        points = np.einsum("qk,fki->fqi", barycentric, mesh.surface_points[mesh.triangles])
        vectors = facet_area_vectors(mesh.surface_points, mesh.triangles)
        loads = (scene.facet_pressure * weights)[:, :, None] * vectors[:, None, :]
        forces.append(loads.sum(axis=(0, 1)))
        squares.append(np.einsum("fqi,fqj,fqj->i", loads, points, points))
        mesh, _ = refine(mesh)
    for found in (forces, squares):
        size = np.linalg.norm(found[-1])
        assert_allclose(found[0], found[-1], rtol=0.0, atol=1e-6 * size)
        assert_allclose(found[1], found[-1], rtol=0.0, atol=1e-6 * size)


# --- constraints ---


def test_constrained_nodes_move_as_told(sphere: Mesh) -> None:
    tool = {"kind": "constrained", "region": "finger", "displacement": [0.0, 0.001, -0.002]}
    scene = build_scene(
        study(constraints=[BASE["constraints"][0], tool], load={"factors": [0.5, 1.0]}), sphere
    )
    assert (scene.constrained == scene.regions["finger"]).all()
    assert (scene.held == (scene.regions["finger"] | scene.regions["base"])).all()
    result = models.run_model(scene, "fem-linear")
    moved = result.displacement[:, scene.constrained]
    assert_allclose(moved[1], np.broadcast_to([0.0, 0.001, -0.002], moved[1].shape), rtol=1e-12, atol=1e-18)
    assert_allclose(moved[0], 0.5 * moved[1], rtol=1e-12, atol=1e-18)
    assert_allclose(result.displacement[:, scene.fixed], 0.0, atol=0, rtol=0)
    paper = models.run_model(scene, "vdm-paper")
    normal = np.einsum(
        "sij,ij->si", paper.displacement[:, scene.constrained], _normals(scene)[scene.constrained]
    )
    wanted = _normals(scene)[scene.constrained] @ [0.0, 0.001, -0.002]
    assert_allclose(normal[1], wanted, rtol=1e-9, atol=1e-15)


def _normals(scene: Scene) -> np.ndarray:
    return Surface(scene.mesh.surface_points, scene.mesh.triangles).normals


@pytest.mark.parametrize("model", ["vdm-paper", "fem-linear"])
def test_gravity_is_constant_and_linear_models_scale(sphere: Mesh, model: str) -> None:
    weight = {"acceleration": [0.0, 0.0, -9.81]}
    loaded = build_scene(study(gravity=weight, load={"factors": [0.0, 1.0, 2.0]}), sphere)
    without = build_scene(study(load={"factors": [1.0]}), sphere)
    u, v = models.run_model(loaded, model).displacement, models.run_model(without, model).displacement[0]
    size = np.abs(u).max()
    assert np.abs(u[0]).max() > 1e-6, "the body sags under its own weight"
    assert_allclose(u[1] - u[0], v, rtol=0, atol=1e-9 * size)
    assert_allclose(u[2] - u[0], 2 * v, rtol=0, atol=1e-9 * size)


def test_environment_pressure_moves_the_datum_only(sphere: Mesh) -> None:
    bare, deep = (build_scene(study(environment={"pressure": p}), sphere) for p in (0.0, 101325.0))
    a, b = (models.run_model(scene, "vdm-paper") for scene in (bare, deep))
    assert_allclose(a.displacement, b.displacement, rtol=0, atol=0)
    assert_allclose(b.fluid_pressure - a.fluid_pressure, 101325.0, rtol=1e-12, atol=0)


FIXED = BASE["constraints"][0]
TOOL = {"kind": "constrained", "region": "base", "displacement": [0, 0, 0.001]}
ON_BASE = {"kind": "contact", "region": "base", "name": "on", "pressure": 1.0}
FINGER = ("regions", "finger")


def finger(**region: Any) -> dict[str, Any]:
    return {"regions": BASE["regions"] | {"finger": region}}


@pytest.mark.parametrize(
    ("tables", "message", "place"),
    [
        (
            finger(above={"axis": "z", "value": 0.06}),
            r"selects no node of the mesh; enlarge it or take a smaller mesh_size; the body has x from -0.05 to "
            r"0.0495, y from -0.0497 to 0.05, z from -0.05 to 0.05 m; a mixed-up unit\? A bare number is in metres",
            FINGER,
        ),
        (finger(below={"axis": "x", "value": -19.0}), "no node", FINGER),
        (finger(box={"min": [-0.01] * 3, "max": [0.01] * 3}), "no node", FINGER),
        (finger(cap={"direction": [0, 0, 1], "angle": 0.02}), "no node|no facet", None),
        (finger(above={"axis": "z", "fraction": 0.1}), "fixed or constrained", ("constraints", 1)),
        (
            {"constraints": [TOOL | {"name": "tool"}, FIXED]},
            "'tool' moves .* nodes that are fixed; keep the regions apart",
            ("constraints", 0),
        ),
        (
            {"constraints": [TOOL, TOOL | {"name": "b", "displacement": [0, 0, 2e-3]}, TOOL | {"name": "c"}]},
            "differently",
            ("constraints", 1),
        ),
        ({"constraints": [FIXED, ON_BASE, FIXED | {"name": "on"}]}, "fixed", ("constraints", 1)),
    ],
)
def test_a_scene_that_makes_no_sense_is_told_with_its_place(
    sphere: Mesh, tables: dict[str, Any], message: str, place: Loc | None
) -> None:
    """Words alone would lead elsewhere: other constraints have the same region or name."""
    with pytest.raises(SceneError, match=message) as caught:
        build_scene(study(**tables), sphere)
    assert place in (None, caught.value.place)


# --- what is set up once, and what is answered once ---

CLAMP, PUSH = BASE["constraints"]
BED = {"kind": "elastic", "region": "base", "stiffness": 2e5}
TOUCH = {"kind": "indenter", "region": "finger", "shape": "sphere", "radius": 0.1, "depth": 0.002}
LINE = {"kind": "line", "region": "finger", "resultant": [1e-3, 2e-3, -5e-3]}
LUMP = {"name": "lump", "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.02}, "youngs_modulus": 5e4}
ALONE = BASE["study"] | {"homogeneous": ["vdm-paper"]}
FUNG = BASE["tissue"] | {"law": "fung", "exponent": 4.0}


def acting(*parts: dict[str, Any]) -> dict[str, Any]:
    return {"constraints": [CLAMP, *parts]}


@pytest.mark.parametrize(
    ("model", "bodies", "n_answers", "variants"),
    [
        (
            "fem-linear",
            1,
            2,
            [acting(BED, PUSH), acting(BED, PUSH | {"pressure": 400.0, "profile": "hertz"})],
        ),
        ("fem-linear", 2, 2, [acting(BED, PUSH), acting(BED | {"stiffness": 3e5}, PUSH)]),
        ("fem-linear", 2, 2, [acting(BED, PUSH), acting(BED | {"direction": "full"}, PUSH)]),
        ("fem-linear", 2, 2, [acting(BED, PUSH), {}]),
        (
            "fem-linear",
            1,
            3,
            [acting(TOUCH), acting(TOUCH | {"depth": 3e-3}), acting(TOUCH | {"radius": 0.3})],
        ),
        ("fem-linear", 1, 2, [acting(TOUCH), acting(TOUCH) | {"load": {"factors": [0.5, 1.0]}}]),
        ("fem-linear", 1, 1, [acting(LINE), acting(LINE | {"resultant": [2e-3, 4e-3, -1e-2]})]),
        ("fem-linear", 1, 2, [acting(LINE), acting(LINE | {"resultant": [0.0, 0.0, 1e-3]})]),
        ("fem-linear", 2, 2, [{}, {"inclusions": [LUMP]}]),
        ("fem-linear", 2, 2, [{"inclusions": [LUMP]}, {"inclusions": [LUMP | {"youngs_modulus": 2e3}]}]),
        ("vdm-paper", 1, 1, [{}, {"study": ALONE, "inclusions": [LUMP]}]),
        ("vdm-paper", 2, 2, [{}, {"inclusions": [LUMP]}]),  # which it refuses
        ("vdm-paper", 1, 1, [{}, {"tissue": FUNG}]),  # a law of large strain
        ("fem", 3, 3, [{}, {"tissue": FUNG}, {"tissue": FUNG | {"exponent": 5.0}}]),
    ],
)
def test_bodies_and_answers_are_shared_by_studies_that_differ_in_nothing_they_need(
    model: str, bodies: int, n_answers: int, variants: list[dict[str, Any]]
) -> None:
    names = {"models": ("vdm-paper", "fem-linear", "fem")}
    of = [study(**{"study": BASE["study"], **tables}) for tables in variants]
    of = [one.model_copy(update={"study": one.study.model_copy(update=names)}) for one in of]
    found = [next(want for want in wanted(one, "mesh") if want.name == model) for one in of]
    assert len({want.body for want in found}) == bodies
    assert len({want.answers for want in found}) == n_answers


PLACE = np.array([-0.4, 0.3, 1.5])  # m, as in a scan of a whole body


def _regions(place: np.ndarray) -> dict[str, Any]:
    """Each kind of region, of a ball of 5 cm about a place."""
    low = np.subtract(place, (0.02, 0.02, 0.0))
    return {
        "below": {"below": {"axis": "z", "value": place[2] - 0.02}},
        "above": {"above": {"axis": "x", "fraction": 0.6}},
        "ball": {"ball": {"center": np.add(place, (0.0, 0.03, 0.03)).tolist(), "radius": 0.03}},
        "box": {"box": {"min": low.tolist(), "max": np.add(low, (0.04, 0.04, 0.06)).tolist()}},
        "cap": {"cap": {"direction": [1, 1, 1], "angle": 0.6}},
    }


@pytest.mark.usefixtures("read_here")
def test_no_answer_depends_on_the_place_of_the_body(tmp_path: Path) -> None:
    """The ball as a file in millimetres; as tetrahedra, which are not remeshed."""
    models = ["vdm-paper", "vdm-vector", "bem", "fem-linear"]
    study = {**TABLES["study"], "models": models, "reference": "fem-linear"}
    ball = build_mesh(shaped("sphere", 0.02, {"radius": 0.05}))
    middle = (ball.points.min(axis=0) + ball.points.max(axis=0)) / 2
    answers = []
    for place in (np.zeros(3), PLACE):
        where = tmp_path / f"{place[0]}"
        where.mkdir()
        scan = 1e3 * (ball.points - middle + place)
        meshio.write_points_cells(where / "scan.vtu", scan, [("tetra", ball.tetrahedra)])
        x, y, z = np.add(place, (0.003, 0.001, 0.05)).tolist()
        probe = {"x": x, "y": y, "z": z, "displacement_z": 0.0, "uncertainty": 1e-3}
        tables = {
            "geometry": {"shape": "file", "path": str(where / "scan.vtu"), "scale": 1e-3},
            "regions": _regions(place),
            "constraints": [
                {"kind": "fixed", "region": "below"},
                {"kind": "contact", "region": "ball", "force": 0.1, "profile": "hertz"},
            ],
            "measured": [{"name": "probe", "points": [probe]}],
        }
        answers.append(
            run(plan_of(where / "run", where / "cache", study=study, sweep={}, uncertainty=None, **tables))[0]
        )
    near, far = answers
    assert_allclose(far.points, near.points + PLACE, rtol=0, atol=1e-12)
    points, _ = surface_fields(far)  # as an export has them: in the unit of the scan
    assert_allclose(points.min(axis=0), scan.min(axis=0), rtol=1e-12, atol=0)
    assert_allclose(points.max(axis=0), scan.max(axis=0), rtol=1e-12, atol=0)
    for name, nodes in near.regions.items():
        assert 0 < nodes.sum() < len(nodes), name
        assert_array_equal(far.regions[name], nodes, err_msg=name)
    for model in models:
        moved = near.models[model].displacement
        assert_allclose(
            far.models[model].displacement, moved, rtol=0, atol=1e-7 * abs(moved).max(), err_msg=model
        )
    for model, simulated in near.measurement.simulated.items():
        assert_allclose(far.measurement.simulated[model], simulated, rtol=1e-6, atol=1e-9, err_msg=model)
