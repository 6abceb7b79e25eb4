"""What the run shows of its credibility, by category, folded away."""

from __future__ import annotations

from ..verdict.credibility import NOT, credibility
from ..verdict.digest import Digest
from .blocks import Cell, Column, Section, Table, Text

_READING = (
    "The categories are those of FDA's guidance of November 2023 on the credibility of computational modeling, and "
    "of ASME V&V 40-2018. They are computed from the stored results. They tell what was shown, not whether it is "
    "enough."
)


def evidence(digest: Digest) -> Section | None:
    """A line per category: shown, partly or not, and why."""
    found = credibility(digest)
    if not found:
        return None
    words = [one.word for one in found]
    count = ", ".join(f"{words.count(word)} {word}" for word in dict.fromkeys(words))
    rows = [
        [
            Cell(one.name),
            Cell(one.word, tone="bad" if one.word == NOT else ""),
            Cell(one.why),
            Cell(one.source),
        ]
        for one in found
    ]
    columns = [Column(title, numeric=False) for title in ("Evidence", "Shown?", "Why", "Category")]
    table = Table("credibility", "", columns, rows, summary=f"Evidence: {count}")
    return Section("credibility", "Credibility", [Text(_READING, kind="note"), table])


SECTIONS = (evidence,)
