"""[[measured]]: what somebody measured on the body of a study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from .kinds import MAX_NAME, SI, Name, Position, is_safe_name, not_negative, one_line, positive
from .measured_file import DISPLACEMENT, read_measured
from .table import Table, as_path
from .units import QuantityError, to_si

MOST_TABLES = 50
_SAME_LOAD = 1e-9  # of the largest load factor
Uncertainty = Annotated[float, SI("m"), not_negative]


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
    uncertainty: Uncertainty | None = Field(
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
    uncertainty: Uncertainty | None = Field(
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
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
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
