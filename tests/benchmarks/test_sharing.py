"""The benchmark of sharing on a small study: its numbers agree, and it counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from .sharing import TABLES, measure, table


@pytest.mark.slow
def test_shared_and_naive_numbers_agree(tmp_path: Path) -> None:
    geometry = TABLES["geometry"] | {"mesh_size": 0.02}
    costs = measure(20, 5, tmp_path, geometry=geometry, uncertainty={"levels": 2})
    assert costs.loads == 20
    assert costs.difference <= 1e-12
    ways = (costs.one, costs.history, costs.multiples, costs.cases, costs.naive)
    assert all(seconds > 0 for seconds in ways)
    assert (
        min(costs.further.values()) > -costs.one
    )  # the last is what is left of a difference of two measurements
    assert "20 multiples, each alone" in table(costs)
