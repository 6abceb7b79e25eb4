"""A rigid indenter by a study: Hertz's force and area, its place, and who takes it."""

import math
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.exact_contact import Hertz
from tests.bodies import telling_names
from tests.fem.shapes import mapped_box
from tests.in_process import do_cases
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.scene.regions import SceneError
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_case
from vdmbench.study.schema import Study
from vdmbench.work.plan import make_plan

pytestmark = pytest.mark.usefixtures("read_here")

TOUCH: dict[str, Any] = {
    "kind": "indenter",
    "region": "top",
    "shape": "sphere",
    "radius": 0.1,
    "depth": 0.002,
}
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["bem", "fem-linear"], "reference": "fem-linear"},
    "geometry": {"shape": "box", "size": [0.04, 0.04, 0.02], "mesh_size": 0.008},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.45},
    "regions": {
        "bottom": {"below": {"axis": "z", "fraction": 0.0}},
        "top": {"above": {"axis": "z", "fraction": 1.0}},
    },
    "constraints": [{"kind": "fixed", "region": "bottom"}, TOUCH],
}


def study(part: dict[str, Any] | None = None, **tables: Any) -> Study:
    given = {"constraints": [BASE["constraints"][0], part]} if part else {}
    return Study.model_validate(BASE | given | tables)


@pytest.fixture(scope="module")
def box() -> Mesh:
    return build_mesh(study().geometry)


def answer(mesh: Mesh, name: str, part: dict[str, Any] | None = None, **tables: Any) -> ModelResult:
    return models.run_model(build_scene(study(part, **tables), mesh), name)


# --- Hertz ---

CONTACT, SPHERE, YOUNG = 0.01, 0.2, 1000.0  # contact radius [m], radius of the indenter [m], E [Pa]
SHELLS = CONTACT * np.array([0.0, 0.4, 0.8, 1.2, 2.2, 5.0])


def half_ball(file: Path) -> None:
    """Half a ball below z = 0 about the origin, finer towards its middle."""
    n = len(SHELLS) - 1

    def place(x: np.ndarray) -> np.ndarray:
        p = (x - [0.5, 0.5, 1.0]) * [2.0, 2.0, 1.0]
        shell = np.abs(p).max(axis=1)
        length = np.where(shell > 0.0, np.linalg.norm(p, axis=1), 1.0)
        # inside shells of the contact's size the cells are cubes, farther out they follow the sphere
        round_ = np.interp(shell, np.linspace(0.0, 1.0, n + 1)[3:], np.linspace(0.0, 1.0, n - 2))
        ball = p * (np.interp(shell, np.linspace(0.0, 1.0, n + 1), SHELLS) / length)[:, None]
        cube = (
            p * (np.interp(shell, np.linspace(0.0, 1.0, n + 1), SHELLS) / np.maximum(shell, 1e-300))[:, None]
        )
        return ball * round_[:, None] + cube * (1.0 - round_)[:, None]

    b = mapped_box((2 * n, 2 * n, n), place)
    meshio.write_points_cells(file, b.points, [("tetra", b.tetrahedra)])


def hertz(directory: Path, **tables: Any) -> Study:
    """A sphere on a half-space: springs of 3 G / r carry the half ball as the rest of the half-space does.

    The field of a force on an incompressible half-space is radial, u = F z / (2 pi G r^2), and so is its only
    stress, 3 F z / (2 pi r^3).
    """
    half_ball(directory / "half.vtu")
    depth = CONTACT**2 / SPHERE
    text = {
        "study": {"name": "hertz", "models": ["fem-linear"]},
        "geometry": {"shape": "file", "path": str(directory / "half.vtu")},
        "tissue": {"youngs_modulus": YOUNG, "poisson_ratio": 0.5},
        "regions": {
            "touch": {"ball": {"center": [0, 0, 0], "radius": 1.6 * CONTACT}},
            # from the centroid, 3/8 of the radius below the flat face, the round one is seen up to its rim
            "far": {"cap": {"direction": [0, 0, -1], "angle": math.pi - math.atan(0.9 * 8 / 3)}},
        },
        "constraints": [
            {"kind": "elastic", "region": "far", "stiffness": YOUNG / SHELLS[-1], "direction": "full"},
            {"kind": "indenter", "region": "touch", "shape": "sphere", "radius": SPHERE, "depth": depth},
        ],
        "load": {"factors": [0.25, 1.0]},
    }
    return Study.model_validate(text | tables)


def test_sphere_on_a_half_space_by_a_study(tmp_path: Path) -> None:
    plan = make_plan(hertz(tmp_path), tmp_path / "run", tmp_path / "cache")
    do_cases(plan)
    case = read_case(plan.case_file(plan.cases[0]))
    found = case.models["fem-linear"]
    assert all(status.ok for status in found.status), found.status
    for step, factor in ((0, 0.25), (1, 1.0)):
        exact = Hertz(SPHERE, factor * CONTACT**2 / SPHERE, YOUNG / 0.75)
        force = found.scalars["indenter_force"][step]
        assert force == pytest.approx(exact.force, rel=0.05)
        assert_allclose(found.reaction_force[step].sum(axis=0), [0, 0, force], atol=1e-9)
    assert found.scalars["contact_area"][1] == pytest.approx(np.pi * CONTACT**2, rel=0.2)


# --- shapes, places and models ---


@pytest.mark.parametrize("name", telling_names())
def test_every_model_takes_it_or_refuses_it_by_name(box: Mesh, name: str) -> None:
    model, solver = models.find(name)
    if f"{model.name}:{model.solvers[0]}" == name:
        return  # the same as without the solver
    result = answer(box, name)
    if solver not in model.takes.get("indenter", ()):
        assert result.status[0].code == models.REFUSED
        assert f"{name} takes no rigid indenter" in result.status[0].message
        return
    assert result.status[0].ok, result.status
    force = result.scalars["indenter_force"][0]
    assert force == pytest.approx(0.45, rel=0.3), "Hertz's 0.24 N times 1.9, as of a thin layer"
    assert_allclose(result.reaction_force[0, :, 2].sum(), force, rtol=1e-3)
    assert result.displacement[0, :, 2].min() == pytest.approx(-0.002, rel=0.2)


def test_it_touches_first_at_depth_zero(box: Mesh) -> None:
    scene = build_scene(study(TOUCH | {"push": [0.0, 0.0, -2.0]}), box)
    tip = np.asarray(scene.indenter.indenter.tip)
    assert_allclose(tip[:2], 0.0, atol=1e-12)  # the middle of the top
    nodes = box.surface_points[scene.regions["top"]]
    assert np.linalg.norm(nodes[:, :2], axis=1).min() > 1e-4  # no node where it touches
    assert_allclose(tip[2], 0.01, atol=1e-9)
    assert_allclose([load.depth for load in scene.loads], 0.002)
    everywhere = BASE["regions"] | {"all": {"above": {"axis": "z", "fraction": 0.0}}}
    around = study(regions=everywhere, constraints=[TOUCH | {"region": "all"}])
    with pytest.raises(SceneError, match="faces every way; give push"):
        build_scene(around, box)


def test_what_else_acts_goes_with_its_step(box: Mesh) -> None:
    """A pull at the side rises with the depth, step by step."""
    side = {"side": {"box": {"min": [0.019, -0.021, -0.009], "max": [0.021, 0.021, 0.009]}}}
    pull = {"kind": "contact", "region": "side", "pressure": -400.0}
    parts = [BASE["constraints"][0], TOUCH, pull]
    tables = {"regions": BASE["regions"] | side, "constraints": parts}
    both = answer(box, "fem-linear", **tables, load={"factors": [0.5, 1.0]})
    half = answer(box, "fem-linear", **tables, load={"factors": [0.5]})
    assert_allclose(both.displacement[0], half.displacement[0], rtol=0, atol=1e-12)
    alone = answer(box, "fem-linear")
    assert abs(both.scalars["indenter_force"][1] / alone.scalars["indenter_force"][0] - 1.0) > 0.01
