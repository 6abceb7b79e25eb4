"""The benchmark runs and prints one whole table; how fast anything is, no test says."""

from __future__ import annotations

import re

import pytest

from tools import marked, vdm_speed
from tools.vdm_speed import HEAD, PART, README, README_HEAD, Sizes, report


def kind(what: str) -> str:
    """A line's name without the numbers in it, which depend on the size."""
    without = re.sub(r", [\d.e+]+ (iterations|GB at its peak)", "", what)
    return re.sub(r"[\d.e+]+ nodes", "nodes", without).strip()


def test_a_small_benchmark_prints_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vdm_speed, "MEMORY_BYTES", 1_000_000)
    small = Sizes(levels=2, fine_levels=2, tori=((12, 8),), contact=5, repeats=3, slow_repeats=2)
    lines = list(report(small))
    table = [line for line in lines if line.startswith("|")]
    assert lines[-len(table) :] == table
    assert {line.count("|") for line in table} == {len(HEAD) + 1}
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]
    assert sum(row[0].startswith("set-up") for row in rows) == 8
    assert all(float(row[4]) > 0.0 for row in rows)
    for part in ("BiCG as printed, warm", "BiCG as printed, cold"):
        assert sum(re.match(rf"{part}, [\d.e+]+ iterations, paper", row[0]) is not None for row in rows) == 1
    counts = {"quasi-linear step": 3, "warm nonlinear step": 2, "local contact": 8, "of it the rule": 6}
    for part, count in counts.items():
        assert sum(row[0].startswith(part) for row in rows) == count, part
    for row in rows:
        assert re.fullmatch(r"[\d.e+-]+ m?s", row[2]), row
        # the ratios of the linear solves: positive numbers
        assert all(float(cell) > 0.0 for cell in row[4:6] if cell), row
    # the README shows lines of the same kinds, of the full size
    head, *written = marked.cells(marked.shown(README, PART))
    assert tuple(head) == README_HEAD
    assert {kind(cells[0]) for cells in written} == {kind(row[0]) for row in rows}
    assert all(float(cells[3]) > 0.0 for cells in written)
    solves = [row for row in rows if "triangular" in row[0]]
    assert len(solves) == 6
    assert all(row[4] and row[5] for row in solves)
