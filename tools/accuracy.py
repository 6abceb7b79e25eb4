"""Writes the accuracy table of `vdm/README.md` from the stored results of the accuracy studies.

A surface may be named as argument: it goes through `accuracy-organ` and gets a row of its own. Rows of surfaces
that are not named stay as they are.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.command import vdmbench_process as vdmbench
from tools import marked
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.measures.uncertainty import is_resolved
from vdmbench.store.cases import read_run
from vdmbench.verdict.standing import at_full_load, reference_bar

ROOT = Path(__file__).parents[1]
README = ROOT / "vdm" / "README.md"
STUDIES = ("sphere", "ellipsoid", "box", "cylinder", "organ")
CHEAPEST = "box"
# of the models in the studies, what the table calls them
COLUMNS = {
    "vdm-paper": "paper",
    "vdm-consistent": "consistent",
    "vdm-vector": "vector",
    "vdm-boundary": "boundary",
    "fem-linear": "FEM, this mesh",
}
MEASURES = (VECTOR, DEFORMATION)
HEAD = ("body", "nodes", "loads", "reference's own", *COLUMNS.values())
_PART = "accuracy"


def row_of(study: str, directory: Path, name: str, surface: Path | None = None) -> list[str]:
    """Run a study in `directory` and give its row of the table, called `name`.

    Raises
    ------
    RuntimeError
        a study that did not finish all its cases.
    """
    given = ["--surface", str(surface)] if surface else []
    result = vdmbench("run", study, *given, "--out", name, "--json", cwd=directory)
    if result.returncode:
        raise RuntimeError(result.stderr)
    return [name, *cells(read_run(directory / name))]


def cells(run: Run) -> Iterator[str]:
    """What a row says of a run: size, the reference's own error, and each model's two errors in per cent."""
    yield str(len(run.cases[0].points))
    yield str(len(run.cases))
    own = ([reference_bar(case, measure) for case in run.cases] for measure in MEASURES)
    yield " / ".join(as_per_cent(np.mean(values)) for values in own)
    for model in COLUMNS:
        means, worst = zip(*(_errors(run.cases, model, measure) for measure in MEASURES), strict=True)
        yield f"{' / '.join(means)} ({' / '.join(worst)})"


def _errors(cases: Sequence[CaseResult], model: str, measure: str) -> tuple[str, str]:
    """Mean and worst over the loads; a tilde before a mean that the reference does not resolve for every load."""
    errors = np.array([at_full_load(case, model, measure) for case in cases])
    resolved = [is_resolved(e, reference_bar(case, measure)) for e, case in zip(errors, cases, strict=True)]
    mark = "" if all(resolved) else "~"
    return mark + as_per_cent(errors.mean()), as_per_cent(errors.max())


def as_per_cent(share: np.floating[Any] | float) -> str:
    """Per cent with two digits."""
    per_cent = 100.0 * share
    return f"{per_cent:.0f}" if per_cent >= 9.95 else f"{per_cent:.1f}"


def rows_in_readme() -> dict[str, list[str]]:
    """The rows that `vdm/README.md` shows now, by body."""
    return {row[0]: row for row in marked.cells(marked.shown(README, _PART))[1:]}


def written(rows: dict[str, list[str]]) -> str:
    """The table as Markdown."""
    return marked.table(HEAD, rows.values())


def main() -> None:
    """Run all the studies and write the table."""
    rows = rows_in_readme()
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        for body in STUDIES:
            rows[body] = row_of(f"accuracy-{body}", directory, body)
        for surface in sys.argv[1:]:
            body = Path(surface).stem
            rows[body] = row_of("accuracy-organ", directory, body, Path(surface).resolve())
    marked.show(README, _PART, written(rows))


if __name__ == "__main__":
    main()
