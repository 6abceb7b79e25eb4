"""`vdmbench audit`: bars of a study tried by one more mesh level."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import strict_json
from tests.unit.report_runs import make_case
from vdmbench.body.surface_measures import Surface
from vdmbench.cli import verb_audit
from vdmbench.cli.arguments import parse
from vdmbench.cli.output import WIDTH
from vdmbench.evidence import audit
from vdmbench.evidence.audit import Audited, AuditError, Bar, extrapolated, held, hold
from vdmbench.measures.metrics import DEFORMATION, VECTOR

BLOCK = """
[study]
name = "block"
title = "A coarse block under a finger"
models = ["vdm-consistent", "fem-linear"]
reference = "fem-linear"

[geometry]
shape = "box"
size = ["80 mm", "80 mm", "40 mm"]
mesh_size = "20 mm"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.49

[regions.table]
below = { axis = "z", value = "-20 mm" }
[regions.finger]
ball = { center = [0, 0, "20 mm"], radius = "30 mm" }

[[constraints]]
kind = "fixed"
region = "table"
[[constraints]]
name = "finger"
kind = "contact"
region = "finger"
force = "0.1 N"

[uncertainty]
levels = 2
"""


@pytest.mark.parametrize("order", [1.0, 2.0])
@pytest.mark.parametrize("ratio", [2.0, 4.0])
def test_the_best_estimate_is_the_limit_of_the_levels(order: float, ratio: float) -> None:
    """Levels u + h^p e have the limit u, whichever level is missing between the first two."""
    case = make_case({})
    result = case.models["fem-linear"]
    e = 1e-4 * np.random.default_rng(1).standard_normal(result.displacement.shape)
    levels = [
        dataclasses.replace(result, displacement=result.displacement + h**order * e)
        for h in (0.2 * ratio, 0.2, 0.1)
    ]
    found, best = extrapolated(Surface(case.points, case.triangles), levels, case.load_factors, ratio)
    # rounding: the differences are a millionth of what they are differences of
    assert_allclose(found, order, rtol=1e-6, atol=0)
    assert_allclose(best.displacement, result.displacement, rtol=0, atol=1e-12)


def test_the_answer_asks_for_95_percent_of_the_two_errors() -> None:
    def case(misses: int) -> Audited:
        errors = [Bar("m", VECTOR, 0.2, 0.01, 0.22 if k < misses else 0.205) for k in range(20)]
        return Audited("", 1.0, (*errors, Bar("m", "max_nodal_error", 1e-3, 1e-4, 5e-3)))

    assert held([case(1)]) == (19, 21)
    assert hold([case(1)]), "19 of 20; the other measure does not count"
    assert not hold([case(2)])
    assert not hold([]), "nothing tried is no yes"
    assert held([case(0)], [DEFORMATION]) == (0, 0)


def answers(directory: Path) -> set[str]:
    return {path.name for path in (directory / "results/cache/answers").iterdir()}


def test_a_study_is_audited_by_one_more_level(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("block.toml").write_text(BLOCK)
    assert verb_audit.run(parse(["audit", "block.toml", "--jobs", "1"])) == 0
    told = capsys.readouterr().out
    assert max(map(len, told.splitlines())) <= WIDTH
    assert "The bars of 2 mesh levels, tried by 3." in told
    assert "Do the bars hold? Yes: 4 of 4 of the two errors" in told
    for run in ("block", "block-audit"):
        assert (tmp_path / "results/runs" / run / "report.html").exists()
    known = answers(tmp_path)
    assert len(known) == 4, "the two models, and the reference refined once and twice: none of them twice"

    # as if every bar were a thousandth of what it is: what is known is not solved again, and none holds
    real = audit.value_bar
    monkeypatch.setattr(audit, "value_bar", lambda *asked: 1e-3 * real(*asked))
    assert verb_audit.run(parse(["audit", "block.toml", "--jobs", "1"])) == 1
    told = capsys.readouterr().out
    assert "Do the bars hold? No: 0 of 4 of the two errors" in told
    assert "does not hold: vdm-consistent" in told
    assert max(map(len, told.splitlines())) <= WIDTH
    monkeypatch.setattr(audit, "value_bar", real)
    assert verb_audit.run(parse(["audit", "block.toml", "--json"])) == 0
    data: dict[str, Any] = strict_json(capsys.readouterr().out)
    assert data["levels"] == [2, 3]
    assert data["errors"] == {"held": 4, "of": 4}
    assert answers(tmp_path) == known
    ((own,),) = (
        [bar for bar in case["bars"] if (bar["model"], bar["metric"]) == ("fem-linear", VECTOR)]
        for case in data["cases"]
    )
    assert own["best"] > own["value"] > 0, "the finer reference is further from the study's own mesh"
    assert_allclose(own["used"], (own["best"] - own["value"]) / own["bar"], rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("levels", "told"),
    [("", "the study has no bars"), ("[uncertainty]\nlevels = 4\n", "4 mesh levels, the most there are")],
)
def test_what_cannot_be_audited_is_refused_before_anything_is_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, levels: str, told: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("block.toml").write_text(BLOCK.replace("[uncertainty]\nlevels = 2\n", levels))
    with pytest.raises(AuditError, match=told):
        verb_audit.run(parse(["audit", "block.toml"]))
    assert not Path("results/runs").exists()
