"""The benchmark of `vdm` runs and makes one whole table; how fast anything is, no test says."""

from __future__ import annotations

import re

from tools import marked
from tools.vdm_speed import HEAD, PART, README, Sizes, rows_of


def kind(what: str) -> str:
    """A line's name without the numbers in it, which depend on the size."""
    without = re.sub(r", [\d.e+]+ (iterations|GB at its peak)", "", what)
    return re.sub(r"[\d.e+]+ nodes", "nodes", without).strip()


def test_a_small_benchmark_has_the_lines_of_the_readme() -> None:
    small = Sizes(levels=2, fine_levels=2, tori=((12, 8),), contact=5, repeats=3, slow_repeats=2)
    rows = list(rows_of(small))
    for what, _, median, over_bound in rows:
        assert re.fullmatch(r"[\d.e+-]+ m?s", median), what
        assert float(over_bound) > 0.0, what
    counts = {"BiCG as printed": 2, "quasi-linear": 3, "warm nonlinear": 2, "local contact": 8, "set-up": 8}
    for part, count in counts.items():
        assert sum(row[0].startswith(part) for row in rows) == count, part
    head, *written = marked.cells(marked.shown(README, PART))
    assert tuple(head) == HEAD
    assert {kind(cells[0]) for cells in written} == {kind(row[0]) for row in rows}
