"""All keys of a study file as one JSON schema, made by pydantic from the tables that validate it.

The reference of all keys is made from it; editors can use it directly.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from .kinds import OneOf, Table
from .schema import (
    NEVER_AN_INPUT,
    NEVER_SWEPT,
    Inputs,
    Known,
    Range,
    Study,
    StudyInfo,
    Sweep,
    VdmTable,
    model_table,
)

Node = dict[str, Any]  # of the schema

# further keys of these tables: the table inside, its type and help
_ENTRIES: dict[Any, tuple[type[Table], str, str]] = {
    Sweep: (
        Range,
        "list of values, or a range",
        "an axis: KEY is the path of a key that takes one number or text, such as `regions.finger.cap.angle`, "
        "`constraints.finger.force` (a constraint goes by its name or region) or `gravity.acceleration.2` (a "
        f"component by its index); not of {', '.join(f'`{name}`' for name in sorted(NEVER_SWEPT))}",
    ),
    Inputs: (
        Known,
        "table",
        "how well a number is known: KEY is the path of a quantity, as in a sweep; sd or range; not of "
        f"{', '.join(f'`{name}`' for name in sorted(NEVER_AN_INPUT))}",
    ),
}


class _OfFile(GenerateJsonSchema):
    """Schema of a file: without null and titles; keys under `needs` may come from a sweep instead."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        table = schema["cls"]
        if issubclass(table, OneOf) and table not in table.kinds.values():
            return self._by_kind(table)
        found = super().model_schema(schema)
        found.pop("title", None)
        if table not in (Study, StudyInfo):
            found["needs"] = found.pop("required", [])
        if table in (Range, Known):  # or tables around entries
            found.pop("additionalProperties")
        if table in _ENTRIES:
            inside, kind, told = _ENTRIES[table]
            inside.model_rebuild()
            options = [self.generate_inner(inside.__pydantic_core_schema__)]
            options += [{"type": "array", "items": {"type": ["number", "string"]}}] * (table is Sweep)
            found["additionalProperties"] = {"description": told, "title": kind, "anyOf": options}
        return found

    def _by_kind(self, table: type[OneOf]) -> JsonSchemaValue:
        """Each kind's own schema where the key that names it has its word."""
        rules = []
        for word, kind in table.kinds.items():
            kind.model_rebuild()
            named = {"properties": {table.by: {"const": word}}, "required": [table.by]}
            rules.append({"if": named, "then": self.generate_inner(kind.__pydantic_core_schema__)})
        words = {"enum": list(table.kinds), "description": table.model_fields[table.by].description}
        return {"type": "object", "properties": {table.by: words}, "allOf": rules}

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        found, default = self.generate_inner(schema["schema"]), schema.get("default")
        plain = isinstance(default, str | int | float | tuple) and default not in ("", ())
        return {**found, "default": self.encode_default(default)} if plain else found

    def field_title_should_be_set(self, _: Any) -> bool:
        return False


def study_schema() -> Node:
    """Every key with its help and unit. Conditions between keys are in `checks`."""
    return _schema(model_table())  # with what models declare as their own


@cache
def _schema(of_model: type[VdmTable]) -> Node:
    found = Study.model_json_schema(schema_generator=_OfFile)
    found["properties"]["models"]["additionalProperties"] = of_model.model_json_schema(
        schema_generator=_OfFile
    )
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A study of vdmbench"}
    return about | found
