"""[[measured]]: what somebody measured on the body of a study, in the study or in a CSV file beside it."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo, model_validator

from .errors import file_fault, listed
from .kinds import (
    MAX_NAME,
    SI,
    Coordinate,
    Key,
    Length,
    Name,
    Plain,
    Position,
    Table,
    as_path,
    is_safe_name,
    not_negative,
    one_line,
)
from .units import QuantityError, shown, to_si

MOST_BYTES = 2_000_000
MOST_ROWS = 10_000
AXES = ("x", "y", "z")
DISPLACEMENT = tuple(f"displacement_{axis}" for axis in AXES)
DEFORMED = tuple(f"deformed_{axis}" for axis in AXES)
_SI = {"force": "N", "load_factor": "1", "node": "1", "point": ""}  # units of columns; others are in metres
_HEADER = re.compile(r"((?:(?P<other>[A-Za-z0-9][\w-]*)\.)?(?P<key>\w+))(?:\s*\[(?P<unit>[^\]]*)\])?")

Row = dict[str, Any]
Layouts = tuple[
    tuple[str, tuple[str, ...], tuple[str, ...]], ...
]  # a table's name, its columns: always, sometimes
MEASURED: Layouts = (
    ("forces", ("depth", "force"), ("uncertainty",)),
    ("surface", DEFORMED, ()),
    ("points", AXES, (*DISPLACEMENT, "point", "uncertainty", "load_factor")),
)


class MeasuredFileError(ValueError):
    """An unusable file of measured values; the message has its name and line."""


def read_measured(path: Path) -> dict[str, Any]:
    """Read a CSV file of measurements.

    Returns {"points": rows}; {"surface": positions} if it has columns `deformed_x` ...; {"forces": rows} if it has
    a column `force`.

    Rows of points have `point` (its name), the rest position `x`, `y`, `z`, some of `displacement_x`,
    `displacement_y`, `displacement_z`, and optionally `uncertainty` and `load_factor`. A column
    `NAME.displacement_x` is the value of another program, NAME. Rows of forces have `depth`, `force` and
    `uncertainty`, a force.

    Raises
    ------
    MeasuredFileError
        not one of these tables.
    """
    kind, rows = read_table(path, MEASURED)
    if len(rows) > MOST_ROWS:
        raise MeasuredFileError(
            f"{path.name}:{rows[MOST_ROWS]['line']}: has more than {MOST_ROWS:,} rows; keep fewer points"
        )
    if kind == "surface":
        return {"surface": [[row[key] for key in DEFORMED] for row in rows]}
    return {
        kind: [_point(row, path.name) for row in rows] if kind == "points" else [dict(row) for row in rows]
    }


def _point(row: Row, file: str) -> Row:
    """A row as one of a study's `points`; a cell without a number gives no key."""
    point: Row = {}
    for key, value in row.items():
        other, _, inner = key.rpartition(".")
        if other:
            point.setdefault("others", {}).setdefault(other, {})[inner] = value
        else:
            point["name" if key == "point" else key] = value
    if {*DISPLACEMENT}.isdisjoint(point):
        raise MeasuredFileError(
            f"{file}:{row['line']}: has no displacement: none of {', '.join(DISPLACEMENT)}"
        )
    return point


def read_table(path: Path, layouts: Layouts, most: int = MOST_BYTES) -> tuple[str, tuple[Row, ...]]:
    """The table that a CSV file holds, out of several, and its rows: SI values by column, and the file's `line`.

    A header has its unit in brackets, as in `x [mm]`; without one it is in metres or newtons. Lines that begin
    with # are skipped.

    Raises
    ------
    MeasuredFileError
        another table: an unknown or missing column, a wrong unit, a cell that is no finite number.
    """
    if fault := file_fault(path):
        raise MeasuredFileError(f"{path.name} {fault}")
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise MeasuredFileError(f"{path.name} cannot be read: {error.strerror}") from None
    if len(data) > most:
        raise MeasuredFileError(f"{path.name} is larger than {most // 1_000_000} MB; keep fewer points")
    return _parsed(path.name, data, layouts)


@lru_cache(maxsize=16)  # each case of a sweep validates the study again
def _parsed(name: str, data: bytes, layouts: Layouts) -> tuple[str, tuple[Row, ...]]:
    line, kind = 1, ""
    needed: tuple[str, ...] = ()
    columns: dict[str, tuple[str, str]] = {}
    rows: list[Row] = []
    try:
        text = io.StringIO(data.decode("utf-8-sig"), newline=None).read()
        for number, told in enumerate(text.split("\n"), start=1):
            if not told.strip() or told.startswith("#"):
                continue
            line = number  # of the last line with content
            cells = [cell.strip() for cell in next(csv.reader([told]))]
            if not kind:
                kind, needed, columns = _header(cells, layouts)
            else:
                rows.append({"line": line, **_row(cells, columns, needed)})
        if not rows:
            raise QuantityError("has a header and no row below it" if kind else "holds no table")
    except UnicodeDecodeError:
        raise MeasuredFileError(f"{name}:1: is not UTF-8 text; save the file in UTF-8") from None
    except csv.Error as error:
        raise MeasuredFileError(f"{name}:{line}: is no table: {error}") from None
    except QuantityError as error:
        raise MeasuredFileError(f"{name}:{line}: {error}") from None
    return kind, tuple(rows)


def _header(titles: list[str], layouts: Layouts) -> tuple[str, tuple[str, ...], dict[str, tuple[str, str]]]:
    """The table of a header, the columns that every row has, and unit and SI unit of each column."""
    parsed = [(title, _HEADER.fullmatch(title)) for title in titles]
    keys = {match["key"] for _, match in parsed if match}
    kind, needed, others = max(layouts, key=lambda layout: len(keys & {*layout[1], *layout[2]}))
    columns: dict[str, tuple[str, str]] = {}
    for title, match in parsed:
        key, inner = (match[1], match["key"]) if match else ("", "")
        known = set(needed + others) & set(DISPLACEMENT) if match and match["other"] else {*needed, *others}
        if inner not in known:
            raise QuantityError(
                f"unknown column {shown(title)}; a table of {kind} has the columns {', '.join(needed + others)}"
            )
        if key in columns:
            raise QuantityError(f"has two columns {shown(key)}")
        si = "N" if kind == "forces" and inner == "uncertainty" else _SI.get(inner, "m")
        unit = (match and match["unit"]) or ""
        try:
            if unit and si in ("", "1"):
                raise QuantityError("has no unit")
            if unit:
                to_si(f"1 {unit}", si)
        except QuantityError as error:
            raise QuantityError(f"column {key}: {error}") from None
        columns[key] = unit, si
    for key in needed:
        if key not in columns:
            raise QuantityError(f"has no column {shown(key)}")
    return kind, needed, columns


def _row(cells: list[str], columns: Mapping[str, tuple[str, str]], needed: tuple[str, ...]) -> Row:
    """Values by column, in SI; empty cells are left out."""
    if len(cells) != len(columns):
        raise QuantityError(f"has {len(cells)} cells, the header {len(columns)}")
    found: Row = {}
    for (key, (unit, si)), cell in zip(columns.items(), cells, strict=True):
        try:
            if cell:
                found[key] = _number(cell, unit, si) if si else cell
        except QuantityError as error:
            raise QuantityError(f"{key}: {error}") from None
        if key == "uncertainty" and found.get(key, 0.0) < 0:
            raise QuantityError(f"{key}: must be positive or zero, not {cell}")
        if key in needed and key not in found:
            raise QuantityError(f"has no {key}")
    return found


def _number(cell: str, unit: str, si: str) -> float:
    try:
        plain = float(cell)
    except ValueError:
        raise QuantityError(f"{shown(cell)} is no number") from None
    if not math.isfinite(plain):
        raise QuantityError("must be a finite number")
    return to_si(f"{cell} {unit}" if unit else plain, si)


# --- the table of a study ---


MOST_TABLES = 50
_SAME_LOAD = 1e-9  # of the largest load factor
_Deviation = Annotated[float, SI("m"), not_negative]
_ForceDeviation = Annotated[float, SI("N"), not_negative]


class Displacement(Table):
    """A displacement of which not every component is known"""

    displacement_x: Coordinate | None = Key("along x", None)
    displacement_y: Coordinate | None = Key("along y", None)
    displacement_z: Coordinate | None = Key("along z", None)

    def components(self) -> dict[int, float]:
        """Axis -> value of what is known [m]."""
        values = (getattr(self, key) for key in DISPLACEMENT)
        return {axis: value for axis, value in enumerate(values) if value is not None}


class MeasuredPoint(Displacement):
    """One point of a measured table"""

    name: Annotated[str, AfterValidator(one_line)] = Key("names it in the report", "", max_length=MAX_NAME)
    x: Coordinate = Key("its place at rest, on the body's surface")
    y: Coordinate = Key("its place at rest")
    z: Coordinate = Key("its place at rest")
    uncertainty: _Deviation | None = Key("standard uncertainty of a component, instead of the table's", None)
    load_factor: Plain | None = Key("load step, instead of the table's", None)
    line: int | None = Key("its line in the CSV file, for messages", None, ge=1)
    others: dict[str, Displacement] = Key("what other programs computed there, by name", {}, max_length=10)


class MeasuredForce(Table):
    """One point of a curve of force against depth"""

    depth: Length = Key(
        "of a contact the largest displacement of its nodes, inwards along the normal; of an indenter "
        "its way from where it first touches; of what moves a region the movement"
    )
    force: Annotated[float, SI("N")] = Key("resultant, in the direction of the depth")
    uncertainty: _ForceDeviation | None = Key("standard uncertainty, instead of the table's", None)
    line: int | None = Key("its line in the CSV file, for messages", None, ge=1)


class Measured(Table):
    """[[measured]]: points with displacements, a deformed surface, or force against depth"""

    name: Name = Key("names it in the report; the file's name where left out")
    path: str | None = Key(
        "a CSV file beside the study: columns `point`, `x`, `y`, `z`, `displacement_x`, "
        "`displacement_y`, `displacement_z`, `uncertainty`, `load_factor`, units in brackets as in `x [mm]`; an "
        "empty cell was not measured; `NAME.displacement_x` is what another program computed; of a deformed "
        "surface `deformed_x`, `deformed_y`, `deformed_z`; of force against depth `depth`, `force`, `uncertainty`",
        None,
    )
    source: Annotated[str, AfterValidator(one_line)] = Key("who measured, in one line", "", max_length=500)
    uncertainty: _Deviation | None = Key(
        "standard uncertainty u_D of a component, of points without their own", None
    )
    load_factor: Plain | None = Key("load factor of the values; the largest where left out", None)
    points: tuple[MeasuredPoint, ...] = Key("the points themselves, instead of a path", (), strict=False)
    surface: tuple[Position, ...] = Key("places on the deformed surface, instead of points", (), strict=False)
    forces: tuple[MeasuredForce, ...] = Key("force against depth, instead of points", (), strict=False)
    force_uncertainty: _ForceDeviation | None = Key(
        "standard uncertainty u_D of the forces, where one has none of its own", None
    )
    constraint: str | None = Key(
        "name of the contact, indenter or movement whose force it is; needed where there are several", None
    )

    @model_validator(mode="before")
    @classmethod
    def _of_file(cls, data: Any, info: ValidationInfo) -> Any:
        """The file's values instead of its path, so that a case contains all that decides its numbers."""
        if not isinstance(data, dict):
            return data
        given = [key for key in ("path", "points", "surface", "forces") if data.get(key)]
        if len(given) != 1 and data.keys() <= cls.model_fields.keys():
            told = f", not {listed({*given})}" if given else ""
            raise ValueError(f"give one of path, points, surface, forces{told}")
        if given != ["path"]:
            return data
        path = as_path(data["path"], info)
        name = {"name": path.stem[:MAX_NAME]} if is_safe_name(path.stem[:MAX_NAME]) else {}
        rest = {key: value for key, value in data.items() if key != "path"}
        return name | rest | read_measured(path)

    def deviation(self, point: MeasuredPoint | None = None) -> float:
        """Standard uncertainty of a point, or of the table [m]."""
        own = point.uncertainty if point is not None else None
        return float(own if own is not None else self.uncertainty or 0.0)

    def factor(self, point: MeasuredPoint | None = None) -> float | None:
        """Load factor of a point, or of the table; None for the largest."""
        own = point.load_factor if point is not None else None
        return own if own is not None else self.load_factor


def same_load(factor: float, other: float, largest: float) -> bool:
    """Whether two load factors of a history are equal to rounding."""
    return abs(factor - other) <= _SAME_LOAD * max(abs(largest), 1e-300)
