"""The picture of a study's graph: every node and every need once, what is shared, and many cases as few nodes."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from vdmbench.study.config import expand, load_study
from vdmbench.work.mermaid import MOST_NODES, mermaid
from vdmbench.work.nodes import graph
from vdmbench.work.plan import Plan, make_plan

from .shared_work import plan_of

CASES = Path(__file__).parents[2] / "studies" / "cases"


def quickstart(tmp_path: Path) -> Plan:
    study = load_study(CASES / "quickstart.toml")
    return make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")


def labels(text: str) -> list[str]:
    return re.findall(r'\["?\(?"(.*?)"', text)


def test_the_quickstart_shows_each_node_each_need_and_what_is_shared(tmp_path: Path) -> None:
    plan = quickstart(tmp_path)
    text = mermaid(plan)
    nodes = graph(plan, plan.cases_to_run(), 1, "")
    assert len(labels(text)) == len(nodes) + 1
    assert text.count("-->") == sum(len(node.needs) for node in nodes) + 3
    assert text.count("--> report") == 3
    assert "vdm-paper<br>for 6 cases" in labels(text)
    assert "fem-linear refined<br>poisson_ratio = 0.49<br>for 2 cases" in labels(text)
    assert "mesh of sphere at 9 mm<br>for 6 cases" in labels(text)


def test_many_cases_are_few_nodes_with_their_number(tmp_path: Path) -> None:
    moduli = [3e3 + 100.0 * k for k in range(MOST_NODES)]
    text = mermaid(plan_of(tmp_path, tmp_path, sweep={"tissue.youngs_modulus": moduli}, uncertainty=None))
    assert labels(text) == [
        "mesh of sphere at 22 mm<br>for 24 cases",
        "vdm-vector<br>24 set-ups<br>24 loads<br>for 24 cases",
        "fem-linear<br>24 loads<br>for 24 cases",
        "24 cases",
        "tables and report",
    ]
    assert text.count("-->") == 6


def test_what_is_done_is_not_in_the_picture_and_no_name_ends_a_label(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = plan_of(tmp_path, tmp_path, sweep={}, uncertainty=None)
    named = dataclasses.replace(plan, cases=(dataclasses.replace(plan.cases[0], label='path = a"]<b'),))
    monkeypatch.setattr(Plan, "has", lambda *_: True)
    monkeypatch.setattr(Plan, "missing_meshes", lambda *_: [])
    assert labels(mermaid(named)) == ["path = a#quot;]#lt;b", "tables and report"]
