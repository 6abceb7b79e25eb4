"""A sweep of Young's modulus: one factor for all of them, and the numbers of the long way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from numpy.testing import assert_allclose

from fem_reference import linear
from tests.in_process import do_cases
from vdmbench import models
from vdmbench.body.mesh_cache import mesh_path, read_mesh
from vdmbench.scene.scene import build_scene
from vdmbench.store.cases import read_case
from vdmbench.study.config import expand
from vdmbench.study.schema import Study
from vdmbench.work.plan import Plan, make_plan
from vdmbench.work.tasks import bodies

MODULI = [2000.0, 5000.0, 11000.0]
BASE: dict[str, Any] = {
    "study": {"name": "test", "models": ["fem-linear", "fem-p1"]},
    "geometry": {"shape": "box", "size": [0.06, 0.03, 0.03], "mesh_size": 0.015},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.45},
    "regions": {
        "clamp": {"below": {"axis": "x", "fraction": 0.001}},
        "end": {"above": {"axis": "x", "fraction": 0.999}},
        "top": {"box": {"min": [-0.02, -0.02, 0.0149], "max": [0.02, 0.02, 0.0151]}},
    },
    "constraints": [
        {"kind": "fixed", "region": "clamp"},
        {"kind": "constrained", "region": "end", "displacement": [0.0, 0.0, -0.001]},
        {"kind": "contact", "region": "top", "pressure": 50.0},
    ],
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "load": {"factors": [0.5, 1.0]},
    "sweep": {"tissue.youngs_modulus": MODULI},
}


def plan_of(directory: Path, **tables: Any) -> Plan:
    study = Study.model_validate({key: value for key, value in (BASE | tables).items() if value is not None})
    return make_plan(study, expand(study), directory / "run", directory / "cache")


@pytest.mark.parametrize(
    "tables",
    [
        {},
        {"gravity": None},
        {"anisotropy": {"fibre_direction": [1.0, 0.0, 1.0], "contrast": 3.0}},
    ],
    ids=["weight", "no weight", "fibres"],
)
def test_one_factor_gives_the_numbers_of_the_long_way(
    tables: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    set_up = linear.LinearProblem.__init__

    def counted(self: linear.LinearProblem, *given: Any, **options: Any) -> None:
        made.append(options["element"])
        set_up(self, *given, **options)

    plan = plan_of(tmp_path, **tables)
    monkeypatch.setattr(linear.LinearProblem, "__init__", counted)
    do_cases(plan)
    assert sorted(made) == ["P1", "P2-P1"], "each is set up once"
    mesh = read_mesh(mesh_path(plan.cache, plan.cases[0].mesh))
    assert mesh is not None
    for case, modulus in zip(plan.cases, MODULI, strict=True):
        found = read_case(plan.case_file(case))
        assert case.study.tissue.youngs_modulus == modulus
        for name in ("fem-linear", "fem-p1"):
            shared, alone = found.models[name], models.run_model(build_scene(case.study, mesh), name)
            assert shared.parameters["youngs_modulus"] == modulus
            for field in ("displacement", "reaction_force", "fluid_pressure", "energy"):
                value = getattr(alone, field)
                assert_allclose(
                    getattr(shared, field), value, rtol=0, atol=1e-12 * abs(value).max(), err_msg=field
                )


def test_what_does_not_scale_has_a_factor_for_each(tmp_path: Path) -> None:
    """Springs and inclusions keep their own moduli; another Poisson's ratio is another body."""
    springs = {"kind": "elastic", "region": "top", "stiffness": 1e5}
    inside = {"name": "lump", "ball": {"center": [0, 0, 0], "radius": 0.01}, "youngs_modulus": 5e4}
    ratios = {"tissue.poisson_ratio": [0.3, 0.4, 0.45]}
    fixed = BASE["constraints"][:1]
    elements = {"name": "test", "models": ["fem-linear"]}
    surface = {"name": "test", "models": ["vdm-consistent"]}
    for tables, wanted in (
        ({"study": elements}, 1),
        ({"study": elements, "sweep": ratios}, 3),
        ({"study": elements, "constraints": [*fixed, springs, BASE["constraints"][1]]}, 3),
        ({"study": elements, "inclusions": [inside]}, 3),
        ({"study": surface}, 3),
    ):
        plan = plan_of(tmp_path, **tables)
        assert len(bodies(plan, plan.cases)) == wanted, tables
