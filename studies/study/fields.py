"""All keys of a study file as one JSON schema, made by pydantic from the tables that validate it.

From it are read what a sweep can vary, and the reference of all keys; an editor takes it as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any, get_args

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from .errors import Loc, entry_name
from .kinds import SI, OneOf, Table
from .schema import MOST_NAMES, Inputs, Known, Range, Study, StudyInfo, Sweep, VdmTable, model_table

Node = dict[str, Any]  # of the schema

_NEVER_SWEPT = {"study", "sweep", "inputs", "limits", "calibration", "acceptance", "measured"}
# tables whose numbers decide how much is computed, or the body itself
NEVER_AN_INPUT = {*_NEVER_SWEPT, "geometry", "load", "uncertainty"}


def unit_of(table: Table, name: str) -> str:
    """SI unit of a field, "" of one that is no quantity."""
    field = type(table).model_fields[name]
    inside = [mark for option in get_args(field.annotation) for mark in getattr(option, "__metadata__", ())]
    return next((mark.unit for mark in [*field.metadata, *inside] if isinstance(mark, SI)), "")


# --- the schema ---


# what the keys of these tables besides their own are: a table inside, its type and help
_ENTRIES: dict[Any, tuple[type[Table], str, str]] = {
    Sweep: (
        Range,
        "list of values, or a range",
        "an axis: KEY is the path of a key that takes one number or text, such as `regions.finger.cap.angle`, "
        "`constraints.finger.force` (a constraint goes by its name or region) or `gravity.acceleration.2` (a "
        f"component by its index); not of {', '.join(f'`{name}`' for name in sorted(_NEVER_SWEPT))}",
    ),
    Inputs: (
        Known,
        "table",
        "how well a number is known: KEY is the path of a quantity, as in a sweep; sd or range; not of "
        f"{', '.join(f'`{name}`' for name in sorted(NEVER_AN_INPUT))}",
    ),
}


class _OfFile(GenerateJsonSchema):
    """A file has no null and no titles, and a sweep may give what a table lacks, which is under `needs`."""

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
    """Every key with its help and unit. What concerns several keys it leaves to `checks`."""
    return _schema(model_table())  # with what models declare as their own


@cache
def _schema(of_model: type[VdmTable]) -> Node:
    found = Study.model_json_schema(schema_generator=_OfFile)
    found["properties"]["models"]["additionalProperties"] = of_model.model_json_schema(
        schema_generator=_OfFile
    )
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "A study of vdmbench"}
    return about | found


def followed(node: Node) -> Node:
    """A node, or what it refers to with the words of its own."""
    if "$ref" not in node:
        return node
    own = {key: value for key, value in node.items() if key != "$ref"}
    return {**study_schema()["$defs"][node["$ref"].rpartition("/")[2]], **own}


def items_of(node: Node) -> Node | None:
    """What a table of tables, or a list of them, holds; None of any other node."""
    inside = node.get("additionalProperties") if "properties" not in node else None
    if inside is None and node.get("type") == "array":
        inside = node["items"]
    found = followed(inside) if isinstance(inside, dict) else {}
    return found if "properties" in found else None


def kinds_of(table: Node) -> dict[str, Node]:
    """Of a table of several kinds the word of each, and its own table."""
    rules = table.get("allOf", [])
    return {
        word["const"]: followed(rule["then"]) for rule in rules for word in rule["if"]["properties"].values()
    }


# --- what a sweep can vary ---


@dataclass(frozen=True)
class Target:
    """A value of a study that a sweep can vary: where it is, and its unit where it is a quantity."""

    loc: Loc
    si: SI | None

    @property
    def unit(self) -> str:
        """SI unit, "1" where it has none."""
        return self.si.unit if self.si else "1"


def targets(data: Mapping[str, Any]) -> dict[str, Target]:
    """Every key path that `data`, as parsed from a study file, lets a sweep vary.

    Constraints, regions and the tables of single models go by their names (`constraints.finger.pressure`), the
    components of a vector by their index (`gravity.acceleration.2`). Each model of the study can have a table.
    """
    found: dict[str, Target] = {}
    for name, node in study_schema()["properties"].items():
        if name not in _NEVER_SWEPT:
            value = _of_each_model(data) if name == "models" else data.get(name)
            for key, target in _targets(node, name, (name,), value):
                found.setdefault(key, target)
    return found


def _of_each_model(data: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of single models, empty where a model of the study has none."""
    study, given = data.get("study"), data.get("models")
    listed = study.get("models") if isinstance(study, dict) else None
    names = [name for name in listed if isinstance(name, str)] if isinstance(listed, list | tuple) else []
    return {name: {} for name in names} | (given if isinstance(given, dict) else {})


def _targets(node: Node, key: str, loc: Loc, value: Any) -> Iterator[tuple[str, Target]]:
    node = followed(node)
    items = items_of(node)
    if "properties" in node:
        if value is None and len(loc) > 1:
            return  # an optional table inside another, which a value of a sweep cannot complete
        inside = value if isinstance(value, dict) else {}
        kinds, named = kinds_of(node), inside.get(next(iter(node["properties"])))
        chosen = [kind for word, kind in kinds.items() if word == named] or list(kinds.values())
        fields = {name: field for kind in chosen or [node] for name, field in kind["properties"].items()}
        for name, field in fields.items():
            yield from _targets(field, f"{key}.{name}", (*loc, name), inside.get(name))
    elif items is not None:
        for name, place, item in islice(_named(value), MOST_NAMES):  # more are refused
            yield from _targets(items, f"{key}.{name}", (*loc, place), item)
    elif "unit" in node:
        yield key, Target(loc, SI(node["unit"]))
    elif "unit" in node.get("items", {}) and isinstance(value, list | tuple):
        for place in range(len(value)):
            yield f"{key}.{place}", Target((*loc, place), SI(node["items"]["unit"]))
    elif node.get("type") in ("string", "integer", "boolean"):
        yield key, Target(loc, None)


def _named(value: Any) -> Iterator[tuple[str, str | int, Any]]:
    """The items of a table of tables, or of the constraints, by name: (name, place, item)."""
    if isinstance(value, dict):
        yield from ((name, name, item) for name, item in value.items())
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            if (name := entry_name(item)) is not None:
                yield name, place, item
