"""Writes the generated parts of the documents anew: `make docs`. The tests hold the same functions to the files.

README's picture of a report is taken where Chromium is installed; elsewhere the one that is there stays.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tempfile
from pathlib import Path

from studies.fields import field_table
from tests.command import vdmbench
from tests.docs import gallery

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
STUDY_KEYS = ROOT / "studies" / "STUDY.md"
PICTURE = gallery.GALLERY / "liver-palpation.png"
REPORT = gallery.GALLERY / "report.png"
# these columns depend on the machine
MACHINE = {"set-up", "per frame", "memory"}
_TABLE = re.compile(r"(<!-- quickstart -->\n).*?(<!-- /quickstart -->)", re.DOTALL)


def headline_table(directory: Path) -> str:
    """The quickstart's headline as Markdown, run in `directory`, without what depends on the machine."""
    result = vdmbench("run", "quickstart", "--json", cwd=directory)
    if result.returncode:
        raise RuntimeError(result.stderr)
    rows = json.loads(result.stdout)["headline"]
    columns = [column for column in rows[0] if column not in MACHINE]
    lines = [columns, ["---"] * len(columns), *([row[column] for column in columns] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def table_in_readme() -> str:
    """What README.md shows now."""
    found = _TABLE.search(README.read_text())
    if found is None:
        raise RuntimeError("README.md has lost the marks of its table")
    return found.group(0).split("\n", 1)[1].rsplit("<!--", 1)[0]


def study_keys() -> str:
    """The reference of a study file's keys, from the models that validate it."""
    text = (
        "# Keys of a study file\n\n"
        "Made from `studies/study_file/schema.py` by `make docs`. NAME is a name of yours, `[]` an entry of an "
        "array of\ntables. "
        "Numbers are in the unit shown; a text with another unit of the same dimension is converted.\n\n"
        "| key | value | default | what |\n| --- | --- | --- | --- |\n"
    )
    for row in field_table():
        cells = (f"`{row.key}`", row.kind, row.default, row.help)
        text += f"| {' | '.join(cell.replace('|', '&#124;') for cell in cells)} |\n"
    return text


def main() -> None:
    """Write all of them; a liver surface may be named as argument, else the procedural organ is drawn."""
    surface = ["--surface", str(Path(sys.argv[1]).resolve())] if len(sys.argv) > 1 else []
    with tempfile.TemporaryDirectory() as name:
        table = headline_table(Path(name))
        README.write_text(
            _TABLE.sub(lambda found: found.group(1) + table + found.group(2), README.read_text())
        )
        STUDY_KEYS.write_text(study_keys())
        vdmbench("run", "liver-palpation", *surface, "--out", "liver", cwd=Path(name))
        result = vdmbench("report", "liver", "--picture", "liver.png", cwd=Path(name))
        if result.returncode:
            raise RuntimeError(result.stderr)
        PICTURE.parent.mkdir(exist_ok=True)
        shutil.copy(Path(name) / "liver.png", PICTURE)
        gallery.report_picture(Path(name) / "results" / "runs" / "quickstart" / "report.html", REPORT)


if __name__ == "__main__":
    main()
