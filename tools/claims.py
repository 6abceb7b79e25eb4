"""Puts the paper's claims on trial by the shipped studies and writes page, pictures and table.

The studies run in `results/runs`, where what is there already is kept; the page with rules and figures is
`build/claims.html`; a picture per claim goes to `docs/gallery`, table and pictures to the page in docs/evidence.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence

from tools import documents, gallery
from tools.documents import CASES, ROOT, RUNS, finished
from vdmbench.evidence.claims_page import verdict_rows, write_claims
from vdmbench.store.cases import read_run

DOCUMENT = ROOT / "docs" / "evidence" / "claims.md"
PAGE = ROOT / "build" / "claims.html"
PART = "claims"
_PICTURES = "claim pictures"


def studies_on_trial() -> list[str]:
    """The shipped studies that name claims."""
    studies = {path.stem: tomllib.loads(path.read_text())["study"] for path in CASES.glob("*.toml")}
    return sorted(name for name, study in studies.items() if study.get("claims"))


def main(_: str = "", __: Sequence[str] = ()) -> None:
    """Run the studies one after another, in one process at a time so that times can be compared."""
    names = studies_on_trial()
    for name in names:
        finished("run", name, "--jobs", "1")
    found = write_claims([read_run(RUNS / name) for name in names], PAGE)
    rows = verdict_rows(found)
    documents.show(DOCUMENT, PART, documents.table(list(rows[0]), [list(row.values()) for row in rows]))
    documents.show(DOCUMENT, _PICTURES, gallery.as_markdown(gallery.write_claim_pictures(found)))
