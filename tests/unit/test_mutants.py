"""The faults of `make evidence WHAT=mutants` have their places, and tests that are there."""

from __future__ import annotations

import pytest

from tools import marked
from tools.mutants import DOCUMENT, MUTANTS, PART, SURVIVES, Mutant, caught_of, changed, table_of
from tools.runs import ROOT


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.old[:30])
def test_a_fault_has_its_place_and_its_tests(mutant: Mutant) -> None:
    compile(changed((ROOT / mutant.file).read_text(), mutant), mutant.file, "exec")
    assert all((ROOT / test).is_file() for test in mutant.tests.split())


def test_there_are_forty() -> None:
    assert len({(mutant.file, mutant.new, mutant.old) for mutant in MUTANTS}) == 40


def test_the_page_is_of_these_faults_and_names_tests_that_are_there() -> None:
    text = marked.shown(DOCUMENT, PART)
    caught = caught_of(text)
    assert table_of(caught) == text, "a fault has changed: make evidence WHAT=mutants"
    for test in caught.values():
        path, _, name = test.partition("::")
        assert f"def {name}(" in (ROOT / path).read_text(), "a fault survives, or its test is gone"


def test_rows_that_are_not_tried_again_stay() -> None:
    first, second = MUTANTS[:2]
    told = table_of({first: "a test", second: SURVIVES})
    assert "1 of 2 are caught" in told
    assert caught_of(told) == {first: "a test", second: SURVIVES}
    assert caught_of(told.replace(f"`{first.new}`", "`another fault`")) == {second: SURVIVES}
