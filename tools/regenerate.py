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

from tools import gallery, marked
from tools.runs import ROOT, finished
from vdmbench.study.fields import field_table

README = ROOT / "README.md"
STUDY_KEYS = ROOT / "studies" / "STUDY.md"
PICTURE = gallery.GALLERY / "liver-palpation.png"
REPORT = gallery.GALLERY / "report.png"
COLUMNS = ("model", "displacement error", "change of shape")
PART = "quickstart"
ARCHITECTURE = ROOT / "docs" / "methods" / "architecture.md"
GRAPH = "graph"
NOTEBOOK = ROOT / "docs" / "reference" / "quickstart.ipynb"


def headline_table(directory: Path) -> str:
    """The errors of the quickstart as Markdown, run in `directory`: median, bar and worst case."""
    rows = json.loads(finished("run", "quickstart", "--json", cwd=directory))["headline"]
    rated = [row for row in rows if row["displacement error"] != "–"]
    return marked.table(COLUMNS, ([row[column] for column in COLUMNS] for row in rated))


def notebook() -> str:
    """The page on notebooks as a notebook: a cell for each part of its code."""
    intro, code = re.split(r"```python\n", (NOTEBOOK.with_name("notebook.md")).read_text(), maxsplit=1)
    cells: list[dict[str, object]] = [
        {"cell_type": "markdown", "id": "intro", "metadata": {}, "source": intro.strip()}
    ]
    cells += [
        {
            "cell_type": "code",
            "id": f"code-{number}",
            "metadata": {},
            "execution_count": None,
            "outputs": [],
            "source": part,
        }
        for number, part in enumerate(code.split("```")[0].strip().split("\n\n"), start=1)
    ]
    return json.dumps({"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def graph_of_quickstart(directory: Path) -> str:
    """The quickstart's graph for Mermaid, as nothing of it was done."""
    told = finished("plan", "quickstart", "--graph", "--fresh", cwd=directory)
    return f"```mermaid\n{told}```\n"


def study_keys() -> str:
    """The reference of a study file's keys, from the models that validate it."""
    text = (
        "# Keys of a study file\n\n"
        "Made from `studies/study/schema.py` by `make docs`. NAME is a name of yours, `[]` an entry of an "
        "array of\ntables. "
        "Numbers are in the unit shown; a text with another unit of the same dimension is converted. A parameter\n"
        "in [vdm] that no model of the study reads, or in a model's own table that this model does not, is a "
        "mistake. `vdmbench schema` prints the JSON schema of these keys, for an editor.\n\n"
    )
    rows = ((f"`{row.key}`", row.kind, row.default, row.help) for row in field_table())
    return text + marked.table(
        ("key", "value", "default", "what"), ([cell.replace("|", "&#124;") for cell in row] for row in rows)
    )


def main() -> None:
    """Write all of them; a liver surface may be named as argument, else the procedural organ is drawn."""
    surface = ["--surface", str(Path(sys.argv[1]).resolve())] if len(sys.argv) > 1 else []
    with tempfile.TemporaryDirectory() as name:
        # before its meshes are there
        marked.show(ARCHITECTURE, GRAPH, graph_of_quickstart(Path(name)))
        marked.show(README, PART, headline_table(Path(name)))
        STUDY_KEYS.write_text(study_keys())
        NOTEBOOK.write_text(notebook())
        finished("run", "liver-palpation", *surface, "--out", "liver", cwd=Path(name))
        finished("report", "liver", "--picture", "liver.png", cwd=Path(name))
        PICTURE.parent.mkdir(exist_ok=True)
        shutil.copy(Path(name) / "liver.png", PICTURE)
        gallery.report_picture(Path(name) / "results" / "runs" / "quickstart" / "report.html", REPORT)


if __name__ == "__main__":
    main()
