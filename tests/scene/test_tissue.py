"""What the tissue is, by a study: parts of the inside with moduli of their own, and laws of large strain."""

import dataclasses
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.materials import PARAMETERS
from tests.bodies import telling_names
from tests.fem.shapes import cube
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.mesh_cache import read_mesh, write_mesh
from vdmbench.body.refine import Hierarchy, refined
from vdmbench.body.surface_measures import Surface
from vdmbench.body.topology import mesh_from_tetrahedra
from vdmbench.measures.metrics import (
    History,
    relative_l2_deformation_error,
    relative_l2_displacement_error,
)
from vdmbench.measures.reference import level_scene
from vdmbench.scene.inclusions import moduli
from vdmbench.scene.regions import SceneError
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.registry import is_linear
from vdmbench.study.schema import LAWS, Study, Tissue

UPPER: dict[str, Any] = {
    "name": "upper",
    "box": {"min": [-1.0, -1.0, 0.5], "max": [2.0, 2.0, 2.0]},
    "youngs_modulus": 1800.0,
}
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["bem", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "box", "size": [1.0, 1.0, 1.0], "mesh_size": 0.5},
    "tissue": {"youngs_modulus": 1000.0, "poisson_ratio": 0.0},
    "inclusions": [UPPER],
    "regions": {
        "bottom": {"below": {"axis": "z", "fraction": 0.0}},
        "top": {"above": {"axis": "z", "fraction": 1.0}},
    },
    "constraints": [
        {"kind": "fixed", "region": "bottom"},
        {"kind": "contact", "region": "top", "pressure": 0.1},
    ],
}


def study(**tables: Any) -> Study:
    return Study.model_validate({key: value for key, value in (BASE | tables).items() if value is not None})


@pytest.fixture(scope="module")
def bar() -> Mesh:
    """A unit cube with a plane of facets at half its height."""
    b = cube(2)
    low, high = b.points[b.tetrahedra].mean(axis=1)[:, 2] < 0.5, b.points[:, 2] >= 0.5
    assert low.any()
    return mesh_from_tetrahedra(b.points, b.tetrahedra, groups={"cap": high, "skin": b.points[:, 2] == 1.0})


def answer(mesh: Mesh, name: str, **tables: Any) -> ModelResult:
    return models.run_model(build_scene(study(**tables), mesh), name)


KNOWING = [
    name
    for name in models.model_names()
    if models.find(name)[1] in models.find(name)[0].takes.get("inclusions", ()) and name.count(":linear") == 0
]


@pytest.mark.parametrize("name", [name for name in KNOWING if not name.startswith("bem")])
def test_two_materials_in_series(bar: Mesh, name: str) -> None:
    """Without a Poisson ratio the stress is p everywhere: u_z = -p times the integral of 1/E, on any such mesh."""
    result = answer(bar, name)
    assert result.status[0].ok, result.status
    z = bar.surface_points[:, 2]
    exact = -0.1 * (np.minimum(z, 0.5) / 1000.0 + np.maximum(z - 0.5, 0.0) / 1800.0)
    large = 1e-4 if name.startswith("fem:") or name == "fem" else 1e-9  # finite strain, of 1e-4
    assert_allclose(result.displacement[0, :, 2], exact, rtol=0, atol=3 * large * np.abs(exact).max())


def lump(name: str, x: float, radius: float, ratio: float) -> dict[str, Any]:
    return {"name": name, "ball": {"center": [x, 0, 0], "radius": radius}, "youngs_modulus": 1e3 * ratio}


WITH_LUMPS: dict[str, Any] = {
    "geometry": {"shape": "box", "size": [2.0, 1.0, 1.0], "mesh_size": 0.14},
    "tissue": {"youngs_modulus": 1000.0, "poisson_ratio": 0.45},
}


PRESSED_BALL: dict[str, Any] = {
    "geometry": {"shape": "sphere", "radius": 1.0, "mesh_size": 0.21},
    "tissue": {"youngs_modulus": 1000.0, "poisson_ratio": 0.49},
    "regions": {
        "bottom": {"below": {"axis": "z", "fraction": 0.3}},
        "top": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": "45 deg"}},
    },
}


@pytest.fixture(scope="module")
def pressed_ball() -> Hierarchy:
    return refined(build_mesh(study(**PRESSED_BALL).geometry), 1)


@pytest.mark.parametrize(
    "ratio",
    [*(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (0.1, 3.0, 10.0)), 100.0],
)
def test_boundary_elements_know_a_lump_of_any_modulus(pressed_ball: Hierarchy, ratio: float) -> None:
    """Within 5 % of elements on the tetrahedra split once, in displacement and change of shape."""
    part = {"name": "lump", "ball": {"center": [0, 0, 0.44], "radius": 0.28}, "youngs_modulus": 1e3 * ratio}
    mesh, loaded = pressed_ball.meshes[0], study(**PRESSED_BALL, inclusions=[part])
    scenes = {"bem": build_scene(loaded, mesh), "fem-linear": level_scene(loaded, pressed_ball)}
    n, found = len(mesh.surface_nodes), {}
    for name, scene in scenes.items():
        result = models.run_model(scene, name)
        found[name] = History(result.displacement[:, :n], result.reaction_force[:, :n], scene.load_factors)
    surface = Surface(mesh.surface_points, mesh.triangles)
    for error in (relative_l2_displacement_error, relative_l2_deformation_error):
        assert error(surface, found["bem"], found["fem-linear"])[0] < 0.05


@pytest.mark.parametrize(
    ("lumps", "told"),
    [
        ([lump("a", 0.9, 0.4, 10.0)], "'a' reaches the surface of the body"),
        ([lump("a", -0.2, 0.3, 10.0), lump("b", 0.2, 0.3, 5.0)], "inclusions touch each other ('a' and 'b')"),
        # a shell that falls in pieces, as it is thinner than a tetrahedron
        (
            [lump("c", 0.6, 0.25, 2.0), lump("a", -0.2, 0.34, 10.0), lump("b", -0.2, 0.26, 5.0)],
            "inclusions touch each other ('a' and 'b')",
        ),
    ],
)
def test_a_lump_that_touches_is_refused(lumps: list[dict[str, Any]], told: str) -> None:
    mesh = build_mesh(study(**WITH_LUMPS).geometry)
    refused = answer(mesh, "bem", **WITH_LUMPS, inclusions=lumps).status[0]
    assert refused.code == models.REFUSED
    assert told in refused.message
    assert "\n" not in refused.message


@pytest.mark.parametrize("name", [name for name in telling_names() if name not in KNOWING])
def test_others_are_refused_by_name_or_leave_it_out(bar: Mesh, name: str) -> None:
    if models.find(name)[1] in models.find(name)[0].takes.get("inclusions", ()):
        return  # another name of one that knows them
    refused = answer(bar, name)
    assert refused.status[0].code == models.REFUSED
    assert f"{name} knows no inclusions; study.homogeneous" in refused.status[0].message
    allowed = answer(bar, name, study=BASE["study"] | {"models": [name], "homogeneous": [name]})
    without = answer(bar, name, inclusions=None)
    assert allowed.status == without.status
    assert_allclose(allowed.displacement, without.displacement, rtol=1e-12, atol=1e-18)


def test_the_last_of_several_wins(bar: Mesh) -> None:
    core = {"name": "core", "ball": {"center": [0.5, 0.5, 0.75], "radius": 0.3}, "youngs_modulus": 9e3}
    core |= {"poisson_ratio": 0.3}
    tissue = {"youngs_modulus": 1000.0, "poisson_ratio": 0.45}
    scene = build_scene(study(inclusions=[UPPER, core], tissue=tissue), bar)
    young, ratio, parts = moduli(scene.tissue, scene.inclusions)
    near = np.linalg.norm(bar.points[bar.tetrahedra].mean(axis=1) - [0.5, 0.5, 0.75], axis=1) <= 0.3
    above = bar.points[bar.tetrahedra].mean(axis=1)[:, 2] > 0.5
    assert near.any()
    assert (young == np.where(near, 9e3, np.where(above, 1800.0, 1000.0))).all()
    assert (ratio == np.where(near, 0.3, 0.45)).all()
    assert (parts == np.where(near, 2, np.where(above, 1, 0))).all()
    with pytest.raises(SceneError, match="'upper' has no tetrahedron of its own; enlarge it"):
        build_scene(study(inclusions=[UPPER, UPPER | {"name": "again"}]), bar)


@pytest.mark.parametrize("tetrahedra", [True, False])
def test_one_outside_the_body_is_told_where_the_body_is(bar: Mesh, tetrahedra: bool) -> None:
    mesh = bar if tetrahedra else dataclasses.replace(bar, tetrahedra=bar.tetrahedra[:0])
    given = {"name": "far", "ball": {"center": [1.5, 0.5, 0.5], "radius": 0.4}, "youngs_modulus": 9e3}
    with pytest.raises(SceneError, match=r"outside the body, .* \(4.., 4.., 4..\) mm") as told:
        build_scene(study(inclusions=[given]), mesh)
    assert told.value.place == ("inclusions", 0)


def test_a_refinement_has_the_same_inclusions(bar: Mesh) -> None:
    ball = UPPER | {"box": None, "ball": {"center": [0.5, 0.5, 0.6], "radius": 0.3}}
    given = study(inclusions=[{key: value for key, value in ball.items() if value is not None}])
    hierarchy = refined(bar, 2)
    fine, coarse = level_scene(given, hierarchy), build_scene(given, bar)
    volumes = [
        np.abs(np.linalg.det(mesh.points[inside[:, 1:]] - mesh.points[inside[:, :1]])).sum()
        for mesh, inside in (
            (scene.mesh, scene.mesh.tetrahedra[scene.inclusions[0].inside]) for scene in (coarse, fine)
        )
    ]
    assert_allclose(volumes[1], volumes[0], rtol=1e-12)
    centres = fine.mesh.points[fine.mesh.tetrahedra[fine.inclusions[0].inside]].mean(axis=(0, 1))
    own = bar.points[bar.tetrahedra[coarse.inclusions[0].inside]].mean(axis=(0, 1))
    assert_allclose(centres, own, atol=1e-12)


def test_a_group_of_tetrahedra_is_kept_with_the_mesh(bar: Mesh, tmp_path: Path) -> None:
    group = {"name": "upper", "group": "cap", "youngs_modulus": 1800.0}
    assert set(bar.volumes) == {"cap"}, "a group of a surface has no tetrahedra"
    write_mesh(tmp_path / "mesh.npz", bar)
    stored = read_mesh(tmp_path / "mesh.npz")
    assert stored.content_hash == bar.content_hash
    plane = {"name": "upper", "above": {"axis": "z", "fraction": 0.5}, "youngs_modulus": 1800.0}
    by_box, *others = (build_scene(study(inclusions=[part]), stored) for part in (UPPER, group, plane))
    assert 0 < by_box.inclusions[0].inside.sum() < len(stored.tetrahedra)
    for other in others:
        assert (by_box.inclusions[0].inside == other.inclusions[0].inside).all()
    with pytest.raises(SceneError, match="no group 'vessel'; it has: cap"):
        build_scene(study(inclusions=[group | {"group": "vessel"}]), stored)


PLAIN = {"youngs_modulus": 1000.0, "poisson_ratio": 0.5}
PRESSED = [{"kind": "fixed", "region": "bottom"}, {"kind": "contact", "region": "top", "pressure": 300.0}]
# each with numbers that leave I1' alone, whose energy differs from the neo-Hookean one where J is not 1
NEO = {
    "mooney-rivlin": {"second_share": 0.0},
    "yeoh": {"second_ratio": 0.0, "third_ratio": 0.0},
    "fung": {"exponent": 1e-9},
    "ogden": {"exponents": [2.0], "shares": [1.0]},
}


def of_law(law: dict[str, Any] | None = None) -> Study:
    return study(tissue=PLAIN | (law or {}), constraints=PRESSED, inclusions=None)


@pytest.fixture(scope="module")
def box() -> Mesh:
    return build_mesh(of_law().geometry)


def pressed(box: Mesh, law: dict[str, Any]) -> np.ndarray:
    result = models.run_model(build_scene(of_law(law), box), "fem")
    assert result.status[0].ok
    return result.displacement[0]


@pytest.fixture(scope="module")
def of_first_invariant(box: Mesh) -> np.ndarray:
    """Near the neo-Hookean answer: an element keeps its volume on the mean, not at every point."""
    found = pressed(box, {"law": "yeoh"} | NEO["yeoh"])
    plain = pressed(box, {})
    assert np.abs(plain).max() > 0.15, "large enough to tell laws apart"
    assert 1e-4 < np.abs(found - plain).max() < 0.03 * np.abs(plain).max()
    return found


@pytest.mark.parametrize("law", ["mooney-rivlin", "fung", "ogden"])
def test_each_law_has_that_of_the_first_invariant_in_it(
    box: Mesh, law: str, of_first_invariant: np.ndarray
) -> None:
    assert_allclose(pressed(box, {"law": law} | NEO[law]), of_first_invariant, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", telling_names())
def test_other_models_of_large_displacements_refuse_it_by_name(box: Mesh, name: str) -> None:
    if is_linear(name) or name in ("fem", "fem:linear"):
        return
    result = models.run_model(build_scene(of_law({"law": "fung", "exponent": 4.0}), box), name)
    assert result.status[0].code == models.REFUSED
    assert result.status[0].message.startswith(
        f"{name} has no such law of large strain; leave out tissue.law"
    )


def test_names_and_keys_are_those_of_the_elements() -> None:
    """Every law that has numbers of its own is there, with these numbers."""
    assert {name: keys for name, keys in PARAMETERS.items() if name != "transversely-isotropic"} == LAWS
    assert set(LAWS) == set(get_args(get_args(Tissue.model_fields["law"].annotation)[0]))
