"""Puts the paper's claims on trial by the shipped studies and writes page, pictures and table.

The studies run in `results/runs`, where what is there already is kept; the page and a picture per claim go to
`docs/gallery`, table and pictures to its page in docs/evidence.
"""

from __future__ import annotations

import tomllib

from tools import gallery, marked
from tools.runs import CASES, ROOT, RUNS, finished
from vdmbench.evidence.claims_page import verdict_rows, write_claims
from vdmbench.store.cases import read_run

DOCUMENT = ROOT / "docs" / "evidence" / "claims.md"
PAGE = ROOT / "docs" / "gallery" / "claims.html"
PART = "claims"
_PICTURES = "claim pictures"


def studies_on_trial() -> list[str]:
    """The shipped studies that name claims."""
    studies = {path.stem: tomllib.loads(path.read_text())["study"] for path in CASES.glob("*.toml")}
    return sorted(name for name, study in studies.items() if study.get("claims"))


def main() -> None:
    """Run the studies one after another, in one process at a time so that times can be compared."""
    names = studies_on_trial()
    for name in names:
        finished("run", name, "--jobs", "1")
    found = write_claims([read_run(RUNS / name) for name in names], PAGE)
    rows = verdict_rows(found)
    marked.show(DOCUMENT, PART, marked.table(list(rows[0]), [list(row.values()) for row in rows]))
    marked.show(DOCUMENT, _PICTURES, gallery.as_markdown(gallery.write_claim_pictures(found)))


if __name__ == "__main__":
    main()
