"""The JSON schema of a study file, for editors: made by pydantic from the tables that validate it."""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from .schema import Inputs, Study, StudyInfo, Sweep, model_table

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
_FURTHER: dict[Any, Any] = {Sweep: _AXIS, Inputs: _INPUT}


class _OfFile(GenerateJsonSchema):
    """A file has no null and no titles, and a sweep may give what a table lacks."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        found = super().model_schema(schema)
        table = schema["cls"]
        found.pop("title", None)
        if table not in (Study, StudyInfo):
            found.pop("required", None)
        if table in _FURTHER:
            found["additionalProperties"] = _FURTHER[table]
        return found

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def field_title_should_be_set(self, _: Any) -> bool:
        return False


def study_schema() -> dict[str, Any]:
    """The schema: every key with its help. It leaves what concerns several keys, and what a sweep fills in."""
    found = Study.model_json_schema(schema_generator=_OfFile)
    of_model = model_table().model_json_schema(
        schema_generator=_OfFile
    )  # with what models declare as their own
    found["properties"]["models"]["additionalProperties"] = of_model
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A study of vdmbench"}
    return about | found
