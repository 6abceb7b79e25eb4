"""Runs the shipped phantoms, fits their modulus, and writes what came out to `docs/evidence/measured.md`.

The studies run in `results/runs`, where what is there already is kept. About ten minutes of an idle core.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.command import vdmbench_process as vdmbench
from tools import marked
from vdmbench.report.blocks import Table
from vdmbench.report.section_measurement import against_measurement
from vdmbench.store.cases import Run, read_run
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.formatting import NOTHING, percent, quantity

ROOT = Path(__file__).parents[1]
DOCUMENT = ROOT / "docs" / "evidence" / "measured.md"
STUDIES = ("phantom-beam", "phantom-cylinder")
HEAD = ["model", "within u_val", "rms of E", "of rms of D", "remains", "per frame", "set-up"]
FIT_HEAD = ["model", "E fitted", "± by u_D", "rms of E, fitted", "rms of E, held out", "with the study's E"]


def table(run: Run) -> str:
    """The summary of a run against its measurement, as its page has it, with the time of a set-up."""
    section = against_measurement(Digest(run))
    if section is None:
        raise RuntimeError("the run has no measurement")
    summary = next(block for block in section.blocks if isinstance(block, Table))
    (case,) = run.cases
    rows = []
    for row in summary.rows:
        model = case.models.get(row[0].text)
        rows.append([*(cell.text for cell in row), quantity(model.seconds_setup, "s") if model else NOTHING])
    return marked.table(HEAD, rows)


def fits(found: list[dict[str, Any]]) -> str:
    """What `calibrate --measured --json` printed, as a table."""

    def length(one: dict[str, Any], key: str) -> str:
        return NOTHING if one[key] is None else quantity(one[key], "m")

    rows = [
        [
            one["model"],
            "none in range" if one["modulus"] is None else quantity(one["modulus"], "Pa"),
            NOTHING if one["uncertainty"] is None else percent(one["uncertainty"] / one["modulus"]),
            *(length(one, key) for key in ("trained", "held_out", "as_given")),
        ]
        for one in found
    ]
    return marked.table(FIT_HEAD, rows)


def _done(*arguments: str) -> str:
    result = vdmbench(*arguments, cwd=ROOT, seconds=7200)
    if result.returncode:
        raise RuntimeError(result.stderr)
    return result.stdout


def main() -> None:
    """Run and fit both, and write the page's tables."""
    for study in STUDIES:
        _done("run", study)
        marked.show(DOCUMENT, study, table(read_run(ROOT / "results" / "runs" / study)))
        fitted = json.loads(_done("calibrate", study, "--measured", "--json"))
        marked.show(DOCUMENT, f"{study}-fit", fits(fitted))


if __name__ == "__main__":
    main()
