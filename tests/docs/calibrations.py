"""Calibrates every shipped body and tries each fit on all others: `make calibrations`.

Writes `results/calibrations.md`; to paste into a study, `results/calibrations/<study>.toml`; and for the test that
fits again, `results/calibrations/<study>.json`. The studies run in `results/runs`, where what is there is kept.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from studies.calibration.calibrate import worse_than_rule
from studies.calibration.fit import Errors
from studies.report.formatting import percent
from tests.command import vdmbench
from tests.docs import marked

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "results" / "calibrations.md"
TABLES = ROOT / "results" / "calibrations"
STUDIES = tuple(f"calibrate-{body}" for body in ("sphere", "ellipsoid", "box", "cylinder", "organ"))
HEAD = """# Calibrations of the surface models

Made by `make calibrations`. Each shipped study `calibrate-<body>` has twelve loads, fingertips of different
width all over the upper surface: six train, six are held out. A parameter is given as a multiple of its rule
(see `vdm/README.md`); errors are the means over the held-out loads, displacement / deformation, against mixed
finite elements whose own error stands beside. "Finer mesh": what a fit on a mesh of 0.75 times the size gives,
and what the coarse mesh's fit leaves there. `results/calibrations/<study>.toml` holds the fitted values, to
paste into a study.
"""


def calibrated(study: str) -> dict[str, Any]:
    """Model -> calibration of one study, tried on all others.

    Raises
    ------
    RuntimeError
        a study that did not finish.
    """
    others = [word for other in STUDIES if other != study for word in ("--transfer", other)]
    result = vdmbench("calibrate", study, *others, "--json", cwd=ROOT, seconds=3600)
    if result.returncode:
        raise RuntimeError(result.stderr)
    found: dict[str, Any] = json.loads(result.stdout)[study]
    TABLES.mkdir(exist_ok=True)
    for suffix in ("toml", "json"):
        shutil.copy(ROOT / "results" / "runs" / study / f"calibration.{suffix}", TABLES / f"{study}.{suffix}")
    return found


def document(found: Mapping[str, Mapping[str, Any]]) -> str:
    """The whole document."""
    text = HEAD
    for model in next(iter(found.values())):
        text += f"\n## {model}\n\n" + _fits({study: entries[model] for study, entries in found.items()})
        text += "\nTransfer, the fit of a row on the held-out loads of a column:\n\n"
        text += _transfer({study: entries[model] for study, entries in found.items()})
        text += f"\n{rule({study: entries[model]['fit']['multiples'] for study, entries in found.items()})}\n"
        text += worse({study: entries[model]["fit"] for study, entries in found.items()})
    return text


def rule(multiples: Mapping[str, Mapping[str, float]]) -> str:
    """Whether one multiple of the rule serves all bodies: the geometric mean of the fits and their spread."""
    parts = []
    for key in next(iter(multiples.values())):
        logs = np.log([entry[key] for entry in multiples.values()])
        spread = math.exp(float(logs.max() - logs.min()))
        parts.append(
            f"`{key}` {math.exp(float(logs.mean())):.2g} times its rule, {spread:.2g} between the extremes"
        )
    return f"One number for all bodies: {'; '.join(parts)}."


def worse(fits: Mapping[str, Any]) -> str:
    """The bodies on whose held-out loads the fit does worse than the rule."""
    told = {
        _body(study): worse_than_rule(Errors(**fit["by_rule"]), Errors(**fit["held_out"]))
        for study, fit in fits.items()
    }
    bodies = [f"{body} ({what})" for body, what in told.items() if what]
    return (
        f"\nWorse than the rule on the loads held out, where the rule may serve better: {'; '.join(bodies)}.\n"
        if bodies
        else ""
    )


def _fits(entries: Mapping[str, Any]) -> str:
    head = [
        "body",
        "times its rule",
        "training",
        "by rule",
        "fitted",
        "reference's own",
        "finer mesh",
        "there",
    ]
    rows = []
    for study, entry in entries.items():
        fit = entry["fit"]
        rows.append(
            [
                _body(study),
                _multiples(fit["multiples"]),
                _errors(fit["training"]),
                _errors(fit["by_rule"]),
                _errors(fit["held_out"]),
                f"± {percent(fit['held_out']['bar'])} / {percent(fit['held_out']['bar_deformation'])}",
                _multiples(entry["finer"]),
                _errors(entry["on_finer"]),
            ]
        )
    return marked.table(head, rows)


def _transfer(entries: Mapping[str, Any]) -> str:
    rows = []
    for study, entry in entries.items():
        tried = {**entry["transfer"], study: entry["fit"]["held_out"]}
        rows.append([_body(study), *(_errors(tried[other]) for other in entries)])
    return marked.table(["fit of", *map(_body, entries)], rows)


def _body(study: str) -> str:
    return study.removeprefix("calibrate-")


def _multiples(multiples: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.2g}" for value in multiples.values())


def _errors(found: Mapping[str, float]) -> str:
    return f"{percent(found['vector'])} / {percent(found['deformation'])}"


def main() -> None:
    """Calibrate all bodies and write what came out."""
    DOCUMENT.write_text(document({study: calibrated(study) for study in STUDIES}))


if __name__ == "__main__":
    main()
