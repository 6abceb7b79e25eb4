"""The faults of `make evidence WHAT=mutants` have their places, and tests that are there."""

from __future__ import annotations

import pytest

from tools.mutants import MUTANTS, ROOT, Mutant, changed


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.old[:30])
def test_a_fault_has_its_place_and_its_tests(mutant: Mutant) -> None:
    compile(changed((ROOT / mutant.file).read_text(), mutant), mutant.file, "exec")
    assert all((ROOT / test).is_file() for test in mutant.tests.split())


def test_there_are_forty() -> None:
    assert len({(mutant.file, mutant.new, mutant.old) for mutant in MUTANTS}) == 40
