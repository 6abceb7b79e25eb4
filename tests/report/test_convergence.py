"""The report's section on mesh convergence, on runs whose order and limit are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.report.runs import make_case, make_run
from vdmbench.measures.case import CaseResult, MetricSeries
from vdmbench.report.blocks import Figures, Section, Table
from vdmbench.report.section_convergence import mesh_convergence
from vdmbench.verdict.digest import Digest

SIZES = (0.016, 0.008, 0.004)


def case(size: float, works: dict[str, float], **swept: float) -> CaseResult:
    """A case whose models do this work at the last of four steps, another amount before."""
    made = make_case(
        {"vdm-paper": 0.6, "vdm-vector": 0.2},
        label=f"h = {size}",
        swept={"geometry.mesh_size": size, **swept},
        units={"geometry.mesh_size": "m"},
        subdivisions=0,
    )
    series = {name: MetricSeries(np.array([9.0, 9.0, 9.0, w]), "J", "work", 1) for name, w in works.items()}
    metrics = {name: {**made.metrics[name], "contact_work": series[name]} for name in series}
    return dataclasses.replace(made, metrics=metrics)


def works(h: float) -> dict[str, float]:
    """The reference tends to 2 mJ and the vector form to 2.5 mJ with order 2; the paper's doubles each time."""
    return {
        "vdm-paper": 1e-3 * 0.016 / h,
        "vdm-vector": 2.5e-3 - 4.0 * h**2,
        "fem-linear": 2e-3 - 2.0 * h**2,
    }


@pytest.fixture(scope="module")
def section() -> Section:
    found = mesh_convergence(Digest(make_run([case(h, works(h)) for h in SIZES])))
    assert found is not None
    return found


def test_table_has_order_limit_and_bar(section: Section) -> None:
    table = next(block for block in section.blocks if isinstance(block, Table))
    assert [c.detail for c in table.columns[1:4]] == ["16.0 mm", "8.00 mm", "4.00 mm"]
    rows = {row[0].text: row[1:] for row in table.rows}
    *_, order, limit, against = rows["vdm-vector"]
    assert order.text == "2"
    assert limit.text == "2.50 mJ"
    # error of the finest mesh 4 h^2 = 64 uJ, times 1.25
    assert limit.detail == "± 80.0 µJ"
    # limits 2.5 and 2: 25 % apart; bars 80 and 40 uJ of 2 mJ
    assert against.text == "+25.0 %"
    assert against.detail == "± 6.00 %\nunresolved"
    *values, order, limit, against = rows["vdm-paper"]
    assert [cell.text for cell in values] == ["1.00 mJ", "2.00 mJ", "4.00 mJ"]
    assert (limit.text, limit.tone, limit.value) == ("diverging", "bad", None)
    # three times the largest difference between meshes
    assert limit.detail == "± 9.00 mJ"
    assert order.text == "–"
    assert against.text == rows["fem-linear"][-1].text == "–"


def test_figure_shows_shares_of_the_reference_limit(section: Section) -> None:
    figure = next(block for block in section.blocks if isinstance(block, Figures)).figures[0]
    assert "vdm-paper from 50 % to 200 %" in figure.svg
    assert "vdm-vector from 74 % to 122 %" in figure.svg


def test_nothing_is_told_across_a_change_of_scheme() -> None:
    cases = []
    for h, scheme in zip(SIZES, ("dense", "dense", "skin on 800 nodes"), strict=True):
        made = case(h, works(h))
        vector = dataclasses.replace(made.models["vdm-vector"], parameters={"scheme": scheme})
        cases.append(dataclasses.replace(made, models={**made.models, "vdm-vector": vector}))
    section = mesh_convergence(Digest(make_run(cases)))
    assert section is not None
    table = next(block for block in section.blocks if isinstance(block, Table))
    *works_at, order, limit = next(row for row in table.rows if row[0].text == "vdm-vector")[1:]
    assert [cell.text for cell in works_at] == ["1.48 mJ", "2.24 mJ", "2.44 mJ"]
    assert [cell.text for cell in (order, limit)] == ["–", "another scheme"]
    assert limit.detail == ""
    assert limit.value is None


def test_only_a_sweep_of_the_mesh_size_is_read_so() -> None:
    two = [case(h, works(h)) for h in SIZES[:2]]
    assert mesh_convergence(Digest(make_run(two))) is None, "two meshes show no order"
    both = [case(h, works(h), **{"tissue.poisson_ratio": 0.4 + h}) for h in SIZES]
    assert mesh_convergence(Digest(make_run(both))) is None, "something else changes too"
