"""The table of exact answers: its coarsest meshes are what a solve gives; the errors fall as the method says."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose

from tools import anchors as table
from tools import marked


@pytest.mark.parametrize(
    "anchor", table.ANCHORS, ids=lambda anchor: f"{anchor.name}, {anchor.poisson_ratio:g}"
)
def test_the_coarsest_mesh_of_an_anchor_gives_its_row(anchor: table.Anchor) -> None:
    nodes, error = table.errors(anchor, anchor.meshes[0])
    key = [anchor.name, f"{anchor.poisson_ratio:g}", str(nodes)]
    (row,) = (row for row in marked.rows(table.DOCUMENT, table.PART) if row[:3] == key)
    for found, shown in zip(error, (row[3], row[5]), strict=True):
        # two digits
        assert_allclose(100.0 * found, [float(part) for part in shown.split(" / ")], rtol=0.05, atol=0)


def test_every_anchor_has_three_meshes_and_second_order_in_the_form() -> None:
    rows = marked.rows(table.DOCUMENT, table.PART)
    for anchor in table.ANCHORS:
        own = [row for row in rows if row[:2] == [anchor.name, f"{anchor.poisson_ratio:g}"]]
        assert len(own) == len(anchor.meshes) == 3
        orders = [float(part) for row in own[1:] for part in row[4].split(" / ")]
        assert min(orders) > 1.8
