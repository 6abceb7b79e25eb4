"""The accuracy table of `vdm/README.md`: its cheapest row is what the shipped study gives."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from tools import accuracy as table


@pytest.mark.slow
def test_the_cheapest_row_is_what_its_study_gives(tmp_path: Path) -> None:
    name = table.CHEAPEST
    found = table.row_of(f"accuracy-{name}", tmp_path, name)
    shown = table.rows_in_readme()[name]
    assert len(found) == len(shown) == len(table.HEAD)
    for column, new, old in zip(table.HEAD, found, shown, strict=True):
        assert re.sub(r"[\d.]+", "0", new) == re.sub(r"[\d.]+", "0", old), f"{column}: {new}, not {old}"
        for a, b in zip(re.findall(r"[\d.]+", new), re.findall(r"[\d.]+", old), strict=True):
            digit = 10.0 ** -len(b.partition(".")[2])
            # one unit of the last digit: a value near a half rounds either way on another machine
            assert_allclose(float(a), float(b), rtol=0.0, atol=1.01 * digit, err_msg=column)


def test_the_table_has_a_row_for_every_study_and_a_column_for_every_model() -> None:
    rows = table.rows_in_readme()
    assert set(table.STUDIES) <= set(rows)
    assert all(len(row) == len(table.HEAD) for row in rows.values())
    studies = {path.stem for path in (table.ROOT / "studies" / "cases").glob("accuracy-*.toml")}
    assert studies == {f"accuracy-{body}" for body in table.STUDIES}


def test_writing_keeps_what_was_read() -> None:
    rows = table.rows_in_readme()
    assert table.written(rows) in table.README.read_text(encoding="utf-8")
