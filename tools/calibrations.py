"""Calibrates every shipped body and tries each fit on all others.

Writes `results/calibrations.md`; to paste into a study, `results/calibrations/<study>.toml`; and for the tests,
`results/calibrations/<study>.json` and, of the fits in other tissues, `results/calibrations/tissue.json`. The
studies run in `results/runs`, where what is there is kept.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools import marked
from tools.runs import CASES, ROOT, RUNS, finished
from vdmbench.evidence.calibrate import body, worse_than_rule
from vdmbench.evidence.fit import Errors, Trial, least_error
from vdmbench.evidence.search import WIDEST
from vdmbench.report.rebuild import rebuild
from vdmbench.study.config import expand, load_study
from vdmbench.verdict.formatting import NOTHING, percent
from vdmbench.work.plan import make_plan
from vdmbench.work.run import Options, run_plan

DOCUMENT = ROOT / "results" / "calibrations.md"
TABLES = ROOT / "results" / "calibrations"
TISSUE = TABLES / "tissue.json"
STIFFENED, STIFFER = "calibrate-box", "50 kPa"  # one body: model and reference are linear, and both go with E
POISSON_RATIOS = ("0.3", "0.45", "0.49", "0.4999")  # the last one is that of the shipped studies
ROUNDING = 1e-9  # smaller changes of a multiple depend on the machine
FLAT = 1e-3  # a modulus at a thousandth of its rule no longer matters, and the fit leaves it anywhere below
STUDIES = tuple(f"calibrate-{body}" for body in ("sphere", "ellipsoid", "box", "cylinder", "organ"))
HEAD = """# Calibrations of the surface models

Made by `make evidence WHAT=calibrations`.
Each shipped study `calibrate-<body>` has twelve loads, fingertips of different
width all over the upper surface: six train, six are held out. A parameter is given as a multiple of its rule
(see `vdm/README.md`); errors are the means over the held-out loads, displacement / deformation, against mixed
finite elements whose own error stands beside. "Finer mesh": what a fit on a mesh of 0.75 times the size gives,
and what the coarse mesh's fit leaves there. `results/calibrations/<study>.toml` holds the fitted values, to
paste into a study. All this is for E = 5 kPa and nu = 0.4999; what a fit becomes in another tissue stands in a line
under each model, from fits to elements on the study's own mesh (the tables' are to those on the refined mesh).
`vdm-paper` and `vdm-consistent` move nodes along normals, and no fit can take them below what the reference itself,
moved so, is off: 72 to 89 % in displacement, each study's on [the page on accuracy](../docs/evidence/accuracy.md).
"""


def calibrated(study: str) -> dict[str, Any]:
    """Model -> calibration of one study, tried on all others.

    Raises
    ------
    RuntimeError
        a study that did not finish.
    """
    others = [word for other in STUDIES if other != study for word in ("--transfer", other)]
    found: dict[str, Any] = json.loads(finished("calibrate", study, *others, "--json"))[study]
    TABLES.mkdir(exist_ok=True)
    for suffix in ("toml", "json"):
        shutil.copy(RUNS / study / f"calibration.{suffix}", TABLES / f"{study}.{suffix}")
    return found


def in_tissue(study: str, directory: Path, **tissue: str) -> dict[str, dict[str, float]]:
    """Model -> the multiples of its rule that a shipped study gives in another tissue; works in `directory`.

    The reference is that of the study's own mesh: half the work, and what differs is the tissue alone.
    """
    text = (CASES / f"{study}.toml").read_text()
    text = text.replace("[uncertainty]\nlevels = 2\n", "")
    for key, value in tissue.items():
        text, changed = re.subn(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
        if changed != 1:
            raise RuntimeError(f"{study} has no line of {key}")
    name = "-".join([study, *tissue.values()]).replace('"', "")
    path = directory / f"{name}.toml"
    path.write_text(text)
    loaded = load_study(path)
    plan = make_plan(loaded, expand(loaded), directory / name, directory / "cache")
    run, _ = run_plan(plan, text, Options(jobs=2), lambda _: None, rebuild)
    found = body(plan, run)
    multiples = {}
    for model in found.models:
        trial = Trial(model, found.training)
        multiples[model] = dict(zip(trial.names, least_error(trial).multiples.tolist(), strict=True))
    return multiples


def in_other_tissues() -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """Study -> E or nu -> model -> multiples of the rule: every body at several nu, one at another E."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        found = {
            study: {nu: in_tissue(study, directory, poisson_ratio=nu) for nu in POISSON_RATIOS}
            for study in STUDIES
        }
        found[STIFFENED][STIFFER] = in_tissue(STIFFENED, directory, youngs_modulus=f'"{STIFFER}"')
    return found


def document(found: Mapping[str, Mapping[str, Any]], tissues: Mapping[str, Mapping[str, Any]]) -> str:
    """The whole document."""
    text = HEAD
    for model in next(iter(found.values())):
        text += f"\n## {model}\n\n" + _fits({study: entries[model] for study, entries in found.items()})
        text += "\nTransfer, the fit of a row on the held-out loads of a column:\n\n"
        text += _transfer({study: entries[model] for study, entries in found.items()})
        text += f"\n{rule({study: entries[model]['fit']['multiples'] for study, entries in found.items()})}\n"
        text += worse({study: entries[model]["fit"] for study, entries in found.items()})
        text += f"\n{tissue(model, tissues)}\n"
    return text


def tissue(model: str, tissues: Mapping[str, Mapping[str, Any]]) -> str:
    """How the multiples of a model depend on E and nu."""
    *others, own = POISSON_RATIOS
    here = {study: entries[own][model] for study, entries in tissues.items()}
    parts = []
    for key in next(iter(here.values())):
        bodies = [study for study in here if here[study][key] > FLAT]
        ratios = {
            nu: [tissues[study][nu][model][key] / here[study][key] for study in bodies] for nu in others
        }
        told = ", ".join(f"{_range(values)} at {nu}" for nu, values in ratios.items())
        parts.append(f"`{key}` {told}" + _left_out(len(here) - len(bodies)))
    changes = [
        abs(value / here[STIFFENED][key] - 1.0) for key, value in tissues[STIFFENED][STIFFER][model].items()
    ]
    power = _power_above(max(changes))
    return (
        f"With nu, over its value at {own}, the least and the most of the bodies: {'; '.join(parts)}. "
        f"With E: on the {_body(STIFFENED)} {STIFFER} changes a multiple by less than {power} of it."
    )


def _range(values: Sequence[float]) -> str:
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _left_out(bodies: int) -> str:
    return f" (without {bodies}, where it does not matter)" if bodies else ""


def _power_above(value: float) -> str:
    return f"{10.0 ** math.ceil(math.log10(max(value, ROUNDING))):.0e}"


def rule(multiples: Mapping[str, Mapping[str, float]]) -> str:
    """Whether one multiple of the rule serves all bodies: the geometric mean of the fits and their spread.

    Of two moduli the one may not matter to a body: then its fit stops where the search ends, and says nothing.
    """
    parts = []
    for key in next(iter(multiples.values())):
        ended = [study for study, entry in multiples.items() if _ends_the_search(key, entry)]
        logs = np.log([entry[key] for study, entry in multiples.items() if study not in ended])
        spread = math.exp(float(logs.max() - logs.min()))
        part = f"`{key}` {math.exp(float(logs.mean())):.2g} times its rule, {spread:.2g} between the extremes"
        if ended:
            bodies = " and ".join(map(_body, ended))
            part += (
                f" (without the {bodies}, where it does not matter: the fit ends with the search, at 1e-5)"
            )
        parts.append(part)
    return f"One number for all bodies: {'; '.join(parts)}."


def _ends_the_search(key: str, multiples: Mapping[str, float]) -> bool:
    """Whether the other of two moduli is as many times larger as the search allows."""
    return any(math.log(other / multiples[key]) > WIDEST - 0.01 for other in multiples.values())


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
                *(
                    [_multiples(entry["finer"]), _errors(entry["on_finer"])]
                    if entry["finer"]
                    else [NOTHING] * 2
                ),
            ]
        )
    missing = [
        f"\n{_body(study)}: mesh independence not measured, because {entry['no_finer']}.\n"
        for study, entry in entries.items()
        if not entry["finer"]
    ]
    return marked.table(head, rows) + "".join(missing)


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
    found = {study: calibrated(study) for study in STUDIES}
    tissues = in_other_tissues()
    TISSUE.write_text(json.dumps(tissues, indent=1) + "\n")
    DOCUMENT.write_text(document(found, tissues))


if __name__ == "__main__":
    main()
