"""The accuracy table of the documents: its cheapest row is what the shipped study gives."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tools import accuracy as table
from tools import marked, motion
from vdmbench.study.config import expand, load_study
from vdmbench.study.registry import is_surface


def shown_rows() -> dict[str, list[str]]:
    return {row[0]: row for row in marked.rows(table.DOCUMENT, table.PART)}


@pytest.mark.slow
def test_the_cheapest_row_is_what_its_study_gives(tmp_path: Path) -> None:
    name = table.CHEAPEST
    found = table.row_of(name, cwd=tmp_path)
    shown = shown_rows()[name]
    assert len(found) == len(shown) == len(table.HEAD)
    for column, new, old in zip(table.HEAD, found, shown, strict=True):
        assert re.sub(r"[\d.]+", "0", new) == re.sub(r"[\d.]+", "0", old), f"{column}: {new}, not {old}"
        for a, b in zip(re.findall(r"[\d.]+", new), re.findall(r"[\d.]+", old), strict=True):
            digit = 10.0 ** -len(b.partition(".")[2])
            # one unit of the last digit: a value near a half rounds either way on another machine
            assert_allclose(float(a), float(b), rtol=0.0, atol=1.01 * digit, err_msg=column)


def test_the_table_has_a_row_for_every_study_and_a_column_for_every_model() -> None:
    rows = shown_rows()
    wanted = {body + variant.words for body, variants in table.VARIANTS.items() for variant in variants}
    assert wanted <= set(rows)
    assert all(len(row) == len(table.HEAD) for row in rows.values())
    studies = {path.stem for path in (table.ROOT / "studies" / "cases").glob("accuracy-*.toml")}
    assert studies == {f"accuracy-{body}" for body in table.STUDIES}


def test_writing_keeps_what_was_read() -> None:
    rows = shown_rows()
    assert table.written(rows) in table.DOCUMENT.read_text(encoding="utf-8")


@pytest.mark.parametrize("body", table.VARIANTS)
def test_a_variant_moves_the_patch_inward_or_deepens_the_bed_and_leaves_the_rest(body: str) -> None:
    study = f"accuracy-{body}"
    own = [case.study for case in expand(load_study(table.CASES / f"{study}.toml"))]
    for variant in table.VARIANTS[body]:
        changed = load_study(table.CASES / f"{study}.toml", changes=[variant.changes(study)])
        cases = [case.study for case in expand(changed)]
        assert len(cases) == len(own)
        for case, as_shipped in zip(cases, own, strict=True):
            (finger,) = (part for part in case.constraints if getattr(part, "name", "") == "finger")
            assert finger.kind == ("constrained" if variant.moved else "contact")
            if variant.moved:
                push = np.array(finger.displacement)
                direction = np.array(case.regions["finger"].cap.direction)
                assert_allclose(np.linalg.norm(push), table.STEP, rtol=1e-9, atol=0)
                assert_allclose(np.cross(push, direction), 0.0, rtol=0, atol=1e-12)
                assert push @ direction < 0.0
            below = case.regions["base"].below
            assert below == as_shipped.regions["base"].below or below.fraction == variant.embedded > 0.0
            beds = [part for part in case.constraints if part.region == "base"]
            assert [bed.kind for bed in beds] == ["elastic" if variant.stiffness else "fixed"]
            assert (beds[0].stiffness or 0.0) == variant.stiffness
            assert beds[0].direction == ("full" if variant.stiffness else None)
            assert (case.geometry, case.tissue) == (as_shipped.geometry, as_shipped.tissue)


def test_the_motion_of_the_reference_is_that_of_the_shipped_studies() -> None:
    """The cheapest row is what a solve gives, and a row is of a study that has elements for a reference."""
    shown = {row[0]: row for row in marked.rows(table.DOCUMENT, motion.PART)}
    studies = {path.stem: load_study(path).study for path in table.CASES.glob("*.toml")}
    with_elements = {name for name, s in studies.items() if s.reference and not is_surface(s.reference)}
    assert set(shown) <= with_elements
    assert {name for name in with_elements if name.startswith(("accuracy", "calibrate"))} <= set(shown)
    floors = [float(shown[f"calibrate-{body}"][2]) for body in table.STUDIES]
    told = (table.ROOT / "results" / "calibrations.md").read_text()
    assert f"{min(floors):.0f} to {max(floors):.0f} % in displacement" in told
    assert motion.row_of(table.CASES / "locking.toml") == shown["locking"]
    assert motion.row_of(table.CASES / "warm-start.toml") is None, "a surface model is its reference"
