"""[anisotropy] reaches every model, and what it does in VDM and in the reference."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdm.material import Parameters
from vdm.surface import SurfaceMesh
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.surface_measures import Surface
from vdmbench.measures.metrics import METRICS, History
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand
from vdmbench.study.registry import Family
from vdmbench.study.schema import Study
from vdmbench.work.explain import refused
from vdmbench.work.plan import make_plan

X, Y, Z = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0])
STUDY: dict[str, Any] = {
    "study": {"name": "test", "models": ["vdm-paper"]},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.012},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.4999},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.5}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.02},
    ],
}


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return build_mesh(Study.model_validate(STUDY).geometry)


def run(mesh: Mesh, model: str, anisotropy: dict[str, Any] | None) -> ModelResult:
    study = Study.model_validate(STUDY | ({"anisotropy": anisotropy} if anisotropy else {}))
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
    plain = strains(mesh, run(mesh, model, None))
    along_x, along_y = (
        strains(mesh, run(mesh, model, {"fibre_direction": d, "contrast": 4})) for d in (X, Y)
    )
    assert plain[2] < 0.0 < plain[0]
    assert_allclose(plain[0], plain[1], rtol=0.02, atol=0)  # a body of revolution
    assert along_x[0] < 0.85 * along_x[1]
    assert along_y[1] < 0.85 * along_y[0]
    # the mesh has no preferred direction: the answer turns with the fibres
    assert_allclose(along_x[[1, 0, 2]], along_y, rtol=0.05, atol=0)
    one = strains(mesh, run(mesh, model, {"fibre_direction": X, "contrast": 1}))
    assert_allclose(one, plain, rtol=1e-7, atol=0)


def test_a_model_without_fibres_is_refused_by_itself(mesh: Mesh) -> None:
    boundary = run(mesh, "bem", {"fibre_direction": Z, "contrast": 2})
    assert boundary.status[0].code == models.REFUSED
    assert "isotropic; use another model for fibres" in boundary.status[0].message
    assert np.isnan(boundary.displacement).all()
    for model in ("fem-linear", "fem"):
        softer = run(mesh, model, {"fibre_direction": Z, "contrast": 0.5})
        assert softer.status[0].code == models.REFUSED
        assert softer.status[0].message == "contrast is 0.5"
        assert softer.status[0].remedy == "give 1 or more: fibres stiffen the body"
    assert run(mesh, "vdm-paper", {"fibre_direction": Z, "contrast": 0.5}).status[0].ok


def test_a_plan_names_the_models_that_refuse_fibres(mesh: Mesh, tmp_path: Path) -> None:
    fibres = {"fibre_direction": X, "contrast": 4.0}
    ours = {name for name, model in models.all_models().items() if model.family is not Family.ENGINES}
    names = sorted(ours - {"fem"})
    wanted = STUDY | {"study": STUDY["study"] | {"models": names}}
    study = Study.model_validate(wanted | {"anisotropy": fibres})
    plan = make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")
    told = {line.split()[0] for line in refused(plan, plan.cases)}
    refusing = ("bem", "bem-sparse", "mass-spring")
    assert told == {name for name in refusing if run(mesh, name, fibres).status[0].code == models.REFUSED}
    assert len(told) == 3


@pytest.mark.parametrize("contrast", [0.3, 3.0, 30.0])
def test_contrast_of_edges_is_more_than_that_of_the_skin(contrast: float) -> None:
    """Edges in six directions, 60 degrees apart: tension c times as stiff gives a skin (1 + 3c)/(3 + c) times.

    The tension tensor of a skin is sum w f(e) d x d over its edges; the mean of cos^4 is 3/8, of cos^2 sin^2 1/8.
    """
    angles = np.radians(7.0 + 60.0 * np.arange(6))
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)])
    points = np.vstack([[0.0, 0.0, 0.0], ring, [0.0, 0.0, -1.0]])
    following = np.roll(np.arange(1, 7), -1)
    flat = np.column_stack([np.zeros(6, int), np.arange(1, 7), following])
    below = np.column_stack([following, np.arange(1, 7), np.full(6, 7)])
    surface = SurfaceMesh(points, np.vstack([flat, below]))
    spokes = np.flatnonzero((surface.edges == 0).any(axis=1))
    assert len(spokes) == 6
    tension = Parameters(surface_tension=1.0).anisotropic(surface, (2.0, 0.0, 0.0), contrast).surface_tension
    d = np.diff(points[surface.edges[spokes]], axis=1)[:, 0]
    tensor = np.einsum("e,ea,eb->ab", np.asarray(tension)[spokes], d, d)
    assert_allclose(tensor[0, 0] / tensor[1, 1], (1 + 3 * contrast) / (3 + contrast), rtol=1e-12, atol=0)
    assert_allclose(tensor[0, 1], 0.0, rtol=0, atol=1e-12 * contrast)
