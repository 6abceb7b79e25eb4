"""The generated parts of a document: what stands between `<!-- name -->` and `<!-- /name -->`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path


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


def rows(document: Path, name: str) -> list[list[str]]:
    """The rows of the table that a part of a document shows, without its head."""
    return cells(shown(document, name))[1:]


def _found(text: str, document: Path, name: str) -> re.Match[str]:
    found = re.search(rf"<!-- {name} -->\n(.*?)<!-- /{name} -->", text, re.DOTALL)
    if found is None:
        raise RuntimeError(f"{document.name} has lost the marks of its part {name!r}")
    return found
