"""The blocks of the page's sections. A section is a function that returns blocks; templates draw them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from markupsafe import Markup

from ..measures.uncertainty import is_resolved
from ..verdict.digest import Spread
from ..verdict.formatting import NOT_MEASURED, NOTHING, number, of_unit, percent
from ..verdict.words import said


@dataclass(frozen=True)
class Text:
    """A paragraph; `kind` is "plain" or "note" (small print)."""

    template: ClassVar[str] = "text"
    text: str
    kind: str = "plain"


_NOTES = Path(__file__).parent / "templates" / "notes.txt"


def note(macro: str, *about: Any, kind: str = "note") -> Text:
    """The text of a macro in `templates/notes.txt`, as small print."""
    return Text(" ".join(said(macro, *about, file=_NOTES)), kind)


@dataclass(frozen=True)
class Cell:
    """One entry of a table: its text, a second line `detail`, and the full number and its error bar for CSV."""

    text: str
    detail: str = ""
    value: float | None = None
    tone: str = ""  # "good", "bad" or "muted"
    bar: float = math.nan

    @property
    def exact(self) -> float | None:
        """The full number; None if there is none or it is not finite."""
        return self.value if self.value is not None and math.isfinite(self.value) else None


def bar_detail(
    value: float, bar: float, shown: Callable[[float], str] = percent, unknown: str = f"± {NOT_MEASURED}"
) -> str:
    """The detail of a cell: the error bar of its value, and "unresolved" if the bar may explain the value."""
    if not math.isfinite(bar):
        return unknown
    return f"± {shown(bar)}" + ("" if is_resolved(value, bar) else "\nunresolved")


def spread_cell(spread: Spread | None, unit: str, floor: float = math.nan) -> Cell | None:
    """The median over the cases with its error bar, the worst of several cases, and the least possible value."""
    if spread is None:
        return None
    bar = bar_detail(spread.value, spread.bar, lambda value: of_unit(value, unit), unknown="")
    worst = f"worst {of_unit(spread.worst, unit)}" if spread.cases > 1 else ""
    least = f"floor {percent(floor)}" if math.isfinite(floor) else ""
    detail = "\n".join(filter(None, [bar, worst, least]))
    return Cell(of_unit(spread.value, unit), detail, spread.value, bar=spread.bar)


@dataclass(frozen=True)
class Field:
    """A column of a table.

    Attributes
    ----------
    title : name of the column
    of : row -> a number in `unit`, a text, a cell, or None for an empty cell
    unit : SI unit, "1" for shares, "#" for other numbers without unit, "" for texts
    detail : second line of the head
    bar : row -> the error bar of the number, shown below it
    """

    title: str
    of: Callable[[Any], float | str | Cell | None]
    unit: str = ""
    detail: str = ""
    bar: Callable[[Any], float] | None = None

    @property
    def shown_unit(self) -> str:
        """The unit in the head of a CSV file, "" if there is none."""
        return self.unit.replace("#", "")

    def cell(self, row: Any) -> Cell:
        """The entry of a row."""
        found = self.of(row)
        if isinstance(found, Cell):
            return found
        if found is None or isinstance(found, str):
            return Cell(found or NOTHING)
        if not math.isfinite(found):
            return Cell(NOTHING if math.isnan(found) else number(found))
        text = number(found) if self.unit == "#" else of_unit(found, self.unit)
        bar = math.nan if self.bar is None else float(self.bar(row))
        return Cell(text, bar_detail(found, bar, self._shown, unknown=""), float(found), bar=bar)

    def _shown(self, value: float) -> str:
        return of_unit(value, self.unit)


@dataclass(frozen=True)
class Table:
    """Rows of cells. Rows beyond `open_rows` are folded, not left out."""

    template: ClassVar[str] = "table"
    name: str  # of the CSV file
    caption: str
    columns: Sequence[Field]
    rows: Sequence[Sequence[Cell]]
    marks: Sequence[int | None] = ()  # for each row the palette place of its colour
    open_rows: int = 30
    tools: bool = True  # whether readers can copy, save and sort it


def frame_table(
    rows: Sequence[Any],
    fields: Sequence[Field],
    name: str,
    *,
    mark: Callable[[Any], int | None] | None = None,
    **about: Any,
) -> Table:
    """A table with one row for each of `rows`, without columns that have no entries.

    Parameters
    ----------
    rows, fields : the rows, and the columns that read them
    name : of the CSV file
    mark : row -> palette place of its colour
    about : further attributes of `Table`
    """
    cells = [[field.cell(row) for field in fields] for row in rows]
    kept = [k for k in range(len(fields)) if k == 0 or any(row[k].text != NOTHING for row in cells)]
    columns = [fields[k] for k in kept]
    marks = [mark(row) for row in rows] if mark is not None else ()
    shown = {"caption": "", **about}
    return Table(name, columns=columns, rows=[[row[k] for k in kept] for row in cells], marks=marks, **shown)


@dataclass(frozen=True)
class Figure:
    """A plot with its title."""

    svg: Markup
    title: str


@dataclass(frozen=True)
class Figures:
    """Plots side by side."""

    template: ClassVar[str] = "figures"
    figures: Sequence[Figure]


@dataclass(frozen=True)
class Code:
    """Text to copy: commands, a study file, versions of packages."""

    template: ClassVar[str] = "code"
    text: str
    summary: str = ""  # heading under which it is folded; "" to show it


@dataclass(frozen=True)
class Still:
    """A picture, and what it shows in words."""

    title: str
    url: str  # with the data in it
    words: str


@dataclass(frozen=True)
class Viewer:
    """The data of the 3-D viewer, and a picture for pages without it."""

    template: ClassVar[str] = "viewer"
    payload: Mapping[str, object] | None
    picture: Still | None
    note: Text


@dataclass(frozen=True)
class Scene:
    """A drawing of the scene, its words as (what, value), a note, and drawings of the bodies that models cut."""

    svg: Markup
    words: Sequence[tuple[str, str]]
    note: str = ""
    cut: Sequence[Markup] = ()


Block = Text | Table | Figures | Code | Viewer


@dataclass(frozen=True)
class Section:
    """A heading and its blocks; `id` is its anchor."""

    id: str
    title: str
    blocks: Sequence[Block] = field(default_factory=tuple)
