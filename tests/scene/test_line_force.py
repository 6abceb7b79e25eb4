"""A force along an edge of the body: the same resultant for every model that takes it, refused by the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.bodies import telling_params
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.refine import refined
from vdmbench.measures.reference import level_scene
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import SceneError, build_scene
from vdmbench.study.loads import KINDS
from vdmbench.study.registry import is_linear
from vdmbench.study.schema import Study
from vdmbench.work.keys import wanted

PULL = np.array([1e-3, 2e-3, -5e-3])  # N: moves the tip by 0.01 of its width
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["bem", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "box", "size": [0.06, 0.03, 0.03], "mesh_size": 0.015},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49},
    "regions": {
        "clamp": {"below": {"axis": "x", "fraction": 0.001}},
        "edge": {"box": {"min": [0.0299, -0.02, 0.0149], "max": [0.0301, 0.02, 0.0151]}},
    },
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        {"kind": "line", "region": "edge", "resultant": PULL.tolist()},
    ],
}


def study(**tables: Any) -> Study:
    return Study.model_validate(BASE | tables)


@pytest.fixture(scope="module")
def box() -> Mesh:
    return build_mesh(study().geometry)


def test_a_line_is_the_edges_between_its_nodes(box: Mesh) -> None:
    scene = build_scene(study(), box)
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
    scene = level_scene(study(), refined(box, 1))
    assert len(scene.dead[0][0]) == 2 * len(build_scene(study(), box).dead[0][0])
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
        build_scene(study(regions=BASE["regions"] | {"edge": region}), box)


TRACTION: dict[str, Any] = {
    "regions": BASE["regions"] | {"end": {"above": {"axis": "x", "fraction": 0.999}}},
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


@pytest.mark.parametrize("tables", [{}, TRACTION], ids=["line", "traction"])
@pytest.mark.parametrize("name", telling_params())
def test_every_model_balances_it_or_refuses_it_by_name(
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
    key = model.name, bool(tables)
    if key not in firsts:
        firsts[key] = models.run_model(build_scene(study(**tables), box), model.name)
    first = firsts[key]
    rows = build_scene(study(**tables), box).dead[0][0].ravel()
    tip, first_tip = (r.displacement[0, rows].mean(axis=0) for r in (result, first))
    # the tip moves by less than a hundredth of the length: the nonlinear answers are linear to about as much
    tolerance = 0.03 if not is_linear(name) or not is_linear(model.name) else 1e-3
    assert_allclose(tip, first_tip, atol=tolerance * np.linalg.norm(first_tip))
    assert tip @ PULL > 0


def test_a_kind_that_acts_by_a_dead_force_declares_it(box: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that takes none would ignore it."""
    monkeypatch.setattr(KINDS["line"], "extra", "")
    with pytest.raises(SceneError, match="'line' has to declare as `extra`"):
        build_scene(study(), box)


def test_answers_are_keyed_by_the_line_and_scaled() -> None:
    """Twice the force is twice the answer of one set-up; another direction or another line is another answer."""
    clamp, line = BASE["constraints"]
    below = {"box": {"min": [0.0299, -0.02, -0.0151], "max": [0.0301, 0.02, -0.0149]}}
    tables: dict[str, dict[str, Any]] = {
        "base": {},
        "twice": {"constraints": [clamp, line | {"resultant": (2 * PULL).tolist()}]},
        "turned": {"constraints": [clamp, line | {"resultant": [0.0, 0.0, 1e-3]}]},
        "moved": {"regions": BASE["regions"] | {"edge": below}},
    }
    keys = {name: wanted(study(**given), "mesh")[0] for name, given in tables.items()}
    assert len({one.body for one in keys.values()}) == 1, "a line is no support"
    assert keys["twice"].answers == keys["base"].answers
    assert_allclose(keys["twice"].scales[0], 2 * keys["base"].scales[0])
    assert len({one.answers for one in keys.values()}) == 3
