"""Puts the paper's claims on trial by the shipped studies and writes page, pictures and table: `make claims`.

The studies run in `results/runs`, where what is there already is kept; the page and a picture per claim go to
`results/gallery`, table and pictures to README.md.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from studies.report.claims_page import verdict_rows, write_claims
from studies.store import read_run
from tests.command import vdmbench
from tests.docs import gallery

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PAGE = ROOT / "results" / "gallery" / "claims.html"
CASES = ROOT / "studies" / "cases"
_TABLE = re.compile(r"(<!-- claims -->\n).*?(<!-- /claims -->)", re.DOTALL)
_PICTURES = re.compile(r"(<!-- claim pictures -->\n).*?(<!-- /claim pictures -->)", re.DOTALL)


def studies_on_trial() -> list[str]:
    """The shipped studies that name claims."""
    studies = {path.stem: tomllib.loads(path.read_text())["study"] for path in CASES.glob("*.toml")}
    return sorted(name for name, study in studies.items() if study.get("claims"))


def as_markdown(rows: Sequence[dict[str, str]]) -> str:
    """Verdicts as a table."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def table_in_readme() -> str:
    """What README.md shows now."""
    found = _TABLE.search(README.read_text())
    if found is None:
        raise RuntimeError("README.md has lost the marks of its table of claims")
    return found.group(0).split("\n", 1)[1].rsplit("<!--", 1)[0]


def main() -> None:
    """Run the studies one after another, in one process at a time so that times can be compared."""
    names = studies_on_trial()
    for name in names:
        result = vdmbench("run", name, "--jobs", "1", cwd=ROOT, seconds=3600)
        if result.returncode:
            raise RuntimeError(f"{name}: {result.stderr}")
    found = write_claims([read_run(ROOT / "results" / "runs" / name) for name in names], PAGE)
    table = as_markdown(verdict_rows(found))
    pictures = gallery.as_markdown(gallery.write_claim_pictures(found))
    text = _TABLE.sub(lambda old: old.group(1) + table + old.group(2), README.read_text())
    README.write_text(_PICTURES.sub(lambda old: old.group(1) + pictures + old.group(2), text))


if __name__ == "__main__":
    main()
