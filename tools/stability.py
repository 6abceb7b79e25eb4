"""Runs the shipped studies of numerical stability and writes what breaks where to its page in docs/evidence.

The studies run in `results/runs`, where what is there already is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools import marked
from tools.runs import CASES, ROOT, RUNS, finished
from vdmbench.store.cases import Run, read_run
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.formatting import parameter_name
from vdmbench.verdict.ladders import Ladder, alike, ladders

DOCUMENT = ROOT / "docs" / "evidence" / "stability.md"
HEADING = ["study", "parameter", "range", "stand it all", "break down at"]
PART = "stability"


def stability_studies() -> list[str]:
    """The shipped studies that raise one parameter at a time."""
    return sorted(path.stem for path in CASES.glob("stability-*.toml"))


def rows(run: Run) -> list[list[str]]:
    """One row for each parameter of a study: how many solvers stand all of it, and where the others break down.

    Raises
    ------
    RuntimeError
        a step that is called converged and is wrong: the table has no place for it.
    """
    with np.errstate(all="ignore"):  # of what solvers leave behind that broke down
        found = ladders(Digest(run))
    for ladder in found:
        for model, readings in ladder.readings.items():
            if any(reading is not None and reading.silent for reading in readings):
                raise RuntimeError(f"{model} is wrong in silence along {ladder.key}")
    name = run.study.study.name
    return [
        [name, parameter_name(ladder.key), _range(ladder), _stand(ladder), _breaks(ladder)]
        for ladder in found
    ]


def _range(ladder: Ladder) -> str:
    return f"{ladder.text(ladder.values[0])} to {ladder.text(ladder.values[-1])}"


def _stand(ladder: Ladder) -> str:
    right = sum(not ladder.breakdowns(model) for model in ladder.readings)
    return f"{right} of {len(ladder.readings)}"


def _breaks(ladder: Ladder) -> str:
    places: dict[str, list[str]] = {}
    for models in alike(ladder):
        for value, reading in ladder.breakdowns(models[0]):
            place = f"{ladder.text(value)} ({reading.code})"
            places.setdefault(place, []).extend(f"`{model}`" for model in models)
    return "; ".join(f"{place}: {', '.join(models)}" for place, models in places.items()) or "nowhere"


def write(directories: Sequence[Path]) -> None:
    """Write the table of finished runs to its page in docs/evidence."""
    found = [row for directory in directories for row in rows(read_run(directory))]
    marked.show(DOCUMENT, PART, marked.table(HEADING, found))


def main() -> None:
    """Run the studies one after another and write the table."""
    names = stability_studies()
    for name in names:
        finished("run", name, codes=(0, 3))
    write([RUNS / name for name in names])


if __name__ == "__main__":
    main()
