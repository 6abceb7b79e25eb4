"""Bodies with cavities, by a study: empty or filled with a fluid, against Lame's hollow ball and each other."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista as pv
from numpy.testing import assert_array_equal

from tests.bodies import shaped
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.mesh_file import write_body_vtu
from vdmbench.body.surface_measures import enclosed_volume
from vdmbench.scene.regions import select
from vdmbench.scene.scene import build_scene
from vdmbench.study.errors import MeshError
from vdmbench.study.registry import lacks
from vdmbench.study.schema import Region, Study

pytestmark = pytest.mark.usefixtures("read_here")

YOUNG, BED, PUSH = 5e3, 1e5, 1.0  # Pa, Pa/m, Pa
BALL: dict[str, Any] = {"shape": "hollow-sphere", "radius": 0.05, "cavity_radius": 0.025, "mesh_size": 0.0125}


def study(cavities: str, nu: float, pressed: str = "wall", **tables: Any) -> Study:
    """A hollow ball on springs of every direction, under a pressure on one of its two surfaces."""
    text = {
        "study": {"name": "hollow", "models": ["bem", "fem-linear", "fem"], "reference": "fem"},
        "geometry": BALL | {"cavities": cavities},
        "tissue": {"youngs_modulus": YOUNG, "poisson_ratio": nu},
        "regions": {"wall": {"cavity": True}, "skin": {"cavity": False}},
        "constraints": [
            {"kind": "elastic", "region": "skin", "stiffness": BED, "direction": "full"},
            {"kind": "contact", "region": pressed, "pressure": PUSH},
        ],
    }
    return Study.model_validate(text | tables)


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(study("empty", 0.3).geometry)


def lame(mesh: Mesh, nu: float, pressed: str, filled: bool) -> float:
    """Elastic energy [J] of u = A r + B / r^2 between balls of the surfaces' volumes.

    sigma_rr = 3 K A - 4 G B / r^3; on the springs it is -k u - p at the outer radius b. At the inner one, a, it is
    -p; where a fluid fills the cavity its volume is kept, and u = 0 there.
    """
    cavity = -enclosed_volume(mesh.surface_points, mesh.triangles[mesh.shells > 0])
    a, b = ((0.75 / np.pi * v) ** (1 / 3) for v in (cavity, cavity + mesh.quality["volume"]))
    shear, bulk = YOUNG / (2 * (1 + nu)), YOUNG / (3 * (1 - 2 * min(nu, 0.5 - 1e-9)))
    within, around = (PUSH, 0.0) if pressed == "wall" else (0.0, PUSH)
    inner = [a, a**-2] if filled else [3 * bulk, -4 * shear / a**3]
    outer = [3 * bulk + BED * b, BED / b**2 - 4 * shear / b**3]
    first, second = np.linalg.solve([inner, outer], [0.0 if filled else -within, -around])
    at_a, at_b = first * a + second / a**2, first * b + second / b**2
    worked = 0.0 if filled else within * a**2 * at_a
    return float(2 * np.pi * (worked - (around + BED * at_b) * b**2 * at_b))


@pytest.mark.parametrize(
    ("cavities", "nu", "pressed", "names"),
    [
        ("empty", 0.3, "wall", ("bem", "fem-linear")),
        ("empty", 0.5, "skin", ("bem", "fem-linear", "bem:nonlinear")),
        ("fluid", 0.3, "skin", ("bem", "fem-p2", "fem")),
    ],
)
def test_a_hollow_ball_answers_as_lame_has_it(
    ball: Mesh, cavities: str, nu: float, pressed: str, names: tuple[str, ...]
) -> None:
    exact = lame(ball, nu, pressed, cavities == "fluid")
    for name in names:
        result = models.run_model(build_scene(study(cavities, nu, pressed), ball), name)
        assert result.status[0].ok, result.status
        assert result.energy[0] == pytest.approx(exact, rel=0.015), name


def test_a_fluid_keeps_the_volume_far_from_rest(ball: Mesh) -> None:
    """Pressed from above by a tenth of its height: as elements have it, and otherwise than an empty one."""
    pressed = {
        "constraints": [
            {"kind": "fixed", "region": "base"},
            {"kind": "contact", "region": "top", "pressure": 500.0},
        ],
        "regions": {
            "base": {"below": {"axis": "z", "fraction": 0.2}},
            "top": {"above": {"axis": "z", "fraction": 0.8}},
        },
        "vdm": {"parts": 1},
    }
    found = {}
    for cavities in ("empty", "fluid"):
        scene = build_scene(study(cavities, 0.5, **pressed), ball)
        for name in ("bem:nonlinear", "fem") if cavities == "fluid" else ("fem",):
            result = models.run_model(scene, name)
            assert result.status[0].ok, result.status
            found[cavities, name] = result.displacement[0]
            moved = ball.surface_points + result.displacement[0]
            wall = ball.triangles[ball.shells > 0]
            kept = enclosed_volume(moved, wall) / enclosed_volume(ball.surface_points, wall)
            # elements keep that of their curved facets
            assert abs(kept - 1.0) < (1e-12 if name != "fem" else 0.02) or cavities == "empty"
    size = np.linalg.norm(found["fluid", "fem"])
    assert np.abs(found["fluid", "fem"]).max() > 0.009
    assert np.linalg.norm(found["fluid", "bem:nonlinear"] - found["fluid", "fem"]) < 0.1 * size
    assert np.linalg.norm(found["empty", "fem"] - found["fluid", "fem"]) > 0.09 * size


def test_files_tell_what_their_cavities_hold(ball: Mesh, tmp_path: Path) -> None:
    write_body_vtu(tmp_path / "a.vtu", ball, {}, np.zeros(len(ball.triangles)))
    pv.PolyData.from_regular_faces(ball.surface_points, ball.triangles[:, ::-1]).save(tmp_path / "a.stl")
    solid = ball.triangles[ball.shells == 0]
    pv.PolyData.from_regular_faces(ball.surface_points, solid).save(tmp_path / "solid.stl")
    for name in ("a.vtu", "a.stl"):
        given: dict[str, Any] = {"path": str(tmp_path / name)}
        with pytest.raises(MeshError, match=r'in 2 places .* cavities = "empty" or "fluid"'):
            build_mesh(shaped("file", 0.012, given))
        mesh = build_mesh(shaped("file", 0.012, given | {"cavities": "fluid"}))
        assert mesh.shells.max() == 1
        assert mesh.quality["volume"] == pytest.approx(ball.quality["volume"], rel=0.02)
        assert np.linalg.norm(mesh.surface_points[mesh.in_cavity], axis=1).max() < 0.026
    with pytest.raises(MeshError, match="has no cavity"):
        build_mesh(shaped("file", 0.012, {"path": str(tmp_path / "solid.stl"), "cavities": "empty"}))


def test_regions_lie_on_the_outer_surface_or_in_the_cavity(ball: Mesh) -> None:
    def chosen(**region: Any) -> np.ndarray:
        return select(Region.model_validate(region), ball)

    upper = ball.surface_points[:, 2] >= 0.003
    half = {"above": {"axis": "z", "value": 0.003}}
    assert_array_equal(chosen(**half), upper & ~ball.in_cavity)
    assert_array_equal(chosen(**half, cavity=True), upper & ball.in_cavity)
    assert_array_equal(chosen(cavity=True), ball.in_cavity)
    assert_array_equal(chosen(cavity=False), ~ball.in_cavity)


@pytest.mark.parametrize("name", ["vdm-paper", "vdm-consistent", "vdm-vector", "bem-sparse", "mass-spring"])
def test_models_that_know_no_cavities_refuse_them_by_name(ball: Mesh, name: str) -> None:
    result = models.run_model(build_scene(study("empty", 0.5), ball), name)
    assert result.status[0].code == models.REFUSED
    assert f"{name} knows no cavities" in result.status[0].message


def test_a_fluid_is_refused_where_only_empty_ones_are_known() -> None:
    assert not lacks("fem-condensed", {"cavities"})
    assert (
        "fem-condensed knows no fluid in cavities"
        in lacks("fem-condensed", {"cavities", "fluid in cavities"})[0]
    )
