"""Writes the tables of `docs/evidence/accuracy.md` from runs of the accuracy studies, and of variants of these.

In a variant the patch is moved by a given amount instead of pressed, or the bed holds more of the body. A surface
may be named as argument: it goes through `accuracy-organ` and gets rows of its own. Rows of surfaces that are not
named stay as they are. The studies run in `results/runs`, where what is there already is kept.
"""

from __future__ import annotations

import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tools import marked
from tools.runs import CASES, ROOT, finished
from vdmbench.measures.bars import at_full_load, reference_bar
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.measures.uncertainty import is_resolved
from vdmbench.store.cases import read_run
from vdmbench.study.files import overridden
from vdmbench.verdict.formatting import NOTHING

DOCUMENT = ROOT / "docs" / "evidence" / "accuracy.md"
STUDIES = ("sphere", "ellipsoid", "box", "cylinder", "organ")
CHEAPEST = "box"
# of the models in the studies, what the table calls them
COLUMNS = {
    "vdm-paper": "paper",
    "vdm-consistent": "consistent",
    "vdm-vector": "vector",
    "bem": "bem",
    "fem-linear": "FEM, this mesh",
}
ALONG_NORMALS = ("vdm-paper", "vdm-consistent")  # the models that move nodes along normals only
NORMAL = "relative_l2_normal_error"
MEASURES = (VECTOR, DEFORMATION)
HEAD = ("body", "nodes", "loads", "rigid", "reference's own", "least along normals", *COLUMNS.values())
STEP = 1e-3  # m, by which a patch is moved; the models are linear, so that any other gives the same errors
PART = "accuracy"


@dataclass(frozen=True)
class Variant:
    """How a body is touched and held: `words` after its name in the table, `suffix` after its study's name."""

    words: str = ""
    suffix: str = ""
    moved: bool = False
    embedded: float = 0.0  # share of the height that the bed holds; 0 for the study's own
    stiffness: float = 0.0  # Pa/m, of springs in every direction that are the bed; 0 for one that holds

    def changes(self, study: str) -> dict[str, Any]:
        """What the variant changes in a study, for `overridden`."""
        data = tomllib.loads((CASES / f"{study}.toml").read_text())
        found: dict[str, Any] = {"study": {"name": study + self.suffix}}
        if self.embedded:
            found["regions"] = {"base": {"below": {"axis": "z", "fraction": self.embedded, "value": None}}}
        if self.stiffness:
            bed = {"kind": "elastic", "stiffness": self.stiffness, "direction": "full"}
            found["constraints"] = {"base": bed}
        if self.moved:
            inward = -STEP * _unit([data["sweep"][f"regions.finger.cap.direction.{k}"] for k in range(3)])
            found["constraints"] = found.get("constraints", {}) | {
                "finger": {
                    "kind": "constrained",
                    "pressure": None,
                    "profile": None,
                    "displacement": inward[:, 0].tolist(),
                }
            }
            found["sweep"] = {f"constraints.finger.displacement.{k}": inward[k].tolist() for k in range(3)}
        return found


PRESSED, MOVED = Variant(), Variant(", moved", "-moved", moved=True)


def _embedded(share: float) -> tuple[Variant, Variant]:
    words = f", embedded to {100 * share:.0f} %"
    return (
        Variant(words, "-embedded", embedded=share),
        Variant(f"{words}, moved", "-embedded-moved", moved=True, embedded=share),
    )


# springs of 1 kPa/mm; along the normal alone the body slides in its bed, which elements resolve slowly
ELASTIC = Variant(", embedded to 40 % on springs", "-elastic", embedded=0.4, stiffness=1e6)
# bodies that rock on a small base have a bed beside on which they do not, as deep as the patches leave room for
VARIANTS = dict.fromkeys(STUDIES, (PRESSED, MOVED)) | {
    "sphere": (PRESSED, MOVED, *_embedded(0.5)),
    "organ": (PRESSED, MOVED, *_embedded(0.4), ELASTIC),
}


def _unit(directions: Sequence[Sequence[float]]) -> np.ndarray:
    """(3, n) directions, each of length 1."""
    found = np.array(directions)
    return np.asarray(found / np.linalg.norm(found, axis=0))


def row_of(
    body: str, variant: Variant = PRESSED, *, cwd: Path = ROOT, surface: Path | None = None
) -> list[str]:
    """Run what is missing of a body's study in `cwd`, and give its row; a surface is on the organ's bed."""
    return [
        body + variant.words,
        *cells(run_of(body, variant.changes, variant.suffix, cwd=cwd, surface=surface)),
    ]


def run_of(
    body: str,
    changes: Callable[[str], dict[str, Any]],
    suffix: str,
    *,
    cwd: Path = ROOT,
    surface: Path | None = None,
) -> Run:
    """A body's study with what `changes` gives for its name, run in `cwd` as far as it is missing.

    Raises
    ------
    RuntimeError
        a study that did not finish all its cases.
    """
    study = "accuracy-organ" if surface else f"accuracy-{body}"
    out = cwd / "results" / "runs" / f"accuracy-{body}{suffix}"
    given = ["--surface", str(surface), "--allow-outside"] if surface else []
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "study.toml"
        path.write_text(overridden((CASES / f"{study}.toml").read_text(), changes(study)))
        finished("run", path, *given, "--out", out, "--json", cwd=cwd)
    return read_run(out)


def cells(run: Run) -> Iterator[str]:
    """What a row says of a run: size, the reference's motion and own error, and each model's errors in per cent."""
    yield str(len(run.cases[0].points))
    yield str(len(run.cases))
    yield _of_reference(run.cases, "rigid_share")
    own = ([reference_bar(case, measure) for case in run.cases] for measure in MEASURES)
    yield " / ".join(as_per_cent(np.mean(values)) for values in own)
    yield _of_reference(run.cases, "tangential_share")
    for model in COLUMNS:
        if not all(np.isfinite(at_full_load(case, model, VECTOR)) for case in run.cases):
            yield NOTHING
            continue
        measures = (*MEASURES, NORMAL) if model in ALONG_NORMALS else MEASURES
        means, worst = zip(*(_errors(run.cases, model, measure) for measure in measures), strict=True)
        yield f"{' / '.join(means)} ({' / '.join(worst)})"


def _of_reference(cases: Sequence[CaseResult], metric: str) -> str:
    return as_per_cent(np.mean([at_full_load(case, str(case.reference), metric) for case in cases]))


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


def written(rows: Mapping[str, Sequence[str]]) -> str:
    """The table as Markdown."""
    return marked.table(HEAD, rows.values())


def main() -> None:
    """Run all the studies and write the table."""
    found = {}
    for body, variants in VARIANTS.items():
        for variant in variants:
            row = row_of(body, variant)
            found[row[0]] = row
    for surface in (Path(name).resolve() for name in sys.argv[1:]):
        for variant in (PRESSED, MOVED):
            row = row_of(surface.stem, variant, surface=surface)
            found[row[0]] = row
    there = {row[0]: row for row in marked.rows(DOCUMENT, PART) if len(row) == len(HEAD)}
    marked.show(DOCUMENT, PART, written(found | {k: v for k, v in there.items() if k not in found}))


if __name__ == "__main__":
    main()
