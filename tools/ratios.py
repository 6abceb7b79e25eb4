"""Writes how far the boundary form is off at every Poisson's ratio to `docs/evidence/accuracy.md`.

The studies of `tools.accuracy`, pressed, with the tissue's own ratio inside and with VDM's fluid, which keeps the
volume. A surface may be named as argument; rows of surfaces that are not named stay as they are.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools import marked
from tools.accuracy import DOCUMENT, MEASURES, STUDIES, as_per_cent, run_of
from tools.runs import CASES
from vdmbench.measures.bars import at_full_load, reference_bar
from vdmbench.measures.case import CaseResult, Run

RATIOS = (0.3, 0.45, 0.49, 0.4999)
FORM, ELEMENTS = "bem", "fem-linear"
FILLED = f"models.{FORM}.compressibility"
RATIO = "tissue.poisson_ratio"
INSIDE = ("tissue", "fluid")
# Pa: the volume changes in first order alone, and linear models have the same errors at every load
PRESSURE = 0.04
HEAD = (
    "body",
    "nu",
    "reference's own",
    "its volume",
    *(f"bem, {what}" for what in INSIDE),
    "FEM, this mesh",
)
PART, ALL = "ratios", "all"


def changes(study: str) -> dict[str, Any]:
    """What it takes to run each load of a study with every ratio and both insides, for `overridden`."""
    own = tomllib.loads((CASES / f"{study}.toml").read_text())["sweep"]
    loads = {key: values for key, values in own.items() if key != "mode"}
    n_loads = len(next(iter(loads.values())))
    both = [(ratio, inside) for ratio in RATIOS for inside in INSIDE]
    return {
        "study": {"name": f"{study}-ratios", "models": [FORM, ELEMENTS]},
        "constraints": {"finger": {"pressure": f"{PRESSURE} Pa"}},
        "sweep": {key: values * len(both) for key, values in loads.items()}
        | {
            RATIO: [ratio for ratio, _ in both for _ in range(n_loads)],
            FILLED: [inside for _, inside in both for _ in range(n_loads)],
        },
    }


def errors(case: CaseResult, model: str) -> tuple[float, ...]:
    """Displacement, change of shape, and change of volume over the volume that the reference displaces."""
    reference = str(case.reference)
    drift, own = (at_full_load(case, name, "volume_drift") for name in (model, reference))
    displaced = own / at_full_load(case, reference, "volume_drift_of_displaced")
    return (*(at_full_load(case, model, measure) for measure in MEASURES), abs((drift - own) / displaced))


def rows_of(body: str, run: Run) -> Iterator[list[str]]:
    """A body's rows, one a ratio."""
    for ratio in RATIOS:
        tissue, fluid = (
            [case for case in run.cases if (case.swept[RATIO], case.swept[FILLED]) == (ratio, inside)]
            for inside in INSIDE
        )
        own = ([reference_bar(case, measure) for case in tissue] for measure in MEASURES)
        volume = [
            abs(at_full_load(case, str(case.reference), "volume_drift_of_displaced")) for case in tissue
        ]
        yield [
            body,
            str(ratio),
            " / ".join(as_per_cent(np.mean(values)) for values in own),
            as_per_cent(np.mean(volume)),
            _cell([errors(case, FORM) for case in tissue]),
            _cell([errors(case, FORM) for case in fluid]),
            _cell([errors(case, ELEMENTS) for case in tissue]),
        ]


def _cell(found: Sequence[Sequence[float]]) -> str:
    """Mean and, in brackets, worst of (loads, 3) errors."""
    both = (np.mean(found, axis=0), np.max(found, axis=0))
    means, worst = (" / ".join(map(as_per_cent, values)) for values in both)
    return f"{means} ({worst})"


def over_bodies(rows: Iterable[Sequence[str]]) -> Iterator[list[str]]:
    """Rows of all bodies: the mean of what their rows show, of what is in brackets the worst."""
    rows = list(rows)
    for ratio in map(str, RATIOS):
        columns = zip(*(row[2:] for row in rows if row[1] == ratio), strict=True)
        yield [ALL, ratio, *map(_over_bodies, columns)]


def _over_bodies(cells: Sequence[str]) -> str:
    shown = [re.findall(r"[\d.]+", cell) for cell in cells]
    numbers = np.array(shown, dtype=float) / 100.0
    if "(" not in cells[0]:
        return " / ".join(map(as_per_cent, numbers.mean(axis=0)))
    half = numbers.shape[1] // 2
    both = (numbers[:, :half].mean(axis=0), numbers[:, half:].max(axis=0))
    means, worst = (" / ".join(map(as_per_cent, values)) for values in both)
    return f"{means} ({worst})"


def written(rows: Iterable[Sequence[str]]) -> str:
    """The table as Markdown, rows of all bodies at its end."""
    rows = list(rows)
    return marked.table(HEAD, [*rows, *over_bodies(rows)])


def main() -> None:
    """Run all the studies and write the table."""
    surfaces = {path.stem: path for path in (Path(name).resolve() for name in sys.argv[1:])}
    found = []
    for body in (*STUDIES, *surfaces):
        found += rows_of(body, run_of(body, changes, "-ratios", surface=surfaces.get(body)))
        print(marked.table(HEAD, found), flush=True)
    named = {row[0] for row in found} | {ALL}
    marked.show(
        DOCUMENT,
        PART,
        written([*found, *(row for row in marked.rows(DOCUMENT, PART) if row[0] not in named)]),
    )


if __name__ == "__main__":
    main()
