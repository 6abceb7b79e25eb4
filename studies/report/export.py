"""A run's tables and figures as files for a paper: CSV, LaTeX and SVG that need nothing of the page."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from functools import cache
from html import escape

from ..measures.case import Run
from ..store.cases import no_formula
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING
from ..verdict.palette import COLOURS
from .blocks import Cell, Column, Figure, Figures, Section, Table
from .page import asset, every_section
from .plots import shape
from .section_scene import scene
from .svg import MARKER_PATHS

# what the styler leaves to LaTeX and LaTeX does not know
_LATEX = str.maketrans(
    {"−": "$-$", "∞": r"$\infty$"}
    | {digit: f"$^{{{plain}}}$" for digit, plain in zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True)}
)
_LINE = 16  # units of the drawing, height of a line of the legend


def exported(run: Run) -> Iterator[tuple[str, str]]:
    """(name of a file, its text) of every table, as .csv and .tex, and every figure of a run's report."""
    digest = Digest(run)
    if drawn := scene(digest):
        yield "figures/scene.svg", standalone_svg(str(drawn.svg))
    for section in every_section(digest):
        yield from _of_section(section)


def _of_section(section: Section) -> Iterator[tuple[str, str]]:
    number = 0
    for block in section.blocks:
        if isinstance(block, Table):
            name = re.sub(r"[^A-Za-z0-9_-]+", "-", block.name)
            yield f"tables/{name}.csv", table_csv(block)
            yield f"tables/{name}.tex", table_latex(block, block.caption or section.title)
        elif isinstance(block, Figures):
            for figure in block.figures:
                number += 1
                yield f"figures/{section.id}-{number}.svg", _figure_svg(figure, block.legend)


def table_csv(table: Table) -> str:
    """The table with the full numbers, in the units of the head."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([_head(column) for column in table.columns])
    for row in table.rows:
        writer.writerow(
            [
                repr(cell.exact) if cell.exact is not None else no_formula(_words(cell).strip(NOTHING))
                for cell in row
            ]
        )
    return out.getvalue()


def table_latex(table: Table, caption: str) -> str:
    """The table as the page shows it, for the package booktabs."""
    from pandas import DataFrame

    heads = [" ".join(filter(None, (column.title, column.detail))) for column in table.columns]
    rows = [[_words(cell).replace("\n", " ") for cell in row] for row in table.rows]
    shown = DataFrame(rows, columns=range(len(heads))).style.hide(axis="index").format(escape="latex")
    shown = shown.format_index(lambda k: heads[k], escape="latex", axis="columns")
    align = "".join("r" if column.numeric else "l" for column in table.columns)
    escaped = caption.translate({ord(c): f"\\{c}" for c in "&%$#_{}"})
    return shown.to_latex(hrules=True, column_format=align, caption=escaped).translate(_LATEX)


def _head(column: Column) -> str:
    words = " ".join(filter(None, (column.title, column.detail)))
    return no_formula(f"{words} [{column.unit}]" if column.unit else words)


def _words(cell: Cell) -> str:
    return " ".join(filter(None, (cell.text, cell.detail)))


def _figure_svg(figure: Figure, legend: Sequence[tuple[int, str, bool]]) -> str:
    """A chart with its title above and its legend below."""
    svg = re.sub(r' data-(?:x|y|told)="[^"]*"', "", str(figure.svg))  # those are for the page's script
    x, y, width, height = map(float, re.findall(r'viewBox="([^"]+)"', svg)[0].split())
    words = [f'<text x="{x + 4:g}" y="{y - 6:g}" font-weight="bold">{escape(figure.title)}</text>']
    for k, (model, name, is_reference) in enumerate(legend):
        base = y + height + _LINE * (k + 0.8)
        if is_reference:
            mark = 'd="M0 5H14" stroke="var(--reference)" stroke-width="1.6"'
        else:
            mark = f'd="{MARKER_PATHS[shape(model)]}" fill="var(--model-{model % COLOURS})"'
        words.append(f'<path transform="translate({x + 3:g} {base - 8.5:g})" {mark}/>')
        told = f"{name} (reference)" if is_reference else name
        words.append(f'<text x="{x + 20:g}" y="{base:g}" fill="var(--ink)">{escape(told)}</text>')
    box = f"{x:g} {y - 2 * _LINE:g} {width:g} {height + _LINE * (len(legend) + 2.5):g}"
    svg = re.sub(r'viewBox="[^"]+"', f'viewBox="{box}"', svg, count=1)
    end = svg.rindex("</svg>")
    return standalone_svg(svg[:end] + "\n".join(words) + svg[end:])


def standalone_svg(svg: str) -> str:
    """An SVG file of a drawing of the page, in the colours that the page has on paper."""
    svg = re.sub(r"var\(--([a-z0-9-]+)\)", lambda match: _colours()[match[1]], svg)
    width, height = svg.split('viewBox="', 1)[1].split('"', 1)[0].split()[2:]
    size = (
        f'width="{width}pt" height="{height}pt" font-family="DejaVu Sans, Arial, sans-serif" font-size="8.3"'
    )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" '
    return head + 'xmlns:xlink="http://www.w3.org/1999/xlink" ' + size + svg[svg.index("<svg") + 4 :]


@cache
def _colours() -> dict[str, str]:
    """Variable -> colour of the page on paper: those that stand first."""
    found = re.findall(r"--([a-z0-9-]+):\s*(#[0-9a-f]{3,6})", str(asset("page.css")))
    return dict(reversed(found))
