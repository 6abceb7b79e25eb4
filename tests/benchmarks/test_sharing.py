"""The benchmark of sharing on a small study: its numbers agree, and it counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from .sharing import TABLES, measure, table


@pytest.mark.slow
@pytest.mark.parametrize("bar", [False, True])
def test_shared_and_naive_numbers_agree(tmp_path: Path, bar: bool) -> None:
    geometry = TABLES["geometry"] | {"mesh_size": 0.02}
    costs = measure(20, 5, tmp_path, rounds=2, bar=bar, geometry=geometry)
    assert costs.loads == 20
    assert costs.difference <= 1e-12
    assert len(costs.rounds) == 2
    assert all(min(seconds.values()) > 0 for seconds in costs.rounds)
    assert len(costs.seconds) == (3 if bar else 5)
    for study in costs.seconds:
        ratio, least, most = costs.ratio(study)
        assert 0 < least <= most
        assert ratio > 0
    # the last is what is left of a difference of two measurements
    assert min(costs.further.values()) > -costs.seconds["one load"]
    assert "20 multiples, each alone" in table(costs)
