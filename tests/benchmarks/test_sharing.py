"""The benchmark of sharing on a small study: its numbers agree, and it counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from .sharing import TABLES, measure, table


@pytest.mark.slow
@pytest.mark.parametrize("bar", [False, True])
def test_shared_and_naive_numbers_agree(tmp_path: Path, bar: bool) -> None:
    geometry = TABLES["geometry"] | {"mesh_size": 0.02}
    costs = measure(20, 5, tmp_path, bar=bar, geometry=geometry)
    assert costs.loads == 20
    assert costs.difference <= 1e-12
    assert all(seconds > 0 for seconds in (costs.one, costs.multiples, costs.naive, *costs.others.values()))
    assert len(costs.others) == (0 if bar else 2)
    assert (
        min(costs.further.values()) > -costs.one
    )  # the last is what is left of a difference of two measurements
    assert "20 multiples, each alone" in table(costs)
