"""The frame: one long table of a run. Its values: `tests/store/test_study_tables.py`."""

from tests.report.runs import sweep_run
from vdmbench.measures.case import Run
from vdmbench.measures.frame import COLUMNS, COSTS, at_full_load, frame


def test_the_frame_has_metrics_costs_and_families() -> None:
    run = sweep_run()
    table = frame(run)
    case = run.cases[-1]
    own = table[(table["case"] == case.hash) & (table["model"] == "vdm-paper")]
    assert set(own["metric"]) == set(case.metrics["vdm-paper"]) | set(COSTS)
    assert set(own["family"]) == {"vdm-printed"}
    assert list(table["family"].cat.categories)[:3] == ["vdm-printed", "vdm-derived", "surface-peers"]
    full = at_full_load(table)
    assert len(full) == len(table) // len(case.load_factors)
    errors = full[(full["metric"] == "relative_l2_displacement_error") & (full["model"] == "vdm-vector")]
    assert len(errors) == len(run.cases)
    assert errors["bar"].between(0.001, 0.1).all()


def test_a_run_without_a_case_has_an_empty_frame() -> None:
    table = frame(Run({}, "", [], [], [], {}))
    assert list(table.columns) == list(COLUMNS)
    assert at_full_load(table).empty
    assert table["family"].cat.categories[0] == "vdm-printed"
