"""Things that are written twice for a reason, held together."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import vdm.material
import vdm.peers.mass_spring
import vdm.solution
from solver_common.solution import Solution
from tests.report.runs import icosphere
from vdm.material import Parameters
from vdm.surface import SurfaceMesh
from vdmbench import models
from vdmbench.scene.result import ModelResult
from vdmbench.study.errors import LIBRARIES

ROOT = Path(__file__).parents[2]


def fields(cls: type) -> dict[str, object]:
    return {field.name: field.type for field in dataclasses.fields(cls)}


def test_the_stored_result_keeps_all_that_a_solution_has() -> None:
    ours = fields(Solution).keys() - {"point_fields"}  # which a study asks no model for
    assert ours <= fields(ModelResult).keys()


def test_a_registered_model_declares_what_its_library_says() -> None:
    """Without loading it: a plan has to be quick."""
    body = SurfaceMesh(*icosphere(1))
    surface = {name: model for name, model in models.all_models().items() if not model.volumetric}
    rules = {name.removeprefix("vdm-"): model.by_rule for name, model in surface.items()}
    assert rules == {name: tuple(Parameters.from_tissue(1.0, body, name).moduli()) for name in rules}
    assert {name.removeprefix("vdm-") for name, m in surface.items() if not m.fibres} == set(
        vdm.material.ISOTROPIC
    )
    assert models.find("mass-spring")[0].most_nodes == vdm.peers.mass_spring.MAX_NODES


def test_make_installs_the_libraries_that_an_error_names() -> None:
    """`make` looks for them before there is a Python environment to ask."""
    makefile = (ROOT / "Makefile").read_text()
    assert tuple(re.findall(r'"lib[^"]+\.so\.\d+": "([^"]+)"', makefile)) == LIBRARIES


def test_what_is_required_is_pinned() -> None:
    pinned = set(
        re.findall(r"^([A-Za-z0-9_.-]+)==", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE)
    )
    normal = {name.lower().replace("_", "-") for name in pinned}
    wanted = re.findall(r'^ +"([A-Za-z0-9-]+)>=', (ROOT / "pyproject.toml").read_text(), flags=re.MULTILINE)
    assert len(wanted) > 15
    assert {name.lower() for name in wanted} <= normal
