"""The JSON schema of a study file, for editors: made from the tables that validate it."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from .fields import item_type, keys_of, type_of_field, unwrapped
from .kinds import SI
from .schema import Inputs, Region, Study, StudyInfo, Sweep
from .table import Table

_PLAIN: dict[Any, str] = {bool: "boolean", int: "integer", float: "number"}
_AXIS = {
    "description": "an axis: the values of a key of the study, or a range of them",
    "anyOf": [
        {"type": "array", "items": {"type": ["number", "string", "boolean"]}},
        {"type": "object", "required": ["start", "stop"]},
    ],
}
_INPUT = {
    "description": "how well a key of the study is known: a standard deviation or a range",
    "type": "object",
    "properties": {
        "sd": {"type": ["number", "string"]},
        "range": {"type": "array", "items": {"type": ["number", "string"]}, "minItems": 2, "maxItems": 2},
    },
}
_FURTHER: dict[type[Table], Any] = {Sweep: _AXIS, Inputs: _INPUT}


def study_schema() -> dict[str, Any]:
    """The schema: every key with its help. It leaves what concerns several keys, and what a sweep fills in."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A study of vdmbench",
        **_table(Study, ()),
        "$defs": {"region": _table(Region, ("regions", "NAME"))},
    }


def _table(table: type[Table], loc: tuple[str, ...]) -> dict[str, Any]:
    fields = keys_of(table)
    found: dict[str, Any] = {
        "type": "object",
        "properties": {key: _field(field, (*loc, key)) for key, field in fields.items()},
        "additionalProperties": _FURTHER.get(table, False),
    }
    if table in (Study, StudyInfo):  # in the other tables a sweep may give what is missing
        found["required"] = [key for key, field in fields.items() if field.is_required()]
    return found


def _field(field: FieldInfo, loc: tuple[str, ...]) -> dict[str, Any]:
    annotation, si = type_of_field(field)
    told = {"description": field.description} if field.description else {}
    return told | _type(annotation, si, loc)


def _type(annotation: Any, si: SI | None, loc: tuple[str, ...]) -> dict[str, Any]:
    if si is not None:
        kinds = [_quantities(count) for count in si.counts]
        return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    origin = get_origin(annotation)
    if origin is Literal:
        return {"enum": list(get_args(annotation))}
    if annotation is Region:
        part = {"$ref": "#/$defs/region"}
        return part if len(loc) == 2 and loc[0] == "regions" else {"anyOf": [{"type": "string"}, part]}
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return _table(annotation, loc)
    if origin is dict:
        return {
            "type": "object",
            "additionalProperties": _type(*unwrapped(item_type(annotation, loc)), (*loc, "NAME")),
        }
    if origin is tuple:
        return {"type": "array", "items": _type(*unwrapped(item_type(annotation, loc)), (*loc, "0"))}
    if annotation in _PLAIN:
        return {"type": _PLAIN[annotation]}
    if origin is not None:  # of several types
        return {"anyOf": [_type(*unwrapped(option), loc) for option in get_args(annotation)]}
    return {"type": "string"}


def _quantities(count: int) -> dict[str, Any]:
    """A number in SI units or a text with a unit; several of them, or any number of them (0)."""
    one = {"type": ["number", "string"]}
    if count == 1:
        return one
    return {"type": "array", "items": one} | ({"minItems": count, "maxItems": count} if count else {})
