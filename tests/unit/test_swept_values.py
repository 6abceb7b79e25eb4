"""What a plan says of swept values is found again in the inputs that a case's own file holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from vdmbench.store.run_directory import value_at
from vdmbench.study.config import expand, load_study, resolved
from vdmbench.study.folders import swept_without_folders, without_folders

SHIPPED = sorted((Path(__file__).parents[2] / "studies" / "cases").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_swept_value_of_a_shipped_study_is_in_the_inputs_of_its_case(path: Path) -> None:
    for case in expand(load_study(path)):
        inputs = without_folders(resolved(case.study))
        for key, value in swept_without_folders(case.swept).items():
            assert value_at(inputs, key) == value, (case.label, key)


def test_keys_find_tables_names_and_components() -> None:
    inputs = {
        "tissue": {"poisson_ratio": 0.4},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "models": {"vdm-vector:lu": {"penalty": 3.0}},
        "constraints": [{"region": "base"}, {"name": "a.b", "region": "base", "force": 2.0}],
    }
    assert value_at(inputs, "tissue.poisson_ratio") == 0.4
    assert value_at(inputs, "gravity.acceleration.2") == -9.81
    assert value_at(inputs, "models.vdm-vector:lu.penalty") == 3.0
    assert value_at(inputs, "constraints.a.b.force") == 2.0
    for key in ("tissue.poisson", "gravity.acceleration.3", "constraints.base.force", "x"):
        assert value_at(inputs, key) is None
