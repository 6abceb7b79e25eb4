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

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from .kinds import (
    MAX_NAME,
    SI,
    Name,
    Position,
    Table,
    as_path,
    is_safe_name,
    not_negative,
    one_line,
    positive,
)
from .units import QuantityError, shown, to_si

MOST_BYTES = 2_000_000
MOST_ROWS = 10_000
AXES = ("x", "y", "z")
DISPLACEMENT = tuple(f"displacement_{axis}" for axis in AXES)
DEFORMED = tuple(f"deformed_{axis}" for axis in AXES)
FORCES = ("depth", "force")
_LENGTHS = {*AXES, "depth", *DISPLACEMENT, *DEFORMED, "uncertainty"}
_HEADER = re.compile(r"(?:(?P<other>[A-Za-z0-9][\w-]*)\.)?(?P<key>\w+)(?:\s*\[(?P<unit>[^\]]*)\])?")

Row = dict[str, Any]


class MeasuredFileError(ValueError):
    """A file of measured values that cannot be used; the message has its name and line."""


def read_measured(path: Path) -> dict[str, Any]:
    """What a CSV file measured: {"points": rows}; {"surface": positions} where it has columns `deformed_x` ...;
    {"forces": rows} where it has a column `force`.

    A row has `point` (its name), the rest position `x`, `y`, `z`, some of `displacement_x`, `displacement_y`,
    `displacement_z`, and where wanted `uncertainty` and `load_factor`. A column `NAME.displacement_x` is what
    another program, NAME, computed there. A row of forces has `depth`, `force` and `uncertainty`, a force. A header
    tells its unit in brackets, as in `x [mm]`; without one it is in metres or newtons. Lines that begin with # are
    passed over.

    Raises
    ------
    MeasuredFileError
        no such table: an unknown or missing column, a wrong unit, a cell that is no finite number.
    """
    return _parsed(path, read_csv(path))


def read_csv(path: Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a table, of which there may be so many. Raises MeasuredFileError."""
    try:
        if not path.is_file():  # a FIFO would be waited for, a device read without end
            raise MeasuredFileError(f"{path.name} cannot be read: no such file")
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise MeasuredFileError(f"{path.name} cannot be read: {error.strerror}") from None
    if len(data) > most:
        raise MeasuredFileError(f"{path.name} is larger than {most // 1_000_000} MB; keep fewer points")
    return data


@lru_cache(maxsize=16)  # each case of a sweep validates the study anew
def _parsed(path: Path, data: bytes) -> dict[str, Any]:
    table = CsvTable(path.name, data)
    table.check_measured()
    if table.is_force:
        return {"forces": table.forces()}
    return {"surface": table.columns(DEFORMED).tolist()} if table.is_surface else {"points": table.points()}


class CsvTable:
    """A header and its rows, each with its line in the file. Raises MeasuredFileError for any other text."""

    def __init__(self, name: str, data: bytes) -> None:
        self._name = name
        try:
            rows = _rows(data.decode("utf-8-sig"))
        except UnicodeDecodeError:
            raise self.error(1, "is not UTF-8 text; save the file in UTF-8") from None
        except csv.Error as error:
            raise self.error(1, f"is no table: {error}") from None
        if not rows:
            raise self.error(1, "holds no table")
        self._header_line, header = rows[0]
        self._rows = rows[1:]
        self._forces = any(title.strip().partition("[")[0].strip() == "force" for title in header)
        self._columns = [self._column(title) for title in header]
        keys = [key for key, _ in self._columns]
        for key in keys:
            if keys.count(key) > 1:
                raise self.error(self._header_line, f"has two columns {shown(key)}")
        self.keys = keys
        self.is_surface = not {*DEFORMED}.isdisjoint(keys)
        for some, others in ((("node",), AXES), (DEFORMED, DISPLACEMENT)):
            both = [next((key for key in kind if key in keys), None) for kind in (some, others)]
            if None not in both:
                raise self.error(
                    self._header_line,
                    f"has {both[0]} and {both[1]}, which say the same twice; keep one of them",
                )
        self.is_force = not {*FORCES}.isdisjoint(keys)
        if not self._rows:
            raise self.error(self._header_line, "has a header and no row below it")

    def check_measured(self) -> None:
        """Whether it can be a measured table. Raises MeasuredFileError."""
        keys = self.keys
        if self.is_force and (more := [key for key in keys if key not in (*FORCES, "uncertainty")]):
            raise self.error(
                self._header_line,
                f"measured forces have the columns depth, force and uncertainty only, not {shown(more[0])}",
            )
        wanted = FORCES if self.is_force else DEFORMED if self.is_surface else AXES
        for key in wanted:
            if key not in keys:
                raise self.error(self._header_line, f"has no column {shown(key)}")
        if wanted is AXES and {*DISPLACEMENT}.isdisjoint(keys):
            raise self.error(self._header_line, f"has none of the columns {', '.join(DISPLACEMENT)}")
        if self.is_surface and len(keys) > len(DEFORMED):
            raise self.error(
                self._header_line, f"a measured surface has the columns {', '.join(DEFORMED)} only"
            )
        if "node" in keys:
            raise self.error(self._header_line, "a measured table has places, not nodes")
        if len(self._rows) > MOST_ROWS:
            raise self.error(self._rows[MOST_ROWS][0], f"has more than {MOST_ROWS:,} rows; keep fewer points")

    def forces(self) -> list[Row]:
        """The rows as a study's `forces`."""
        return [{"line": line, **cells} for line, cells in self._cells(FORCES)]

    def error(self, line: int, text: str) -> MeasuredFileError:
        return MeasuredFileError(f"{self._name}:{line}: {text}")

    def points(self) -> list[Row]:
        """The rows as a study's `points`; of a cell without a number there is no key."""
        found = []
        for line, cells in self._cells(AXES):
            point: Row = {"line": line}
            for key, value in cells.items():
                other, _, inner = key.rpartition(".")
                if other:
                    point.setdefault("others", {}).setdefault(other, {})[inner] = value
                else:
                    point["name" if key == "point" else key] = value
            if {*DISPLACEMENT}.isdisjoint(point):
                raise self.error(line, "has no displacement")
            found.append(point)
        return found

    def columns(self, keys: tuple[str, ...]) -> NDArray[np.float64]:
        """(rows, keys) numbers of some columns, each complete [m, or as they are]."""
        for key in keys:
            if key not in self.keys:
                raise self.error(self._header_line, f"has no column {shown(key)}")
        return np.array([[cells[key] for key in keys] for _, cells in self._cells(keys)], dtype=float)

    def _cells(self, needed: tuple[str, ...]) -> list[tuple[int, Row]]:
        """(line, values by key) of each row, which has a value of each key that is needed."""
        found = []
        for line, row in self._rows:
            if len(row) != len(self._columns):
                raise self.error(line, f"has {len(row)} cells, the header {len(self._columns)}")
            cells: Row = {}
            for (key, unit), cell in zip(self._columns, row, strict=True):
                if not cell.strip():
                    continue
                cells[key] = cell.strip() if key == "point" else self._number(line, key, unit, cell.strip())
            if missing := [key for key in needed if key not in cells]:
                raise self.error(line, f"has no {missing[0]}")
            found.append((line, cells))
        return found

    def _number(self, line: int, key: str, unit: str, cell: str) -> float:
        try:
            plain = float(cell)
        except ValueError:
            raise self.error(line, f"{key}: {shown(cell)} is no number") from None
        if not math.isfinite(plain):
            raise self.error(line, f"{key}: must be a finite number")
        if key == "uncertainty" and plain < 0:
            raise self.error(line, f"{key}: must be positive or zero, not {plain:g}")
        try:
            return to_si(f"{cell} {unit}" if unit else plain, self._si(key) or "1")
        except QuantityError as error:
            raise self.error(line, f"{key}: {error}") from None

    def _si(self, key: str) -> str:
        """SI unit of a column, "" of one without."""
        if key == "force" or (key == "uncertainty" and self._forces):
            return "N"
        return "m" if key.rpartition(".")[2] in _LENGTHS else ""

    def _column(self, title: str) -> tuple[str, str]:
        """(key, unit) of a column."""
        match = _HEADER.fullmatch(title.strip())
        other, key, unit = match.group("other", "key", "unit") if match else (None, "", None)
        known = {*DISPLACEMENT} if other else _LENGTHS | {"point", "load_factor", "node", "force"}
        if key not in known:
            told = ", ".join(
                ("point", *AXES, *DISPLACEMENT, "uncertainty", "load_factor", *DEFORMED, *FORCES)
            )
            raise self.error(self._header_line, f"unknown column {shown(title.strip())}; known: {told}")
        if unit is not None:
            try:
                if not self._si(key):
                    raise QuantityError("has no unit")
                to_si(f"1 {unit}", self._si(key))
            except QuantityError as error:
                raise self.error(self._header_line, f"column {key}: {error}") from None
        return f"{other}.{key}" if other else key, unit or ""


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """(line, cells) of each row, the header first."""
    lines = io.StringIO(text, newline=None).read().split("\n")
    kept = [(k, line) for k, line in enumerate(lines, start=1) if line.strip() and not line.startswith("#")]
    return [(k, next(csv.reader([line]))) for k, line in kept]


# --- the table of a study ---


MOST_TABLES = 50
_SAME_LOAD = 1e-9  # of the largest load factor
_Deviation = Annotated[float, SI("m"), not_negative]


class Displacement(Table):
    """A displacement of which not every component is known"""

    displacement_x: Annotated[float, SI("m")] | None = Field(None, description="along x")
    displacement_y: Annotated[float, SI("m")] | None = Field(None, description="along y")
    displacement_z: Annotated[float, SI("m")] | None = Field(None, description="along z")

    def components(self) -> dict[int, float]:
        """Axis -> value of what is known [m]."""
        values = (getattr(self, key) for key in DISPLACEMENT)
        return {axis: value for axis, value in enumerate(values) if value is not None}


class MeasuredPoint(Displacement):
    """One point of a measured table"""

    name: Annotated[str, AfterValidator(one_line)] = Field(
        "", description="names it in the report", max_length=MAX_NAME
    )
    x: Annotated[float, SI("m")] = Field(description="its place at rest, on the body's surface")
    y: Annotated[float, SI("m")] = Field(description="its place at rest")
    z: Annotated[float, SI("m")] = Field(description="its place at rest")
    uncertainty: _Deviation | None = Field(
        None, description="standard uncertainty of each component, instead of the table's"
    )
    load_factor: Annotated[float, SI("1")] | None = Field(
        None, description="load step, instead of the table's"
    )
    line: int | None = Field(None, description="its line in the CSV file, for messages", ge=1)
    others: dict[str, Displacement] = Field(
        {}, description="what other programs computed there, by their name", max_length=10
    )


class MeasuredForce(Table):
    """One point of a curve of force against depth"""

    depth: Annotated[float, SI("m"), positive] = Field(
        description="of a contact the largest displacement of its nodes, inwards along the normal; of an indenter "
        "its way from where it first touches; of what moves a region the movement"
    )
    force: Annotated[float, SI("N")] = Field(description="resultant, in the direction of the depth")
    uncertainty: Annotated[float, SI("N"), not_negative] | None = Field(
        None, description="standard uncertainty, instead of the table's"
    )
    line: int | None = Field(None, description="its line in the CSV file, for messages", ge=1)


class Measured(Table):
    """[[measured]]: points with displacements, a deformed surface, or force against depth"""

    name: Name = Field(description="names it in the report; the file's name where left out")
    path: str | None = Field(
        None,
        description="a CSV file beside the study: columns `point`, `x`, `y`, `z`, `displacement_x`, "
        "`displacement_y`, `displacement_z`, `uncertainty`, `load_factor`, units in brackets as in `x [mm]`; an "
        "empty cell was not measured; `NAME.displacement_x` is what another program computed; of a deformed "
        "surface `deformed_x`, `deformed_y`, `deformed_z`; of force against depth `depth`, `force`, `uncertainty`",
    )
    source: Annotated[str, AfterValidator(one_line)] = Field(
        "", description="who measured, in one line for the report", max_length=500
    )
    uncertainty: _Deviation | None = Field(
        None, description="standard uncertainty u_D of each component, where a point has none of its own"
    )
    load_factor: Annotated[float, SI("1")] | None = Field(
        None, description="load factor of [load] that the values belong to; the largest where left out"
    )
    swept: str | None = Field(None, description="swept key whose value tells which cases were measured")
    at: float | str | None = Field(None, description="that value, a number or a text with a unit")
    points: tuple[MeasuredPoint, ...] = Field(
        (), description="the points themselves, instead of a path", strict=False
    )
    surface: tuple[Position, ...] = Field(
        (), description="places on the deformed surface, instead of points", strict=False
    )
    forces: tuple[MeasuredForce, ...] = Field(
        (), description="force against depth, instead of points", strict=False
    )
    force_uncertainty: Annotated[float, SI("N"), not_negative] | None = Field(
        None, description="standard uncertainty u_D of the forces, where one has none of its own"
    )
    constraint: str | None = Field(
        None,
        description="name of the contact, indenter or movement whose force it is; needed where there are several",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_file(cls, data: Any, info: ValidationInfo) -> Any:
        """The file's values in the place of its path, so that a case carries all that decides its numbers."""
        if not isinstance(data, dict) or data.get("path") is None:
            return data
        if data.keys() & {"points", "surface", "forces"}:
            raise ValueError("give path, points, surface or forces; one of them")
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

    def belongs_to(self, swept: Mapping[str, Any], units: Mapping[str, str]) -> bool:
        """Whether the values were measured on the case of these swept values."""
        if self.swept is None:
            return True
        if self.swept not in swept:
            return False
        value, unit = swept[self.swept], units.get(self.swept, "1")
        if isinstance(value, str):
            return value == self.at
        return math.isclose(float(value), _quantity(self.at, unit), rel_tol=1e-9)


def _quantity(value: float | str | None, unit: str) -> float:
    try:
        return to_si(value, unit)
    except QuantityError:
        return math.nan


def same_load(factor: float, other: float, largest: float) -> bool:
    """Whether two load factors of a history are one."""
    return abs(factor - other) <= _SAME_LOAD * max(abs(largest), 1e-300)
