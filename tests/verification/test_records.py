"""The records of the verification and the stored table that is made from them."""

import pandas as pd
import pytest

from tests.verification.records import COLUMNS, RESULTS, document

pytest_plugins = ["pytester"]

RECORDING = """
import pytest
from tests.verification.records import Verified

@pytest.mark.anchor("a ball", "a book")
def test_right(verified: Verified) -> None:
    verified.equal("radius", 2.0001, 2.0, atol=1e-3)
    verified.at_most("rounding", 1e-13, 1e-10)

@pytest.mark.anchor("a ball", "a book")
def test_wrong(verified: Verified) -> None:
    verified.at_most("mass", [0.1, -0.3], 0.2)

@pytest.mark.anchor("a ball", "a book")
def test_silent(verified: Verified) -> None:
    pass
"""


def test_tests_assert_on_their_records(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(RECORDING)
    result = pytester.runpytest("-p", "tests.verification.records", "--verification")
    result.assert_outcomes(passed=2, failed=1, errors=1)
    result.stdout.fnmatch_lines(
        [
            "*test_silent*",
            "*hands it a number*",
            "FAIL  a ball, mass: 0.3, expected 0 ± 0.2",
            "2 of 3 checks pass",
            "results/verification.md is left as it was: some of its tests were left out",
        ]
    )


def test_the_stored_table_is_whole_and_passes() -> None:
    rows = pd.read_csv(RESULTS / "verification.csv", dtype=str)
    assert list(rows.columns) == COLUMNS
    assert (RESULTS / "verification.md").read_text(encoding="utf-8") == document(rows)
    assert set(rows["passes"]) == {"yes"}
    assert not rows.duplicated(["name", "quantity", "short"]).any(), "every check has a name of its own"
    assert len(rows) > 400
    assert not rows.isna().any(axis=None)
