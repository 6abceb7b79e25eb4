"""The table over Poisson's ratios: every load with every ratio and inside, and its sums are sums."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.unit.example_case import example_case
from tools import accuracy, marked, ratios
from vdmbench.measures.case import MetricSeries
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.study.config import expand, load_study


@pytest.mark.parametrize("body", accuracy.STUDIES)
def test_a_body_is_pressed_by_each_of_its_loads_with_every_ratio_and_both_insides(body: str) -> None:
    study = f"accuracy-{body}"
    path = accuracy.CASES / f"{study}.toml"
    loads = [case.study.regions["finger"].cap for case in expand(load_study(path))]
    changed = load_study(path, changes=[ratios.changes(study)])
    cases = [case.study for case in expand(changed)]
    found = [
        (case.tissue.poisson_ratio, case.models[ratios.FORM].compressibility, case.regions["finger"].cap)
        for case in cases
    ]
    assert found == [(*both, cap) for both, cap in product(product(ratios.RATIOS, ratios.INSIDE), loads)]


def test_a_change_of_volume_counts_in_parts_of_what_the_reference_displaces() -> None:
    """The reference loses 2 % of the displaced volume; a model that keeps its own is 2 % off."""
    case = example_case()
    reference, model = str(case.reference), "model"
    values = {
        reference: {"volume_drift": -1e-3, "volume_drift_of_displaced": -0.02},
        model: {VECTOR: 0.3, DEFORMATION: 0.4, "volume_drift": 0.0, "volume_drift_of_displaced": 0.0},
    }
    steps = np.ones(len(case.load_factors))
    metrics = {
        name: {key: MetricSeries(value * steps, "1", "", 1) for key, value in own.items()}
        for name, own in values.items()
    }
    assert_allclose(ratios.errors(replace(case, metrics=metrics), model), (0.3, 0.4, 0.02), rtol=1e-12)


def test_the_last_rows_are_means_of_means_and_worst_of_worst() -> None:
    rows = [
        ["a", str(ratio), "1.0 / 2.0", "4.0", *["1.0 / 2.0 / 3.0 (4.0 / 5.0 / 60)"] * 3]
        for ratio in ratios.RATIOS
    ]
    rows += [
        ["b", str(ratio), "3.0 / 4.0", "2.0", *["3.0 / 2.0 / 5.0 (40 / 1.0 / 6.0)"] * 3]
        for ratio in ratios.RATIOS
    ]
    over = list(ratios.over_bodies(rows))
    assert [row[1] for row in over] == [str(ratio) for ratio in ratios.RATIOS]
    assert over[0][2:] == ["2.0 / 3.0", "3.0", *["2.0 / 2.0 / 4.0 (40 / 5.0 / 60)"] * 3]


def test_the_page_shows_every_body_at_every_ratio_and_its_sums() -> None:
    rows = [row for row in marked.rows(ratios.DOCUMENT, ratios.PART) if row[0] != ratios.ALL]
    assert {(body, str(ratio)) for body, ratio in product(accuracy.STUDIES, ratios.RATIOS)} <= {
        (row[0], row[1]) for row in rows
    }
    assert ratios.written(rows) in accuracy.DOCUMENT.read_text(encoding="utf-8")
    for row in rows:
        if row[1] == "0.4999":
            tissue, fluid = (np.array(re.findall(r"[\d.]+", cell), dtype=float) for cell in row[4:6])
            assert_allclose(tissue, fluid, rtol=0, atol=0.11, err_msg="next to a half both are the fluid")
