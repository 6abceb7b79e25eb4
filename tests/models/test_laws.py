"""Laws of large strain by a study: for finite-strain elements, refused by other models of large displacements."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference.materials import PARAMETERS
from tests.bodies import telling_names
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.scene.scene import build_scene
from vdmbench.study.registry import is_linear
from vdmbench.study.schema import LAWS, Study, Tissue
from vdmbench.work.keys import case_hash, wanted

PLAIN = {"youngs_modulus": 1000.0, "poisson_ratio": 0.5}
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["bem", "fem"], "reference": "fem"},
    "geometry": {"shape": "box", "size": [1.0, 1.0, 1.0], "mesh_size": 0.5},
    "tissue": PLAIN,
    "regions": {
        "bottom": {"below": {"axis": "z", "fraction": 0.0}},
        "top": {"above": {"axis": "z", "fraction": 1.0}},
    },
    "constraints": [
        {"kind": "fixed", "region": "bottom"},
        {"kind": "contact", "region": "top", "pressure": 300.0},
    ],
}
# each with numbers that leave I1' alone, whose energy differs from the neo-Hookean one where J is not 1, and others
NEO = {
    "mooney-rivlin": {"second_share": 0.0},
    "yeoh": {"second_ratio": 0.0, "third_ratio": 0.0},
    "fung": {"exponent": 1e-9},
    "ogden": {"exponents": [2.0], "shares": [1.0]},
}
OTHER = {
    "mooney-rivlin": {"second_share": 0.8},
    "yeoh": {"second_ratio": 1.0, "third_ratio": 0.5},
    "fung": {"exponent": 4.0},
    "ogden": {"exponents": [8.0, -2.0], "shares": [0.7, 0.3]},
}


def study(law: dict[str, Any] | None = None, **tables: Any) -> Study:
    return Study.model_validate(BASE | {"tissue": PLAIN | (law or {})} | tables)


@pytest.fixture(scope="module")
def box() -> Mesh:
    return build_mesh(study().geometry)


def pressed(box: Mesh, law: dict[str, Any]) -> np.ndarray:
    result = models.run_model(build_scene(study(law), box), "fem")
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


@pytest.mark.parametrize("law", OTHER)
def test_numbers_of_a_law_make_a_difference(box: Mesh, law: str, of_first_invariant: np.ndarray) -> None:
    assert np.abs(pressed(box, {"law": law} | OTHER[law]) - of_first_invariant).max() > 0.005


@pytest.mark.parametrize("name", telling_names())
def test_other_models_of_large_displacements_refuse_it_by_name(box: Mesh, name: str) -> None:
    if is_linear(name) or name in ("fem", "fem:linear"):
        return
    result = models.run_model(build_scene(study({"law": "fung", "exponent": 4.0}), box), name)
    assert result.status[0].code == models.REFUSED
    assert result.status[0].message.startswith(
        f"{name} has no such law of large strain; leave out tissue.law"
    )


def test_a_law_is_known_to_those_who_read_it() -> None:
    keys = {
        name: wanted(study(law), "mesh")
        for name, law in {
            "none": {},
            "fung": {"law": "fung", "exponent": 4.0},
            "stiffer": {"law": "fung", "exponent": 5.0},
        }.items()
    }
    assert len({one[0].body for one in keys.values()}) == 1, "a linear surface model"
    assert len({one[1].body for one in keys.values()}) == 3
    assert case_hash(study(), "mesh") != case_hash(study({"law": "fung", "exponent": 4.0}), "mesh")


def test_names_and_keys_are_those_of_the_elements() -> None:
    """Every law that has numbers of its own is there, with these numbers."""
    there = {law.material: law.keys for law in LAWS.values()}
    assert there == {name: keys for name, keys in PARAMETERS.items() if name != "transversely-isotropic"}
    assert set(LAWS) == set(get_args(get_args(Tissue.model_fields["law"].annotation)[0]))
