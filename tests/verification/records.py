"""The records of the verification: what was checked, against what, how well. Tests assert on them.

A test that carries `@pytest.mark.anchor(name, source)` asks for the fixture `verified` and hands it numbers; each
becomes a record that passes or fails the test. `pytest --verification`, which `make verify` runs, prints those
that fail and, where no recording test was left out, stores all in `results/verification.csv`, and a line for each
anchor in `results/verification.md`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

RESULTS = Path(__file__).parents[2] / "results"
ROUNDING = 1e-6  # an error with a limit up to this is rounding: its digits depend on the machine
_NOTE = """# Verification

Made by `make verify`. A check passes where its value is within the tolerance of what is expected; an error is
expected to be 0. `results/verification.csv` has every check with its numbers, and whether `make test` runs it too.
An error that is rounding is shown there by its limit. This is verification of both codes, no validation by
experiment.

"""


@dataclass(frozen=True)
class Record:
    """One check.

    Attributes
    ----------
    name : the anchor
    quantity : what of it
    value, expected : the numbers compared
    tolerance : largest |value - expected| that passes
    source : where the expected value comes from
    short : whether the short half of the suite holds it
    """

    name: str
    quantity: str
    value: float
    expected: float
    tolerance: float
    source: str
    short: bool

    @property
    def passes(self) -> bool:
        return bool(abs(self.value - self.expected) <= self.tolerance)

    def row(self) -> dict[str, str]:
        """The record as it is stored: no digits that depend on the machine."""
        if self.expected == 0.0:
            rounding = self.tolerance <= ROUNDING and self.passes
            value = f"< {self.tolerance:.3g}" if rounding else f"{self.value:.3g}"
        else:
            fine = self.tolerance <= 1e-2 * abs(self.expected)
            value = f"{self.value:.6g}" if fine else f"{self.value:.3g}"
        return {
            "name": self.name,
            "quantity": self.quantity,
            "value": value,
            "expected": f"{self.expected:.6g}",
            "tolerance": f"{self.tolerance:.2g}",
            "source": self.source,
            "short": "yes" if self.short else "no",
            "passes": "yes" if self.passes else "no",
        }


class Verified:
    """Takes the numbers of one test."""

    def __init__(self, name: str, source: str, *, short: bool, records: list[Record]) -> None:
        self._name, self._source, self._short, self._records = name, source, short, records

    def equal(
        self, quantity: str, value: float, expected: float, *, rtol: float = 0.0, atol: float = 0.0
    ) -> None:
        """Assert |value - expected| <= rtol |expected| + atol, and record it."""
        tolerance = rtol * abs(expected) + atol
        numbers = float(value), float(expected), float(tolerance)
        record = Record(self._name, quantity, *numbers, self._source, self._short)
        self._records.append(record)
        assert record.passes, (
            f"{self._name}, {quantity}: {value:.10g} is not {expected:.10g} ± {tolerance:.2g}"
        )

    def at_most(self, quantity: str, error: float | np.ndarray, limit: float) -> None:
        """Assert that an error, the largest of an array, is at most `limit` in size, and record it."""
        self.equal(quantity, float(np.abs(error).max()), 0.0, atol=limit)


COLUMNS = ["name", "quantity", "value", "expected", "tolerance", "passes", "short", "source"]


def table_of(records: Sequence[Record]) -> pd.DataFrame:
    """A row for each record as it is stored, the anchors in the order of their first appearance."""
    found = pd.DataFrame([record.row() for record in records], columns=COLUMNS)
    return pd.concat([own for _, own in found.groupby("name", sort=False)])


def document(found: pd.DataFrame) -> str:
    """The whole of `results/verification.md`: a line for each anchor."""
    lines = ["| anchor | checks | held against |", "| --- | --- | --- |"]
    for name, own in found.groupby("name", sort=False):
        right = (own["passes"] == "yes").sum()
        count = str(right) if right == len(own) else f"**{right} of {len(own)} pass**"
        lines.append(f"| {name} | {count} | {'; '.join(own['source'].unique())} |")
    return (
        f"{_NOTE}{(found['passes'] == 'yes').sum()} of {len(found)} checks pass.\n\n"
        + "\n".join(lines)
        + "\n"
    )


# ---------------------------------------------------------------- pytest's side


class Plugin:
    """What one session has recorded."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self.left_out = 0

    def pytest_deselected(self, items: Sequence[pytest.Item]) -> None:
        self.left_out += sum("verified" in getattr(item, "fixturenames", ()) for item in items)

    def pytest_terminal_summary(
        self, terminalreporter: pytest.TerminalReporter, config: pytest.Config
    ) -> None:
        if not (self.records and config.getoption("verification")):
            return
        write = terminalreporter.write_line
        terminalreporter.section("verification")
        failed = [record.row() for record in self.records if not record.passes]
        for row in failed:
            write("FAIL  {name}, {quantity}: {value}, expected {expected} ± {tolerance}".format(**row))
        write(f"{len(self.records) - len(failed)} of {len(self.records)} checks pass")
        if self.left_out or config.args != config.getini("testpaths"):
            write("results/verification.md is left as it was: some of its tests were left out")
            return
        found = table_of(self.records)
        (RESULTS / "verification.md").write_text(document(found), encoding="utf-8")
        found.to_csv(RESULTS / "verification.csv", index=False)
        write("stored in results/verification.md and results/verification.csv")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--verification",
        action="store_true",
        help="count the verification records; store them if whole",
    )


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "anchor(name, source): what the test's records are about")
    config.pluginmanager.register(Plugin(), "verification-records")


@pytest.fixture
def verified(request: pytest.FixtureRequest) -> Iterator[Verified]:
    """Takes the numbers of a test that carries the marker `anchor`; one that gives none fails."""
    marker = request.node.get_closest_marker("anchor")
    assert marker is not None, "mark the test with @pytest.mark.anchor(name, source)"
    plugin = request.config.pluginmanager.getplugin("verification-records")
    assert isinstance(plugin, Plugin)
    before = len(plugin.records)
    short = request.node.get_closest_marker("slow") is None
    yield Verified(*marker.args, short=short, records=plugin.records)
    assert len(plugin.records) > before, "a test with the fixture `verified` hands it a number"
