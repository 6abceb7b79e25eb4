"""What all tables of a study file share: unknown keys are errors, and a lenient pass goes on past faults."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo

from .problems import Source
from .units import type_name


class Enters(Enum):
    """Which keys a field of the study, or of one of its tables, enters; unmarked: of answers and case."""

    NOTHING = "presentation"  # names, words, limits of acceptance: no number hangs on them
    MESH = "mesh"  # the geometry's own key (`geometry_spec.geometry_key`)
    CASE = "case"  # what is made of answers, and not the answers

    @classmethod
    def of(cls, field: FieldInfo) -> Enters | None:
        """What a field is marked with; None of one that enters every key."""
        return next((mark for mark in field.metadata if isinstance(mark, cls)), None)


@dataclass(frozen=True)
class Context:
    """How to validate: the file that paths are relative to, and whether to go on past faults.

    A lenient pass puts None in the place of every faulty or missing value, so that checks across keys can still
    tell what else is wrong. Its result is never handed out.
    """

    source: Source
    lenient: bool = False


def as_path(value: Any, info: ValidationInfo) -> Path:
    """The file that a study names, located. Raises ValueError."""
    if not isinstance(value, str | Path):
        raise ValueError(f"must be a file's path, not {type_name(value)}")
    context = info.context
    return context.source.locate(value) if isinstance(context, Context) else Path(value)


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

    @field_validator("*", mode="wrap")
    @classmethod
    def _pass_over_faults(
        cls, value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> Any:
        try:
            return handler(value)
        except ValidationError:
            if isinstance(info.context, Context) and info.context.lenient:
                return None
            raise

    @model_validator(mode="before")
    @classmethod
    def _prepare(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict):
            return data
        data = cls.with_defaults(data)
        if isinstance(info.context, Context) and info.context.lenient:
            names = {field.alias or name: field for name, field in cls.model_fields.items()}
            missing = {name: None for name, field in names.items() if field.is_required()}
            keep_all = cls.model_config.get("extra") == "allow"
            data = missing | {key: value for key, value in data.items() if keep_all or key in names}
        return data

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """`data` with those defaults that depend on other keys."""
        return data

    def without(self, data: dict[str, Any], *marks: Enters) -> dict[str, Any]:
        """Of this table's `data` what does not bear one of these marks, two levels deep; unknown keys stay."""
        fields = {field.alias or name: (name, field) for name, field in type(self).model_fields.items()}
        kept: dict[str, Any] = {}
        for key, value in data.items():
            name, field = fields.get(key, (key, None))
            if field is not None and Enters.of(field) in marks:
                continue
            table = getattr(self, name) if field is not None else None
            kept[key] = table.without(value, *marks) if isinstance(table, Table) else value
        return kept
