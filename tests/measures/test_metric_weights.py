"""The weights in the metrics: every one on a surface of uneven areas, by loops over its facets and nodes."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from vdmbench.body.nearest import nearest_on_surface
from vdmbench.body.surface_measures import Surface, rigid_motions
from vdmbench.measures.metrics import History, evaluate

from .test_metrics import ROUND, bumpy, history

Part = Callable[[np.ndarray], np.ndarray]


def thirds(surface: Surface) -> tuple[list[float], np.ndarray]:
    """Nodal areas and unit normals: a third of the area and of the area vector of each facet at the node."""
    areas, normals = [0.0] * len(surface.points), np.zeros_like(surface.points)
    for facet in surface.triangles:
        a, b, c = surface.points[facet]
        vector = np.cross(b - a, c - a) / 2
        for node in facet:
            areas[node] += math.hypot(*vector) / 3
            normals[node] += vector / 3
    return areas, np.array([vector / math.hypot(*vector) for vector in normals])


def relative(u: np.ndarray, r: np.ndarray, areas: list[float], nodes: np.ndarray) -> float:
    off = sum(areas[i] * float((u[i] - r[i]) @ (u[i] - r[i])) for i in nodes)
    return math.sqrt(off / sum(areas[i] * float(r[i] @ r[i]) for i in nodes))


def deformation(points: np.ndarray, areas: list[float]) -> Part:
    """What scipy's best rotation and the best shift, by weighted least squares, leave of a field."""

    def left(u: np.ndarray) -> np.ndarray:
        rest, moved = (v - np.average(v, axis=0, weights=areas) for v in (points, points + u))
        return np.asarray(Rotation.align_vectors(rest, moved, weights=areas)[0].apply(moved) - rest)

    return left


@pytest.fixture(scope="module")
def uneven() -> tuple[Surface, list[History]]:
    """A bumpy sphere whose half of x > 0 is drawn out, so that the areas and their centroid are one-sided."""
    surface, models = bumpy(5)
    points = surface.points * np.where(surface.points[:, :1] > 0, [3.0, 1.0, 1.0], 1.0)
    surface = Surface(points, surface.triangles, surface.contact, surface.contact_force)
    assert surface.areas.max() > 5 * surface.areas.min()
    return surface, [models[0], models[2]]


@pytest.mark.parametrize(
    "name", ["displacement", "deformation", "normal", "tangential", "contact_region", "far_field"]
)
def test_relative_errors_weigh_by_area(uneven: tuple[Surface, list[History]], name: str) -> None:
    surface, (model, reference) = uneven
    areas, normals = thirds(surface)
    along: Part = lambda v: np.array([(a @ n) * n for a, n in zip(v, normals, strict=True)])  # noqa: E731
    parts: dict[str, Part] = {
        "deformation": deformation(surface.points, areas),
        "normal": along,
        "tangential": lambda v: v - along(v),
    }
    part = parts.get(name, lambda v: v)
    regions = {"contact_region": surface.contact, "far_field": ~surface.contact}
    nodes = np.flatnonzero(regions.get(name, np.ones(len(areas), dtype=bool)))
    expected = [
        relative(part(u), part(r), areas, nodes)
        for u, r in zip(model.displacement, reference.displacement, strict=True)
    ]
    metric = f"{name}_error" if name in regions else f"relative_l2_{name}_error"
    assert_allclose(evaluate(surface, model, reference)[metric], expected, **ROUND)


def test_distances_and_quantiles_weigh_by_area(uneven: tuple[Surface, list[History]]) -> None:
    surface, (model, reference) = uneven
    areas, _ = thirds(surface)
    found = evaluate(surface, model, reference)
    u, r = (h.displacement[1] for h in (model, reference))  # of the largest load
    there = nearest_on_surface(surface.points + u, surface.points + r, surface.triangles)[0]
    mean = sum(a * d for a, d in zip(areas, there, strict=True)) / sum(areas)
    assert_allclose(found["mean_surface_distance"][1], mean, **ROUND)
    below, errors = 0.0, np.linalg.norm(u - r, axis=1)
    for node in np.argsort(errors):
        below += areas[node]
        if below >= 0.95 * sum(areas):
            break
    assert_allclose(found["p95_nodal_error"][1], errors[node], **ROUND)
    assert_allclose(found["max_nodal_error"][1], errors.max(), **ROUND)
    share = errors.max() / np.linalg.norm(r, axis=1).max()
    assert_allclose(found["max_nodal_error_relative"][1], share, **ROUND)


def test_a_reaction_in_another_direction_is_off_by_the_angle(uneven: tuple[Surface, list[History]]) -> None:
    """3-4-5: as large as the reference's and turned; the difference is (4, 0, -2), its length over 5."""
    surface, (model, _) = uneven
    u = model.displacement[0]
    reactions = np.zeros((2, 1, *u.shape))
    reactions[0, 0, :2] = [[3.0, 1.0, 0.0], [1.0, -1.0, 3.0]]  # (4, 0, 3) in all
    reactions[1, 0, 7] = [0.0, 0.0, 5.0]
    turned, straight = (history(u, reaction=reaction) for reaction in reactions)
    found = evaluate(surface, turned, straight)["reaction_force_error"]
    assert_allclose(found, math.hypot(4.0, 2.0) / 5.0, **ROUND)


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_about_the_line_of_all_points_is_no_motion(seed: int) -> None:
    """Its moment of inertia is zero, or rounding of either sign, by whose root nothing is divided."""
    points = np.linspace(0.0, 1.0, 7)[:, None] * np.random.default_rng(seed).normal(size=3)
    motions = rigid_motions(points, np.ones(7))
    sizes = np.einsum("mni,mni->m", motions, motions)
    assert_allclose(np.sort(sizes), [0, 1, 1, 1, 1, 1], rtol=1e-12, atol=1e-12)
