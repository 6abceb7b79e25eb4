"""The tables of a whole study: load factors and bars as they are, what has no bar left out."""

import csv
import dataclasses
import io
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.report.runs import make_case, make_run
from vdmbench.measures.case import CaseResult
from vdmbench.measures.frame import frame, value_bar
from vdmbench.measures.metrics import METRICS
from vdmbench.measures.uncertainty import INDENTATION_FORCE
from vdmbench.store import cases as store
from vdmbench.store.run_directory import METRICS_FILE
from vdmbench.verdict.digest import Digest

REFINED = "fem-linear refined"
DRIFT = "volume_drift"


def test_the_table_has_every_value_with_its_full_load_bar_and_no_formula() -> None:
    measured = {"levels": 1.0, "gci:relative_l2_displacement_error": 0.0125}
    cases = [
        make_case({"m": 0.1, "=n": 0.2}, label="a", steps=(0.5, 1.0, 0.5), swept={"k": 1e-3}, subdivisions=0),
        make_case(
            {"m": 0.3}, label="b", swept={"=j": "=x", "k": 2.0}, reference_error=measured, subdivisions=0
        ),
    ]
    head, *rows = csv.reader(io.StringIO(store.metrics_csv(frame(make_run(cases)))))
    assert ",".join(head) == "case,k,'=j,model,load_factor,metric,value,unit,reference_error"
    expected = []
    for case, swept in zip(cases, (["0.001", ""], ["2.0", "'=x"]), strict=True):
        for model, metrics in case.metrics.items():
            for metric, entry in metrics.items():
                for step, value in enumerate(entry):
                    bar = value_bar(case, model, metric) if step == case.full_load else math.nan
                    own = repr(bar) if math.isfinite(bar) else ""
                    at = [model.replace("=", "'="), repr(float(case.load_factors[step])), metric]
                    known = repr(float(value)) if math.isfinite(value) else ""
                    expected.append([case.hash[:12], *swept, *at, known, METRICS[metric].unit, own])
    assert rows == expected
    assert {row[-1] for row in rows} == {"", "0.0125"}


def refined_case(levels: float) -> CaseResult:
    """The reference solved on `levels` meshes, of which it answers on the case's own one by 3 % too much."""
    bars = {"levels": levels, "gci:max_nodal_error": 2e-6}
    errors = {"vdm-paper": 0.1, "fem-linear": 0.03}
    return make_case(errors, reference=REFINED, reference_error=bars, subdivisions=0, label="measured")


@pytest.mark.parametrize(("levels", "share"), [(2.0, 1.25), (3.0, 1.25 / 3), (4.0, 1.25 / 7)])
def test_the_table_of_a_run_holds_load_factors_and_bars(tmp_path: Path, levels: float, share: float) -> None:
    """The reference's own drift has a bar of its own: 1.25 |fine - coarse| / (r - 1), r = 2^(levels - 1)."""
    first = refined_case(levels)
    second = make_case({"vdm-paper": 0.1}, reference=REFINED, subdivisions=0, steps=(0.5, -2.0), label="bare")
    store.write_metrics(tmp_path, frame(make_run([first, second])))
    table = pd.read_csv(tmp_path / METRICS_FILE)
    fine, coarse = (first.metrics[name][DRIFT][-1] for name in (REFINED, "fem-linear"))
    assert abs(fine - coarse) > 1e-6
    bars = {
        (REFINED, DRIFT): share * abs(fine - coarse),
        ("vdm-paper", "max_nodal_error"): 2e-6,
        ("fem-linear", "max_nodal_error"): 2e-6,
    }
    found = table.dropna(subset="reference_error").set_index(["model", "metric"])
    assert (found["case"] == first.hash[:12]).all()
    for name, bar in bars.items():
        assert_allclose(found.loc[[name], "reference_error"], [bar], rtol=1e-12, atol=0, err_msg=str(name))
    others = {
        (REFINED, metric) for metric, series in first.metrics[REFINED].items() if np.isfinite(series[-1])
    }
    assert set(found.index) == bars.keys() | others, "what has no number is left out"
    of_second = table[(table["case"] == second.hash[:12]) & (table["model"] == "vdm-paper")]
    assert_array_equal(of_second[of_second["metric"] == "max_nodal_error"]["load_factor"], [0.5, -2.0])


def test_the_bar_of_three_levels_goes_before_one_of_the_outer_two() -> None:
    case = refined_case(1.0)
    three = {**case.reference_error, "levels": 3.0, f"own_gci:{DRIFT}": 0.5}
    case = dataclasses.replace(case, reference_error=three)
    assert value_bar(case, REFINED, DRIFT) == 0.5
    others = [name for name in case.models if name != REFINED]
    assert np.isnan([value_bar(case, name, DRIFT) for name in others]).all()


def test_a_figure_that_two_levels_give_alike_has_the_bar_of_the_displacement() -> None:
    alike = {"levels": 2.0, "gci:relative_l2_displacement_error": 0.02, f"gci:{INDENTATION_FORCE}": 0.0}
    case = dataclasses.replace(refined_case(2.0), reference_error=alike)
    finer, model = dict(case.metrics[REFINED]), dict(case.metrics["vdm-paper"])
    model[INDENTATION_FORCE] = np.full(len(case.load_factors), 0.5)
    case = dataclasses.replace(case, metrics={REFINED: finer, "fem-linear": finer, "vdm-paper": model})
    drift, of_displaced = (finer[name][-1] for name in (DRIFT, "volume_drift_of_displaced"))
    bars = [value_bar(case, REFINED, DRIFT), value_bar(case, "vdm-paper", INDENTATION_FORCE)]
    assert_allclose(bars, [0.02 * abs(drift / of_displaced), 0.02 * 1.5], rtol=1e-12, atol=0)
    spread = Digest(make_run([case])).spread("vdm-paper", INDENTATION_FORCE)
    assert_allclose(spread.bar, 0.02 * 1.5, rtol=1e-12, atol=0)
