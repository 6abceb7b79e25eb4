"""The kinds of values in a study file: quantities with units, names, directions, ranges of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeGuard, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import (
    CoreSchema,
    ErrorDetails,
    InitErrorDetails,
    PydanticCustomError,
    PydanticUndefined,
    core_schema,
)

from .errors import MOST_TOLD, Loc, Source, unknown
from .units import DIMENSIONS, NUMBER, QuantityError, shown, to_si, type_name

MAX_NAME = 64  # characters
MOST_NUMBERS = 10_000  # of a list of quantities
_PERCENT = re.compile(rf"\s*({NUMBER})\s*%\s*")
_NAME = re.compile(rf"[A-Za-z0-9][A-Za-z0-9_.-]{{0,{MAX_NAME - 1}}}")

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class SI:
    """A quantity in `unit`: one number, or a list of `count` numbers (0: any from 1 to `MOST_NUMBERS`)."""

    unit: str
    count: int = 1

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)

    def __get_pydantic_json_schema__(self, _: CoreSchema, __: GetJsonSchemaHandler) -> dict[str, Any]:
        one = {"type": ["number", "string"], "unit": self.unit}
        if self.count == 1:
            return one
        size = {"minItems": self.count, "maxItems": self.count} if self.count else {}
        return {"type": "array", "items": one, **size}

    def read(self, value: Any) -> float | tuple[float, ...]:
        """Convert a value of a study file. Raises QuantityError."""
        if self.count == 1:
            return to_si(value, self.unit)
        wanted = f"{self.count} numbers" if self.count else "at least one number"
        if not isinstance(value, list | tuple):
            raise QuantityError(f"must be a list of {wanted}, not {type_name(value)}")
        if not value or len(value) != (self.count or len(value)):
            raise QuantityError(f"must have {wanted}, not {len(value)}")
        if len(value) > MOST_NUMBERS:
            raise QuantityError(f"must have at most {MOST_NUMBERS:,} numbers, not {len(value):,}")
        numbers = []
        for place, item in enumerate(value, start=1):
            try:
                numbers.append(to_si(item, self.unit))
            except QuantityError as error:
                raise QuantityError(f"item {place}: {error}") from None
        return tuple(numbers)


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


def within(low: float, high: float, unit: str = "") -> AfterValidator:
    """Bounds of a number; for a quantity in SI `unit`, a value outside probably has a wrong unit."""
    mixed = (
        f' {unit} (a mixed-up unit? a bare number is in {unit}: write "{DIMENSIONS[unit][1]}")'
        if unit
        else ""
    )
    return number_check(lambda v: low <= v <= high, f"must lie between {low:g} and {high:g}{mixed}")


def is_safe_name(value: Any) -> TypeGuard[str]:
    """Whether `safe_name` accepts a value."""
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


def _as_share(value: Any) -> Any:
    """A text such as "5 %" as its number; a plain number stays."""
    if not isinstance(value, str):
        return value
    match = _PERCENT.fullmatch(value)
    if match is None:
        raise ValueError(
            f'{shown(value)} is not a share; write it as "5 %" or as a plain number, such as 0.05'
        )
    return float(Decimal(match.group(1)) / 100)


Plain = Annotated[float, SI("1")]
Plains = Annotated[tuple[float, ...], SI("1", 0)]
Ratio = Annotated[float, SI("1"), positive]
Fraction = Annotated[float, SI("1"), within(0, 1)]
Coordinate = Annotated[float, SI("m")]
Length = Annotated[float, SI("m"), positive]
Lengths = Annotated[Vector3, SI("m", 3), positive]
Time = Annotated[float, SI("s"), positive]
Share = Annotated[
    float,
    SI("1"),
    number_check(lambda v: 0 < v <= 1, 'must be above 0 and at most 1, which is 100 % (write "5 %" or 0.05)'),
    BeforeValidator(_as_share),
]
Position = Annotated[Vector3, SI("m", 3)]
Direction = Annotated[Vector3, SI("1", 3), AfterValidator(nonzero)]
Force = Annotated[Vector3, SI("N", 3)]
Modulus = Annotated[float, SI("Pa"), not_negative]
LineForce = Annotated[float, SI("N/m"), not_negative]
Pressure = Annotated[float, SI("Pa")]
Name = Annotated[str, AfterValidator(safe_name)]
Axis = Literal["x", "y", "z"]
Rotation = Literal["none", "global"]


# --- shared by all tables of a study file ---


def Key(told: str, default: Any = PydanticUndefined, **checks: Any) -> Any:
    """A key of a table: its help, its default if it is optional, and further arguments of `pydantic.Field`."""
    return Field(default, description=told, **checks)


class Enters(Enum):
    """The content keys that a field of the study or its tables enters; unmarked fields enter answers and case."""

    NOTHING = "presentation"  # names, words, limits of acceptance: they decide no number
    MESH = "mesh"  # the geometry's own key (`shapes.geometry_key`)
    CASE = "case"  # evaluations of answers, not the answers themselves
    ANSWERS = "answers"  # answers and case, in a table with other marks

    @classmethod
    def of(cls, field: FieldInfo) -> Enters | None:
        """The mark of a field; None if it enters every key."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), None)


def as_path(value: Any, info: ValidationInfo) -> Path:
    """The file that a study names, located by the `Source` in the context. Raises ValueError."""
    if not isinstance(value, str | Path):
        raise ValueError(f"must be a file's path, not {type_name(value)}")
    return info.context.locate(value) if isinstance(info.context, Source) else Path(value)


_FOLLOWS = "default_factory_not_called"  # a default that depends on another invalid key, reported there
_WANTED = {  # kind of pydantic error -> what the value must be
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "a text",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "int_from_float": "a whole number",
}


class Table(BaseModel):
    """A table of a study file: unknown keys are errors, nothing is coerced, values do not change.

    Mistakes are reported in sentences for the author of the file, each at its place.
    """

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        hide_input_in_errors=True,
        defer_build=True,
    )
    enters: ClassVar[Enters | None] = None  # mark of the fields without their own

    def model_dump(self, **options: Any) -> dict[str, Any]:
        """Plain data with the keys of a file, without nulls."""
        return super().model_dump(**{"exclude_none": True, **options})

    def model_dump_json(self, **options: Any) -> str:
        """As JSON text, which `model_validate_json` takes back."""
        return super().model_dump_json(**{"exclude_none": True, **options})

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        try:
            return cls.of(data, handler, info)
        except ValidationError as error:
            found = [fault for fault in error.errors(include_url=False) if fault["type"] != _FOLLOWS]
            faults = [cls._fault(details) for details in found[: MOST_TOLD + 1]]  # some faults take a search
            raise ValidationError.from_exception_data(cls.__name__, faults) from None

    @classmethod
    def of(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:  # noqa: ARG003
        """The table of given data. Raises ValidationError."""
        return handler(data)

    @classmethod
    def missing_key(cls, key: str) -> str:
        """The message for a missing key."""
        return f"is missing: {cls.model_fields[key].description}"

    @classmethod
    def _fault(cls, details: ErrorDetails) -> InitErrorDetails:
        loc = tuple(part for part in details["loc"] if part != "[key]")
        told = PydanticCustomError("told", "{text}", {"text": cls._sentence(loc, details)})
        return InitErrorDetails(type=told, loc=loc, input=None)

    @classmethod
    def _sentence(cls, loc: Loc, details: ErrorDetails) -> str:
        kind, value = details["type"], details.get("input")
        if kind == "told":  # reported by an inner table
            return details["msg"]
        if kind == "value_error":
            return str(details["ctx"]["error"])
        if kind == "missing":
            return cls.missing_key(str(loc[-1]))
        if kind == "extra_forbidden":
            return unknown(str(loc[-1]), list(cls.model_fields), "key")
        if kind == "literal_error":
            options = re.findall(r"'([^']*)'", details["ctx"]["expected"])
            if isinstance(value, str):
                return unknown(value, options, "choice")
            return f"must be one of {', '.join(options)}, not {type_name(value)}"
        if kind in _WANTED:
            return f"must be {_WANTED[kind]}, not {type_name(value)}"
        return re.sub(r"^(Input|String|Tuple|Dictionary|Value) should", "must", details["msg"])

    @classmethod
    def unit(cls, key: str) -> str:
        """SI unit of a key: "1" for one without a dimension, "" for one that is no quantity."""
        field = cls.model_fields[key]
        inside = [
            mark for option in get_args(field.annotation) for mark in getattr(option, "__metadata__", ())
        ]
        return next((mark.unit for mark in (*field.metadata, *inside) if isinstance(mark, SI)), "")

    def without(self, data: dict[str, Any], *marks: Enters) -> dict[str, Any]:
        """This table's `data` without fields that have one of these marks, two levels deep; unknown keys stay."""
        kept: dict[str, Any] = {}
        for key, value in data.items():
            field = type(self).model_fields.get(key)
            if field is not None and (Enters.of(field) or self.enters) in marks:
                continue
            table = getattr(self, key) if field is not None else None
            kept[key] = table.without(value, *marks) if isinstance(table, Table) else value
        return kept


class OneOf(Table):
    """A table of several kinds, each a class of its own: what its key `by` says, as a `Literal`, registers it.

    A key that another kind has is None.
    """

    by: ClassVar[str]
    kinds: ClassVar[dict[str, Any]]  # of the common class: what a file writes -> class

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        words = get_args(cls.model_fields[cls.by].annotation) if cls.by in cls.model_fields else ()
        cls.kinds.update(dict.fromkeys(words, cls))

    @classmethod
    def of(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        """The table of the kind that the data name. Raises ValidationError."""
        if cls in cls.kinds.values() or not isinstance(data, dict):
            return super().of(data, handler, info)
        word = data.get(cls.by)
        if isinstance(word, str) and word in cls.kinds:
            found: Self = cls.kinds[word].model_validate(data, context=info.context)
            return found
        fault: Any = InitErrorDetails(type="missing", loc=(cls.by,), input=data)
        if cls.by in data:
            expected = ", ".join(f"'{known}'" for known in cls.kinds)
            fault = InitErrorDetails(
                type="literal_error", loc=(cls.by,), input=word, ctx={"expected": expected}
            )
        raise ValidationError.from_exception_data(cls.__name__, [fault])

    @classmethod
    def missing_key(cls, key: str) -> str:
        """The message for a missing key; for the kind, with all kinds."""
        one_of = f", one of {', '.join(cls.kinds)}" if key == cls.by else ""
        return super().missing_key(key) + one_of

    def __getattr__(self, name: str) -> Any:
        if any(name in kind.model_fields for kind in self.kinds.values()):
            return None
        return super().__getattr__(name)  # type: ignore[misc]
