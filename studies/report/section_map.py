"""What the verdict has besides its rows: the map of words over two swept parameters, and doubts about the scene."""

from __future__ import annotations

from ..study.registry import Family
from ..verdict.digest import Digest
from ..verdict.formatting import parameter_name, swept_value
from ..verdict.verdict import verdicts
from ..verdict.words import TITLES
from .blocks import Cell, Column, Field, Section, Table, Text, frame_table

_MOST_VALUES = 12  # of a parameter: a wider map is no table that one reads


def map_of_words(digest: Digest) -> Section | None:
    """A table for each family whose cases differ in their word; None where other than two parameters are swept."""
    told = verdicts(digest)
    found = told.map
    if found is None or max(len(found.x_values), len(found.y_values)) > _MOST_VALUES:
        return None
    columns = [Column(parameter_name(found.y), numeric=False)]
    columns += [Column(swept_value(value, found.x_unit), numeric=False) for value in found.x_values]
    tables = [
        Table(
            f"map-{family}",
            f"{TITLES[Family(family)]}, {told[family].model}",
            columns,
            [
                [Cell(swept_value(value, found.y_unit)), *map(Cell, words)]
                for value, words in zip(found.y_values, rows, strict=True)
            ],
        )
        for family, rows in found.words.items()
        if len({word for words in rows for word in words if word}) > 1
    ]
    if not tables:
        return None
    note = f"The word of each case. Across: {parameter_name(found.x)}; down: {parameter_name(found.y)}."
    return Section("map", "Where it holds", [Text(note, kind="note"), *tables])


def doubts(digest: Digest) -> Section | None:
    """A row per constraint and doubt, of several cases the first."""
    fields = [
        Field("Constraint", lambda doubt: doubt.constraint),
        Field("Case", lambda doubt: doubt.case),
        Field("What is doubtful", lambda doubt: doubt.text),
    ]
    found = verdicts(digest).doubts
    table = frame_table(found, fields, "doubts")
    return Section("doubts", "What is doubtful about the scene", [table]) if found else None
