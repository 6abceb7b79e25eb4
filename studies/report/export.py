"""Exports of a run for other programs: tables as CSV, figures as SVG, surfaces with answers as arrays."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ..measures.case import CaseResult, Run
from ..store.cases import no_formula
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING
from .blocks import Cell, Field, Figures, Section, Table
from .page import asset, every_section
from .section_scene import scene


def mesh_names(cases: Sequence[CaseResult]) -> Iterator[tuple[str, CaseResult]]:
    """(file name, case): the file has the case's label as its name, and its hash too if labels are alike."""
    seen: set[str] = set()
    for case in cases:
        name = re.sub(r"[^A-Za-z0-9.=-]+", "_", case.label).strip("_.")[:80] or "case"
        name = name if name not in seen else f"{name}-{case.hash[:8]}"
        seen.add(name)
        yield f"meshes/{name}.vtu", case


def surface_fields(case: CaseResult) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """Points (N, 3) and fields of a case at full load; lengths have the unit of `unit_of`."""
    step, metres = case.full_load, metres_per_unit(case)
    fields: dict[str, np.ndarray] = {}
    for name, model in case.models.items():
        fields[f"{name}.displacement"] = model.displacement[step] / metres
        fields[f"{name}.reaction_force"] = model.reaction_force[step]
        if case.reference is not None and name != case.reference:
            reference = case.models[case.reference].displacement[step]
            fields[f"{name}.difference"] = (model.displacement[step] - reference) / metres
    fields |= {f"region.{name}": mask.astype(np.int8) for name, mask in case.regions.items()}
    return case.points / metres, fields


def metres_per_unit(case: CaseResult) -> float:
    """The unit of a case's mesh [m]: that of the file which it comes from, else 1."""
    return float(case.mesh_quality.get("scale", 1.0))


def unit_of(case: CaseResult) -> str:
    """The unit of a case's mesh, in words."""
    if "scale" not in case.mesh_quality:
        return "metres"
    file = Path(case.study.geometry.path or "its file").name
    return f"the unit of {file} ({metres_per_unit(case):.6g} m)"


def exported(run: Run) -> Iterator[tuple[str, str]]:
    """(file name, text) of every table and every figure of a run's report."""
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
        elif isinstance(block, Figures):
            for figure in block.figures:
                number += 1
                yield f"figures/{section.id}-{number}.svg", standalone_svg(str(figure.svg))


def table_csv(table: Table) -> str:
    """The table as CSV, with full numbers in the units of the head; a column of error bars after what has some."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    columns: list[list[str]] = []
    for column, *cells in zip(table.columns, *table.rows, strict=True):
        columns.append([_head(column), *map(_entry, cells)])
        if any(math.isfinite(cell.bar) for cell in cells):
            bars = [repr(cell.bar) if math.isfinite(cell.bar) else "" for cell in cells]
            columns.append([_head(replace(column, title=f"{column.title} ±")), *bars])
    writer.writerows(zip(*columns, strict=True))
    return out.getvalue()


def _entry(cell: Cell) -> str:
    return repr(cell.exact) if cell.exact is not None else no_formula(_words(cell).strip(NOTHING))


def _head(column: Field) -> str:
    words = " ".join(filter(None, (column.title, column.detail)))
    return no_formula(f"{words} [{column.shown_unit}]" if column.shown_unit else words)


def _words(cell: Cell) -> str:
    return " ".join(filter(None, (cell.text, cell.detail)))


def standalone_svg(svg: str) -> str:
    """A drawing of the page as an SVG file, in the colours of the printed page."""
    svg = re.sub(r' data-told="[^"]*"', "", svg)  # only the page's script reads it
    svg = re.sub(r"var\(--([a-z0-9-]+)\)", lambda match: _colours()[match[1]], svg)
    width, height = svg.split('viewBox="', 1)[1].split('"', 1)[0].split()[2:]
    size = (
        f'width="{width}pt" height="{height}pt" font-family="DejaVu Sans, Arial, sans-serif" font-size="8.3"'
    )
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<svg xmlns="http://www.w3.org/2000/svg" '
    return head + 'xmlns:xlink="http://www.w3.org/1999/xlink" ' + size + svg[svg.index("<svg") + 4 :]


@cache
def _colours() -> dict[str, str]:
    """CSS variable -> colour of the printed page: the first one in the style sheet."""
    found = re.findall(r"--([a-z0-9-]+):\s*(#[0-9a-f]{3,6})", str(asset("page.css")))
    return dict(reversed(found))
