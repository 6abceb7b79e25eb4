"""Calibrates every shipped body and tries each fit on all others.

Writes `results/calibrations.md`; to paste into a study, `results/calibrations/<study>.toml`; and all figures,
`results/calibrations/<study>.json`. The studies run in `results/runs`, where what is there is kept.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from typing import Any

from tools import documents
from tools.documents import ROOT, RUNS, finished
from vdmbench.calibrate import Errors, bars_in_percent, in_percent
from vdmbench.verdict.formatting import percent

DOCUMENT = ROOT / "results" / "calibrations.md"
TABLES = ROOT / "results" / "calibrations"
STUDIES = tuple(f"calibrate-{body}" for body in ("sphere", "ellipsoid", "box", "cylinder", "organ"))
HEAD = """# Calibrations of the surface models

Made by `make evidence WHAT=calibrations`. Each shipped study `calibrate-<body>` has twelve loads, fingertips of
different width all over the upper surface: six train, six are held out. A parameter is given as a multiple of its
rule (see `vdm/README.md`); errors are means over the held-out loads, displacement / deformation, against mixed
finite elements whose own error stands beside. "Other bodies": the displacement errors of the fit on their
held-out loads. All this is for E = 5 kPa and nu = 0.4999; `vdmbench new mine --from calibrate-box` writes the
study for another tissue. `results/calibrations/` has the fitted values to paste, and as JSON also a mesh of 0.75
times the size and `vdm-consistent`, which fits as `vdm-paper` does. Both move nodes along normals: no fit takes
them below 72 to 89 % in displacement, which is what the reference itself, moved so, is off.

"""
COLUMNS = ("model", "body", "times its rule", "by rule", "fitted", "reference's own", "other bodies")
LEFT_OUT = "vdm-consistent"


def document(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The whole document; study -> model -> its calibration as `vdmbench calibrate --json` has it."""
    models = [model for model in next(iter(found.values())) if model != LEFT_OUT]
    rows = (_row(model, study, entries[model]) for model in models for study, entries in found.items())
    return HEAD + documents.table(COLUMNS, rows)


def _row(model: str, study: str, entry: Mapping[str, Any]) -> list[str]:
    by_rule, held_out = (Errors(**entry["fit"][part]) for part in ("by_rule", "held_out"))
    there = [errors["vector"] for errors in entry["transfer"].values()]
    return [
        model,
        study.removeprefix("calibrate-"),
        _multiples(entry["fit"]["multiples"]),
        in_percent(by_rule),
        in_percent(held_out),
        bars_in_percent(held_out),
        f"{percent(min(there))} to {percent(max(there))}",
    ]


def _multiples(multiples: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.2g}" for value in multiples.values())


def main(_: str, __: Sequence[str]) -> None:
    """Calibrate all bodies and write what came out.

    Raises
    ------
    RuntimeError
        a study that did not finish.
    """
    TABLES.mkdir(exist_ok=True)
    found = {}
    for study in STUDIES:
        others = [word for other in STUDIES if other != study for word in ("--transfer", other)]
        found[study] = json.loads(finished("calibrate", study, *others, "--json"))[study]
        for suffix in ("toml", "json"):
            shutil.copy(RUNS / study / f"calibration.{suffix}", TABLES / f"{study}.{suffix}")
    DOCUMENT.write_text(document(found))
