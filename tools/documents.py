"""The generated parts of the documents: `make docs` writes them anew, the tests hold the functions to them.

A part stands between `<!-- name -->` and `<!-- /name -->`. README's picture is drawn without a graphics card.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from tests.command import vdmbench_process
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.measures.uncertainty import is_resolved
from vdmbench.study.fields import Node, study_schema
from vdmbench.verdict.formatting import percent

ROOT = Path(__file__).parents[1]
CASES = ROOT / "studies" / "cases"
RUNS = ROOT / "results" / "runs"
README = ROOT / "README.md"
STUDY_KEYS = ROOT / "studies" / "STUDY.md"
GALLERY = ROOT / "docs" / "gallery"
NOTEBOOK = ROOT / "docs" / "reference" / "quickstart.ipynb"
COLUMNS = {VECTOR: "displacement error", DEFORMATION: "change of shape"}


def finished(*words: str | Path, cwd: Path = ROOT, codes: tuple[int, ...] = (0,), **environment: str) -> str:
    """What a command prints that may take two hours. Raises RuntimeError for another exit code."""
    result = vdmbench_process(*words, cwd=cwd, seconds=7200, **environment)
    if result.returncode not in codes:
        raise RuntimeError(f"{' '.join(map(str, words[:2]))}: {result.stderr}")
    return result.stdout


def shown(document: Path, name: str) -> str:
    """What a document shows between the marks of a part. Raises RuntimeError where it has lost them."""
    return _found(document.read_text(encoding="utf-8"), document, name).group(1)


def show(document: Path, name: str, text: str) -> None:
    """Write a part of a document anew. Raises RuntimeError where it has lost the marks of it."""
    old = document.read_text(encoding="utf-8")
    found = _found(old, document, name)
    document.write_text(old[: found.start(1)] + text + old[found.end(1) :], encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Rows of texts as a Markdown table."""
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, ["---"] * len(head), *rows))


def cells(text: str) -> list[list[str]]:
    """The rows of the one Markdown table in a text, its head first."""
    lines = [line.strip("|") for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split(" | ")] for line in lines[:1] + lines[2:]]


def rows_shown(document: Path, name: str) -> list[list[str]]:
    """The rows of the table that a part of a document shows, without its head."""
    return cells(shown(document, name))[1:]


def _found(text: str, document: Path, name: str) -> re.Match[str]:
    found = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", text, re.DOTALL)
    if found is None:
        raise RuntimeError(f"{document.name} has lost the marks of its part {name!r}")
    return found


def headline_table(directory: Path) -> str:
    """The errors of the quickstart as Markdown, run in `directory`: median, bar and worst case."""
    found = json.loads(finished("run", "quickstart", "--json", cwd=directory))["metrics"]

    def cell(number: Mapping[str, float]) -> str:
        resolved = "" if is_resolved(number["value"], number["bar"]) else " unresolved"
        return f"{percent(number['value'])} ± {percent(number['bar'])}{resolved}, worst {percent(number['worst'])}"

    rated = ((name, [own[metric] for metric in COLUMNS]) for name, own in found.items() if VECTOR in own)
    return table(["model", *COLUMNS.values()], ([name, *map(cell, numbers)] for name, numbers in rated))


def notebook() -> str:
    """The page on notebooks as a notebook: a cell for each part of its code."""
    intro, code = re.split(r"```python\n", (NOTEBOOK.with_name("notebook.md")).read_text(), maxsplit=1)
    found: list[dict[str, object]] = [
        {"cell_type": "markdown", "id": "intro", "metadata": {}, "source": intro.strip()}
    ]
    empty = {"metadata": {}, "execution_count": None, "outputs": []}
    for number, part in enumerate(code.split("```")[0].strip().split("\n\n"), start=1):
        found.append({"cell_type": "code", "id": f"code-{number}", **empty, "source": part})
    return json.dumps({"cells": found, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def study_keys() -> str:
    """The reference of a study file's keys, from the schema that validates it."""
    text = (
        "# Keys of a study file\n\n"
        "Made from the tables that validate a study, by `make docs`. NAME is a name of yours, `[[]]` an array of\n"
        "tables. Numbers are in the unit shown; a text with another unit of the same dimension is converted. A\n"
        "default stands in brackets. A parameter that no model of the study reads is a mistake. `vdmbench schema`\n"
        "prints the JSON schema, for an editor.\n"
    )
    titles = {"vdm": "[vdm] for all surface models, [models.NAME] for one", "regions": "[regions.NAME]"}
    for name, node in study_schema()["properties"].items():
        if name != "models":
            table = _inside(_followed(node))
            title = titles.get(name, f"[[{name}]]" if "items" in node else f"[{name}]")
            text += f"\n## {title}\n\n" + "".join(f"{line}\n" for line in _key_lines(table))
    return text


def _followed(node: Node) -> Node:
    """A node, or what it refers to with the words of its own."""
    if "$ref" not in node:
        return node
    return {**study_schema()["$defs"][node["$ref"].rpartition("/")[2]], **node}


def _inside(node: Node) -> Node:
    """What a table of tables, or a list of them, holds; any other node itself."""
    inside = node.get("items", {} if "properties" in node else node.get("additionalProperties"))
    found = _followed(inside) if isinstance(inside, dict) else {}
    return found if "properties" in found else node


def _key_lines(table: Node, indent: str = "") -> Iterator[str]:
    """A line for each key of a table, with those of a table inside; of a table of kinds what each kind adds."""
    rules = table.get("allOf", [])
    kinds = {
        rule["if"]["properties"][by]["const"]: _followed(rule["then"])
        for rule in rules
        for by in table["properties"]
    }
    alike = [kind["properties"].keys() for kind in kinds.values()] or [table["properties"].keys()]
    shared = {
        key: node
        for key, node in next(iter(kinds.values()), table)["properties"].items()
        if all(key in keys for keys in alike)
    } | table["properties"]
    for key, node in shared.items():
        needed = all(key in kind.get("needs", kind.get("required", ())) for kind in kinds.values() or [table])
        yield from _lines_of(key, node, needed, indent)
    for word, kind in kinds.items():
        yield f"{indent}- of `{word}`, {kind['description']}:"
        own = {key: node for key, node in kind["properties"].items() if key not in shared}
        yield from _key_lines({**kind, "properties": own}, f"{indent}    ")
    if entries := table.get("additionalProperties"):
        yield f'{indent}- `"KEY"` ({entries["title"]}): {entries["description"]}'
        yield from _key_lines(_followed(entries["anyOf"][0]), f"{indent}    ")


def _lines_of(name: str, field: Node, needed: bool, indent: str) -> Iterator[str]:
    node = _followed(field)
    default = f" ({json.dumps(node['default'])})" if "default" in node else ""
    yield f"{indent}- `{name}` ({_kind(node)}{', required' * needed}): {node['description']}{default}"
    if "properties" in (inside := _inside(node)):
        yield from _key_lines(inside, f"{indent}    ")


def _kind(node: Node) -> str:
    """A node's type in words, or its unit."""
    if "unit" in node:
        return "number" if node["unit"] == "1" else str(node["unit"])
    if "items" in node:
        size = f" of {node['maxItems']}" if node.get("maxItems") == node.get("minItems", 0) else ""
        return f"list{size}: {_kind(_followed(node['items']))}"
    if "enum" in node:
        return "/".join(node["enum"])
    words = {"object": "table", "string": "text", "integer": "whole number", "boolean": "true or false"}
    return words.get(node.get("type", ""), "as of KEY")


def main() -> None:
    """Write all of them; a liver surface may be named as argument, else the procedural organ is drawn."""
    surface = ["--surface", str(Path(sys.argv[1]).resolve())] if len(sys.argv) > 1 else []
    STUDY_KEYS.write_text(study_keys())
    NOTEBOOK.write_text(notebook())
    with tempfile.TemporaryDirectory() as name:
        show(README, "quickstart", headline_table(Path(name)))
        finished("run", "liver-palpation", *surface, "--out", "liver", cwd=Path(name))
        finished("report", "liver", "--picture", "liver.png", cwd=Path(name))
        shutil.copy(Path(name) / "liver.png", GALLERY / "liver-palpation.png")


if __name__ == "__main__":
    main()
