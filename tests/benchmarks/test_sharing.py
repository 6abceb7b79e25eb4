"""The benchmark of sharing on a small study: its numbers agree, and it counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from .sharing import TABLES, measure, table


@pytest.mark.slow
def test_shared_and_naive_numbers_agree(tmp_path: Path) -> None:
    geometry = TABLES["geometry"] | {"mesh_size": 0.02}
    costs = measure(20, 5, tmp_path, geometry=geometry)
    assert costs.loads == 20
    assert costs.difference <= 1e-12
    assert all(seconds > 0 for seconds in (costs.one, costs.history, costs.cases, costs.naive))
    assert "20 cases, each alone" in table(costs)
