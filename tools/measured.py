"""Runs the shipped phantoms, fits their modulus, and writes what came out to `docs/evidence/measured.md`.

The studies run in `results/runs`, where what is there already is kept. Engines of others run beside ours where
they are installed (docs/examples). About ten minutes of an idle core.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

from tools import marked
from tools.runs import ROOT, RUNS, finished
from vdmbench.measures.case import Run
from vdmbench.report.blocks import Table
from vdmbench.report.section_measurement import against_measurement
from vdmbench.store.cases import read_run
from vdmbench.study.config import load_study
from vdmbench.study.files import study_path
from vdmbench.study.registry import all_models, split
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.formatting import NOTHING, percent, quantity

DOCUMENT = ROOT / "docs" / "evidence" / "measured.md"
STUDIES = ("phantom-beam", "phantom-cylinder")
# beside the study's own models; linear answers of others are those of ours
BESIDE = ("bem:nonlinear", "mujoco-flex", "ngsolve-p2p1:nonlinear")
HEAD = [
    *("model", "within u_val", "rms of E", "of rms of D"),
    *("u_num", "u_input", "u_D", "remains", "per frame", "set-up"),
]
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


def with_peers(name: str, folder: Path) -> Path:
    """A shipped study with further models, those that are installed, in a folder of its own."""
    shipped = study_path(name)
    models = [
        *load_study(shipped).study.models,
        *(model for model in BESIDE if split(model)[0] in all_models()),
    ]
    text, found = re.subn(
        r"^models = \[.*?\]", f"models = {json.dumps(models)}", shipped.read_text(), flags=re.M | re.S
    )
    if found != 1:
        raise RuntimeError(f"{shipped} has no list of models")
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(shipped.with_suffix(".csv"), folder)
    path = folder / shipped.name
    path.write_text(text, encoding="utf-8")
    return path


def main() -> None:
    """Run and fit both, and write the page's tables."""
    for study in STUDIES:
        out = RUNS / f"{study}-peers"
        finished("run", with_peers(study, ROOT / "build" / "measured"), "--out", out)
        marked.show(DOCUMENT, study, table(read_run(out)))
        fitted = json.loads(finished("calibrate", study, "--measured", "--json"))
        marked.show(DOCUMENT, f"{study}-fit", fits(fitted))


if __name__ == "__main__":
    main()
