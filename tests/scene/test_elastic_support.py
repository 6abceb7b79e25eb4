"""Springs between a part of the surface and the ground, by a study: between fixed and free in every model."""

from __future__ import annotations

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
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import SceneError, build_scene
from vdmbench.study.registry import is_linear
from vdmbench.study.schema import Study
from vdmbench.work.keys import wanted

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


def test_a_bed_alone_holds_a_body(box: Mesh) -> None:
    """Springs in every direction under all of it hold elements: the force goes through them alone."""
    push = BASE["constraints"][2]
    full = BED | {"direction": "full"}
    result = answer(box, "fem-linear", constraints=[full, push])
    assert_allclose(result.reaction_force[0].sum(axis=0), [0, 0, FORCE], atol=1e-9)
    sliding = answer(box, "fem-linear", constraints=[BED, push])
    assert sliding.status[0].code == models.REFUSED, "nothing stops it from sliding"
    assert "too little is held" in sliding.status[0].message


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


def test_springs_belong_to_the_set_up() -> None:
    """Another stiffness is another body; another force is not. Studies without springs keep their keys."""
    clamp, _, push = BASE["constraints"]
    keys = {
        name: wanted(study(*given, **tables), "mesh")[1]
        for name, (given, tables) in {
            "base": ((BED,), {}),
            "pushed": ((), {"constraints": [clamp, BED, push | {"force": 2 * FORCE}]}),
            "stiffer": ((BED | {"stiffness": 3e5},), {}),
            "full": ((BED | {"direction": "full"},), {}),
            "without": ((), {"constraints": [clamp, push]}),
        }.items()
    }
    assert keys["pushed"].body == keys["base"].body
    assert len({one.body for one in keys.values()}) == 4


def test_springs_under_held_facets_are_refused(box: Mesh) -> None:
    with pytest.raises(SceneError, match="facets that are fixed or constrained"):
        build_scene(study(BED | {"region": "clamp"}), box)
