"""Each metric: a case computed by hand, zero, and a known perturbation."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.bodies import shaped
from tests.vdm.vdm_shapes import halved, octahedron
from vdmbench.body import surface_measures
from vdmbench.body.geometry import build_mesh
from vdmbench.body.nearest import distances_and_farthest, nearest_on_surface
from vdmbench.body.surface_measures import Surface
from vdmbench.measures import metrics
from vdmbench.measures.metrics import METRICS, History, evaluate, evaluate_all
from vdmbench.scene.scene import build_scene
from vdmbench.study.schema import Study

# round-off of sums over a few hundred terms of order one
ROUND = {"rtol": 1e-12, "atol": 1e-14}


def history(
    *steps: np.ndarray, reaction: np.ndarray | None = None, factors: list[float] | None = None
) -> History:
    u = np.array(steps)
    return History(
        u, np.zeros_like(u) if reaction is None else reaction, np.array(factors or [1.0] * len(steps))
    )


@pytest.fixture
def surface() -> Surface:
    points, triangles = octahedron()
    return Surface(points, triangles, contact=points[:, 2] > 0.5)


@pytest.fixture
def field() -> np.ndarray:
    return np.random.default_rng(7).normal(size=(6, 3))


@pytest.mark.parametrize("first", range(3))  # of a facet's corners
def test_surface_measures_of_the_octahedron(surface: Surface, first: int) -> None:
    surface = Surface(surface.points, np.roll(surface.triangles, first, axis=1))
    assert_allclose(surface.volume, 4 / 3, **ROUND)
    assert_allclose(surface.areas, np.full(6, 4 * np.sqrt(3) / 6), **ROUND)
    # each node's gradient: four facets of vector area (+-1, +-1, +-1)/2, a third each
    assert_allclose(surface.volume_gradient, surface.points * 2 / 3, **ROUND)
    assert_allclose(surface.normals, surface.points, **ROUND)


def test_the_smallest_extent_turns_with_the_body(surface: Surface) -> None:
    """Of a slab its thickness, of an octahedron the distance of opposite facets, whichever way they lie."""
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    slab = build_mesh(shaped("box", 0.015, {"size": (0.1, 0.08, 0.04)}))
    flat = surface.points * [0.03, 0.02, 0.01]
    ellipsoid = build_mesh(shaped("ellipsoid", 0.008, {"semi_axes": (0.06, 0.04, 0.02)}))
    for points, triangles, extent, near in (
        (slab.surface_points, slab.triangles, 0.04, 1e-12),
        (surface.points, surface.triangles, 2 / np.sqrt(3), 1e-12),
        (flat, surface.triangles, 2 / np.linalg.norm([1 / 0.03, 1 / 0.02, 1 / 0.01]), 1e-12),
        (ellipsoid.surface_points, ellipsoid.triangles, 0.04, 0.02),
    ):
        for posed in (points, points @ turn + 5.0):
            assert_allclose(Surface(posed, triangles).smallest_extent, extent, rtol=near, atol=0)


def test_contact_work_by_hand(surface: Surface, field: np.ndarray) -> None:
    force = np.zeros((6, 3))
    force[surface.contact] = [0.0, 1.0, -2.0]
    loaded = dataclasses.replace(surface, contact_force=force)
    moved = np.zeros((6, 3))
    moved[surface.contact] = [5.0, 0.25, -0.5]
    # the force of each step is its load factor times that at load factor 1
    model = history(moved, field, factors=[0.5, -2.0])
    expected = [0.5 * (0.25 + 1.0), -2.0 * float(force[surface.contact][0] @ field[surface.contact][0])]
    assert_allclose(metrics.contact_work(loaded, model), expected, **ROUND)
    assert np.isnan(metrics.contact_work(surface, model)).all()
    assert "contact_work" not in metrics.evaluate(Surface(surface.points, surface.triangles), model, None)


def turned(surface: Surface, axis: list[float]) -> np.ndarray:
    """(N, 3) displacement of a turn about an axis through the origin, by its length in radians, and of a shift."""
    turn = Rotation.from_rotvec(axis).as_matrix()
    return surface.points @ (turn - np.eye(3)).T + [0.3, -0.2, 0.5]


@pytest.mark.parametrize("axis", [[0.1, 0.2, -0.3], [2.0, 0.0, 1.0], [0.0, -3.0, 0.0]])
def test_a_rigid_motion_is_no_deformation_whatever_its_angle(
    surface: Surface, field: np.ndarray, axis: list[float]
) -> None:
    rigid = turned(surface, axis)
    found = surface_measures.deformations(surface.points, rigid[None], surface.areas)
    assert_allclose(found, 0.0, atol=1e-14, rtol=0)
    # a deformed body that then turns has the deformation that it had
    turn = Rotation.from_rotvec(axis).as_matrix()
    both = field @ turn.T + rigid
    values = evaluate(surface, history(both), history(field))
    assert_allclose(values["relative_l2_deformation_error"], 0.0, atol=1e-13, rtol=0)
    assert values["relative_l2_displacement_error"][0] > 0.1
    assert_allclose(evaluate(surface, history(rigid), None)["rigid_share"], 1.0, rtol=1e-12, atol=0)


def test_a_part_that_the_reference_has_not_is_no_measure(surface: Surface, field: np.ndarray) -> None:
    """What is left of it is what its solver leaves open: no whole to measure an error by."""
    rest, turn = 1e-9 * field, turned(surface, [0.0, 0.0, 1.0])
    along, normal = np.cross([0.0, 0.0, 1.0], surface.points), surface.normals
    forces = np.where(surface.contact[:, None], 1.0, -0.2) * [0.0, 0.0, 1.0]  # in balance but for rounding
    reactions = [forces + 1e-12 * field, forces - 2e-12 * field]
    for reference, part in ((turn, "deformation"), (along, "normal"), (normal, "tangential")):
        values = evaluate(surface, history(reference - rest), history(reference + rest))
        assert np.isnan(values[f"relative_l2_{part}_error"]).all(), part
        assert 0 < values["relative_l2_displacement_error"][0] < 1e-7
    model, reference = (history(field, reaction=reaction[None]) for reaction in reactions)
    assert np.isnan(evaluate(surface, model, reference)["reaction_force_error"]).all()


@pytest.mark.parametrize("sags", [False, True])
def test_a_body_without_load_has_nothing_to_measure_by(
    surface: Surface, field: np.ndarray, *, sags: bool
) -> None:
    body = dataclasses.replace(surface, sags=sags, contact_force=np.where(surface.contact[:, None], field, 0))
    factors, reaction = [1.0, 1e-17, 0.0, 1e-6], np.stack([field] * 4)
    steps = [
        history(field, a * field, a * field, field, reaction=reaction, factors=factors) for a in (1e-9, 2e-9)
    ]
    values = evaluate(body, *steps)
    for name, metric in METRICS.items():
        relative = ("volume_drift_of_displaced", "relative_l2_deformation_error", "rigid_share")
        if metric.degree == 0 or name in relative:
            rests = [False, not sags, not sags, False]
            if name != "indentation_force_error":
                assert np.isnan(values[name]).tolist() == rests, name


@pytest.mark.parametrize(("moved", "nothing"), [(1e-15, True), (1e-9, False)])
def test_where_a_load_moves_nothing_no_error_is_taken_of_rounding(
    surface: Surface, field: np.ndarray, moved: float, *, nothing: bool
) -> None:
    """A uniform pressure in a cavity that is full: models were called 100 % off, and not good enough."""
    values = evaluate(surface, history(moved * field[::-1]), history(moved * field))
    for name in ("relative_l2_displacement_error", "relative_l2_deformation_error", "rigid_share"):
        assert np.isnan(values[name]).tolist() == [nothing], name


def test_sliding_is_blind_to_shape_and_inflation_is_not(surface: Surface) -> None:
    still = history(np.zeros((6, 3)))
    # the octahedron grown by 10 %: a node of the larger one stands 0.1/sqrt(3) off the planes... but the nearest
    # point of the smaller one is its own corner, 0.1 away; a node of the smaller lies 0.1/sqrt(3) inside
    grown = evaluate(surface, history(0.1 * surface.points), still)
    assert_allclose(grown["hausdorff_distance"], 0.1, **ROUND)
    assert_allclose(grown["mean_surface_distance"], 0.1, **ROUND)
    shrunk = evaluate(surface, history(-0.1 * surface.points), still)
    assert_allclose(shrunk["mean_surface_distance"], 0.1 / np.sqrt(3), **ROUND)
    assert_allclose(shrunk["hausdorff_distance"], 0.1, **ROUND)
    # a quarter turn about z maps the octahedron to itself
    turned = np.column_stack([-surface.points[:, 1], surface.points[:, 0], surface.points[:, 2]])
    slid = evaluate(surface, history(turned - surface.points), still)
    assert_allclose(slid["hausdorff_distance"], 0.0, atol=1e-14, rtol=0)


def test_volume_drift_of_a_uniform_scaling(surface: Surface) -> None:
    values = evaluate(surface, history(0.1 * surface.points, -0.1 * surface.points), None)
    assert_allclose(values["volume_drift"], [1.1**3 - 1, 0.9**3 - 1], **ROUND)
    # displaced volume: half of sum |g.u| = 6 nodes * 2/3 * 0.1 / 2
    assert_allclose(
        values["volume_drift_of_displaced"], np.array([1.1**3 - 1, 0.9**3 - 1]) * (4 / 3) / 0.2, **ROUND
    )
    for axis in "xyz":
        assert_allclose(values[f"mean_strain_{axis}"], [0.1, -0.1], **ROUND)
    assert "contact_work" in values
    assert len(values) == 8, "the others need a reference"


def test_indentation_is_the_work_of_the_contact_over_its_force(surface: Surface, field: np.ndarray) -> None:
    force = np.zeros((6, 3))
    force[4], force[0] = [0.0, 0.0, -3.0], [-1.0, 0.0, 0.0]
    loaded = dataclasses.replace(surface, contact_force=force)
    pushed = np.zeros((6, 3))
    pushed[4], pushed[0], pushed[2] = [9.0, 9.0, -0.02], [-0.06, 9.0, 9.0], [9.0, 9.0, 9.0]
    found = metrics.mean_indentation(loaded, np.stack([pushed, field]))
    assert_allclose(found, [0.03, -(3.0 * field[4, 2] + field[0, 0]) / 4.0], **ROUND)
    assert np.isnan(metrics.mean_indentation(surface, field[None])).all()


@pytest.mark.parametrize(
    "factors",
    [[0.25, 0.5, 1.0], [0.5, 0.0, 1.0], [0.3, 0.6, 1.0, 0.6, 0.1 + 0.2], [0.5, -0.5, 1.0], [-1.0]],
)
def test_indentation_force_of_a_model_twice_as_soft_and_of_one_twice_as_stiff(
    surface: Surface, factors: list[float]
) -> None:
    """By hand, also over a pause, a way back and a pull; beyond the last step the curve goes on straight."""
    push = np.zeros((6, 3))
    push[4, 2] = -0.01
    loaded = dataclasses.replace(surface, contact_force=20.0 * push)
    reference, soft, stiff = (
        history(*[size * factor * push for factor in factors], factors=factors) for size in (1.0, 2.0, 0.5)
    )
    for model, error in ((soft, -0.5), (stiff, 1.0)):
        expected = [error if factor else np.nan for factor in factors]
        assert_allclose(evaluate(loaded, model, reference)["indentation_force_error"], expected, **ROUND)


@pytest.mark.parametrize("factors", [[0.5, 1.0], [0.5, 0.0, 1.0], [-1.0, 0.0, 2.0]])
def test_indentation_force_of_a_body_with_a_weight(surface: Surface, factors: list[float]) -> None:
    """By hand: it sags by 0.5 without load, and needs f for a depth of 0.5 + f where the model has 0.3 + 2 f."""
    push = np.zeros((6, 3))
    push[4, 2] = -0.01
    loaded = dataclasses.replace(surface, contact_force=20.0 * push, sags=True)
    reference, soft = (
        history(*[(sag + size * factor) * push for factor in factors], factors=factors)
        for sag, size in ((0.5, 1.0), (0.3, 2.0))
    )
    known = 0.0 in factors
    expected = [(0.2 + factor) / 2 / factor - 1 if known and factor else np.nan for factor in factors]
    assert_allclose(evaluate(loaded, soft, reference)["indentation_force_error"], expected, **ROUND)


@pytest.mark.parametrize(("gravity", "environment"), [(-9.81, 0.0), (0.0, 5000.0), (-9.81, 5000.0)])
def test_of_the_constant_loads_only_a_weight_moves_a_body(gravity: float, environment: float) -> None:
    study = Study.model_validate(
        {
            "study": {"name": "test", "models": ["vdm-vector"]},
            "geometry": {"shape": "box", "size": (0.08, 0.08, 0.04), "mesh_size": 0.02},
            "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.45},
            "regions": {"bottom": {"below": {"axis": "z", "fraction": 0.01}}},
            "constraints": [{"kind": "fixed", "region": "bottom"}],
            "gravity": {"acceleration": (0.0, 0.0, gravity)},
            "environment": {"pressure": environment},
        }
    )
    scene = build_scene(study, build_mesh(study.geometry, volume=False))
    assert scene.surface.sags == (gravity != 0.0)


def test_mean_strain_is_that_of_the_body(surface: Surface) -> None:
    """Of a linear field the gradient itself; one node moved gives g_i u_i / V."""
    gradient = np.array([[0.02, 0.3, -0.1], [0.5, -0.01, 0.2], [-0.4, 0.1, 0.07]])
    moved = np.zeros((6, 3))
    moved[0] = (0.4, 0.3, 0.2)  # the node at x = 1, whose g is (2/3, 0, 0), in a volume of 4/3
    steps = history(surface.points @ gradient.T + 5.0, moved, np.zeros((6, 3)))
    for axis, (name, by_hand) in enumerate((("x", 0.2), ("y", 0.0), ("z", 0.0))):
        found = metrics.METRICS[f"mean_strain_{name}"].function(surface, steps)
        assert_allclose(found, [gradient[axis, axis], by_hand, 0.0], **ROUND)


@pytest.mark.parametrize("share", [1e-6, 0.3, 7.0])
def test_metrics_grow_with_their_degree(share: float) -> None:
    surface, models = bumpy(5)
    factors = np.array([0.2, 0.5, 1.0])
    push = factors[:, None, None] * -surface.normals
    first = {
        name: History(push + 0.1 * model.displacement[0], model.reaction_force, factors)
        for name, model in zip("abr", models, strict=True)
    }
    more = {
        name: dataclasses.replace(
            m, displacement=share * m.displacement, reaction_force=share * m.reaction_force
        )
        for name, m in first.items()
    }
    loaded = dataclasses.replace(
        surface, contact_force=np.where(surface.contact[:, None], -surface.normals, 0.0)
    )
    found = evaluate_all(loaded, first, "r")
    grown = evaluate_all(dataclasses.replace(loaded, contact_force=share * loaded.contact_force), more, "r")
    seen = set()
    for name, metric in METRICS.items():
        for model, values in found.items():
            if name in values and metric.degree is not None and np.isfinite(values[name]).any():
                assert_allclose(
                    grown[model][name], share**metric.degree * values[name], err_msg=name, **ROUND
                )
                seen.add(name)
    assert seen == {name for name, metric in METRICS.items() if metric.degree is not None}


def bumpy(seed: int) -> tuple[Surface, list[History]]:
    """A sphere with bumps, in contact, and the histories of three models; one has a step that failed."""
    rng = np.random.default_rng(seed)
    points, triangles = octahedron()
    for _ in range(3):
        points, triangles = halved(points, triangles)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= 1 + 0.1 * rng.normal(size=(len(points), 1))
    force = rng.normal(size=points.shape)
    surface = Surface(points, triangles, points[:, 2] > 0.4, force)
    factors = np.array([0.2, -1.0, 0.7])
    models = [
        History(0.1 * rng.normal(size=(3, *points.shape)), rng.normal(size=(3, *points.shape)), factors)
        for _ in range(3)
    ]
    models[1].displacement[2, 4] = np.nan
    return surface, models


def test_all_steps_and_models_at_once_are_each_alone() -> None:
    """A shortcut changes no number: not the steps together, nor the models, nor measures kept of the surface."""
    surface, models = bumpy(5)
    kept = Surface(surface.points, surface.triangles, surface.contact, surface.contact_force)
    found = evaluate_all(kept, {"a": models[0], "b": models[1], "reference": models[2]}, "reference")
    for name, model in zip(("a", "b"), models, strict=False):
        for step in range(3):
            fresh = Surface(surface.points, surface.triangles, surface.contact, surface.contact_force)
            u, r = (
                History(h.displacement[[step]], h.reaction_force[[step]], h.load_factors[[step]])
                for h in (model, models[2])
            )
            alone = evaluate(fresh, u, r)
            assert alone.keys() == found[name].keys()
            for metric, values in alone.items():
                together = found[name][metric][step]
                if metric in ("mean_surface_distance", "hausdorff_distance") and step != 1:
                    assert np.isnan(together), metric
                elif metric != "indentation_force_error":  # which is read off the whole history
                    assert_allclose(together, values[0], err_msg=metric, **ROUND)
    assert np.isnan(found["b"]["relative_l2_displacement_error"]).tolist() == [False, False, True]
    assert "relative_l2_displacement_error" not in found["reference"]
    assert_allclose(found["reference"]["volume_drift"], metrics.volume_drift(surface, models[2]), **ROUND)


@pytest.mark.parametrize("size", [0.01, 0.3, 3.0])
def test_distances_of_two_surfaces_are_those_to_all_facets(size: float) -> None:
    """Also the largest one, for which most nodes of the way back are left out."""
    surface, models = bumpy(9)
    shifts = size * np.stack([models[0].displacement[0], models[2].displacement[0]])
    shifts[1, :, 0] += 0.3  # one surface beside the other
    other = surface.points + size * models[2].displacement[1]
    for shift in shifts:
        assert_distances(surface, surface.points + shift, other)
    spike = surface.points.copy()
    spike[surface.points[:, 2].argmax()] *= 2.0  # only the way back from its tip sees how long it is
    there, farthest = distances_and_farthest(surface.points, spike, surface.triangles)
    back = nearest_on_surface(spike, surface.points, surface.triangles)[0]
    assert farthest == back.max() > there.max()


def assert_distances(surface: Surface, points: np.ndarray, other: np.ndarray) -> None:
    """Against the distances to each facet. Both round at the size of a facet, 0.1 to 1, and of the coordinates."""
    there, farthest = distances_and_farthest(points, other, surface.triangles)
    rounding = 1e-15 * (1.0 + np.abs(other).max())
    one, back = (to_facets(*pair, surface.triangles) for pair in ((points, other), (other, points)))
    assert_allclose(there, one, rtol=1e-12, atol=rounding)
    assert_allclose(farthest, max(one.max(), back.max()), rtol=1e-12, atol=rounding)


def to_facets(queries: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(Q,) least distance to any facet: to its plane where the foot is inside, else to one of its edges."""
    corners, ends = points[triangles], points[np.roll(triangles, -1, axis=1)]
    edges = ends - corners
    normals = np.cross(edges[:, 0], edges[:, 1])
    sizes = np.linalg.norm(normals, axis=1)
    normals = normals / np.where(sizes, sizes, 1.0)[:, None]
    away = queries[:, None, None] - corners  # (Q, F, 3, 3)
    inside = (np.einsum("fki,qfki->qfk", np.cross(normals[:, None], edges), away) >= 0.0).all(axis=2) & (
        sizes > 0.0
    )
    to_planes = np.where(inside, np.abs(np.einsum("fi,qfi->qf", normals, away[:, :, 0])), np.inf)
    lengths = np.maximum(np.einsum("fki,fki->fk", edges, edges), 1e-300)
    along = np.clip(np.einsum("qfki,fki->qfk", away, edges) / lengths, 0.0, 1.0)
    to_edges = np.linalg.norm(away - along[..., None] * edges, axis=3).min(axis=2)
    return np.minimum(to_planes, to_edges).min(axis=1)
