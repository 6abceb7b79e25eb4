"""The kinds of values that a study file holds: quantities with their unit, names, directions, ranges of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeGuard

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationInfo,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import CoreSchema, core_schema

from .errors import Source
from .units import NUMBER, QuantityError, shown, to_si, type_name

MAX_NAME = 64  # characters
MOST_NUMBERS = 10_000  # of a list of quantities
_PERCENT = re.compile(rf"\s*({NUMBER})\s*%\s*")
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{MAX_NAME - 1}}}")

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class SI:
    """A quantity in `unit`: one number, or a list of `counts` numbers (0: any from 1 to `MOST_NUMBERS`)."""

    unit: str
    counts: tuple[int, ...] = (1,)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, _: CoreSchema, __: GetJsonSchemaHandler) -> dict[str, Any]:
        kinds = [self._quantities(count) for count in self.counts]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}

    @staticmethod
    def _quantities(count: int) -> dict[str, Any]:
        """A number in SI units or a text with a unit; several of them, or any number of them (0)."""
        one = {"type": ["number", "string"]}
        if count == 1:
            return one
        return {"type": "array", "items": one} | ({"minItems": count, "maxItems": count} if count else {})

    def read(self, value: Any) -> float | tuple[float, ...]:
        """Convert a value of a study file. Raises QuantityError."""
        if self.counts == (1,) or not isinstance(value, list | tuple):
            if 1 not in self.counts:
                raise QuantityError(f"must be a list of {self._wanted()}, not {type_name(value)}")
            return to_si(value, self.unit)
        if not value or not {0, len(value)} & (set(self.counts) - {1}):
            raise QuantityError(f"must have {self._wanted()}, not {len(value)}")
        if len(value) > MOST_NUMBERS:
            raise QuantityError(f"must have at most {MOST_NUMBERS:,} numbers, not {len(value):,}")
        numbers = []
        for place, item in enumerate(value, start=1):
            try:
                numbers.append(to_si(item, self.unit))
            except QuantityError as error:
                raise QuantityError(f"item {place}: {error}") from None
        return tuple(numbers)

    def _wanted(self) -> str:
        counts = [str(count) for count in self.counts if count > 1]
        return f"{' or '.join(counts)} numbers" if counts else "at least one number"


def number_check(holds: Callable[[float], bool], message: str) -> AfterValidator:
    """A condition on a number, or on each of several."""

    def check(value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            if not holds(number):
                raise ValueError(f"{message}, not {number:g}")
        return value

    return AfterValidator(check)


positive = number_check(lambda v: v > 0, "must be positive")
not_negative = number_check(lambda v: v >= 0, "must be positive or zero")


def is_safe_name(value: Any) -> TypeGuard[str]:
    """Whether a value is a name that `safe_name` lets pass."""
    return isinstance(value, str) and _NAME.fullmatch(value) is not None


def safe_name(value: str) -> str:
    """A name that is safe in a path, an HTML page and a key. Raises ValueError."""
    if not is_safe_name(value):
        raise ValueError(
            f"{shown(value)} is not a usable name: begin with a letter or digit, then letters, digits, _ . - "
            f"({MAX_NAME} characters at most)"
        )
    return value


def one_line(value: str) -> str:
    if not value.isprintable():
        raise ValueError("must be one line without control characters")
    return value


def nonzero(value: Vector3) -> Vector3:
    if not 0 < math.hypot(*value) < math.inf:
        raise ValueError("must not be the zero vector")
    return value


def _no_nodal_rotation(value: Any) -> Any:
    if value == "nodal":
        raise ValueError(
            "is gone, as its answer grows without limit on finer meshes; "
            'write rotation = "global", one rotation for the body, or leave it out'
        )
    return value


def _as_share(value: Any) -> Any:
    """A text such as "5 %" as the number that it is; a plain number stays."""
    if not isinstance(value, str):
        return value
    match = _PERCENT.fullmatch(value)
    if match is None:
        raise ValueError(
            f'{shown(value)} is not a share; write it as "5 %" or as a plain number, such as 0.05'
        )
    return float(Decimal(match.group(1)) / 100)


Length = Annotated[float, SI("m"), positive]
Time = Annotated[float, SI("s"), positive]
Share = Annotated[
    float,
    SI("1"),
    number_check(lambda v: 0 < v <= 1, 'must be above 0 and at most 1, which is 100 % (write "5 %" or 0.05)'),
    BeforeValidator(_as_share),
]
Position = Annotated[Vector3, SI("m", (3,))]
Direction = Annotated[Vector3, SI("1", (3,)), AfterValidator(nonzero)]
Force = Annotated[Vector3, SI("N", (3,))]
Modulus = Annotated[float, SI("Pa"), not_negative]
LineForce = Annotated[float, SI("N/m"), not_negative]
Pressure = Annotated[float, SI("Pa")]
Name = Annotated[str, AfterValidator(safe_name)]
Axis = Literal["x", "y", "z"]
Rotation = Annotated[Literal["none", "global"], BeforeValidator(_no_nodal_rotation)]


# --- What all tables of a study file share ---


class Enters(Enum):
    """Which keys a field of the study, or of one of its tables, enters; unmarked: of answers and case."""

    NOTHING = "presentation"  # names, words, limits of acceptance: no number hangs on them
    MESH = "mesh"  # the geometry's own key (`shapes.geometry_key`)
    CASE = "case"  # what is made of answers, and not the answers

    @classmethod
    def of(cls, field: FieldInfo) -> Enters | None:
        """What a field is marked with; None of one that enters every key."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), None)


def as_path(value: Any, info: ValidationInfo) -> Path:
    """The file that a study names, located from the `Source` that is the context. Raises ValueError."""
    if not isinstance(value, str | Path):
        raise ValueError(f"must be a file's path, not {type_name(value)}")
    return info.context.locate(value) if isinstance(info.context, Source) else Path(value)


class Table(BaseModel):
    """A table of a study file: unknown keys are errors, nothing is coerced, values do not change."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        hide_input_in_errors=True,
        defer_build=True,
        serialize_by_alias=True,
    )

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """As plain data with the keys of a file, which has no null."""
        return super().model_dump(**{"exclude_none": True, **options})

    def model_dump_json(self, **options: Any) -> str:
        """As JSON text, which `model_validate_json` takes back."""
        return super().model_dump_json(**{"exclude_none": True, **options})

    @model_validator(mode="before")
    @classmethod
    def _prepare(cls, data: Any) -> Any:
        return cls.with_defaults(data) if isinstance(data, dict) else data

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """`data` with those defaults that depend on other keys."""
        return data

    def without(self, data: dict[str, Any], *marks: Enters) -> dict[str, Any]:
        """Of this table's `data` what does not bear one of these marks, two levels deep; unknown keys stay."""
        fields = _by_key(type(self))
        kept: dict[str, Any] = {}
        for key, value in data.items():
            name, field = fields.get(key, (key, None))
            if field is not None and Enters.of(field) in marks:
                continue
            table = getattr(self, name) if field is not None else None
            kept[key] = table.without(value, *marks) if isinstance(table, Table) else value
        return kept


@cache
def _by_key(table: type[Table]) -> dict[str, tuple[str, FieldInfo]]:
    """Key in a file -> name and field of a table."""
    return {field.alias or name: (name, field) for name, field in table.model_fields.items()}


def given(table: Table) -> set[str]:
    """The keys that the file has, or that follow from others, as written there."""
    return {type(table).model_fields[name].alias or name for name in table.model_fields_set if name[0] != "_"}
