"""Walks over the types of the study's tables: their reference, the table at a place, what can be swept."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin

from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from .errors import Loc
from .kinds import SI, OneOf, Table
from .schema import MOST_NAMES, Inputs, Known, Range, Region, Study, StudyInfo, Sweep, model_table
from .units import DIMENSIONS

_NEVER_SWEPT = {"study", "sweep", "inputs", "limits", "calibration", "acceptance", "measured"}
# tables whose numbers decide how much is computed, or the body itself
NEVER_AN_INPUT = {*_NEVER_SWEPT, "geometry", "load", "uncertainty"}


def unwrapped(annotation: Any) -> tuple[Any, SI | None]:
    """A type without `None` and metadata, and its unit; of a name or a table, the table."""
    si = None
    while True:
        if hasattr(annotation, "__metadata__"):
            si = next((item for item in annotation.__metadata__ if isinstance(item, SI)), si)
            annotation = get_args(annotation)[0]
            continue
        if get_origin(annotation) not in (Union, types.UnionType):
            return annotation, si
        options = [option for option in get_args(annotation) if option is not types.NoneType]
        tables = [option for option in options if _is_table(unwrapped(option)[0])]
        if len(options) > 1 and not tables:
            return annotation, si
        annotation = (tables or options)[0]


def _is_table(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Table)


def item_type(annotation: Any, loc: Loc) -> Any:
    """What a table of tables or a list holds; of the tables of single models, what these declare too."""
    if loc[:1] == ("models",):
        return model_table()
    return get_args(annotation)[1 if get_origin(annotation) is dict else 0]


def type_of_field(field: FieldInfo) -> tuple[Any, SI | None]:
    """The type of a field without `None` and metadata, and its unit."""
    annotation, si = unwrapped(field.annotation)
    return annotation, next((item for item in field.metadata if isinstance(item, SI)), si)


def unit_of(table: Table, name: str) -> str:
    """SI unit of a field, "" of one that is no quantity."""
    _, si = type_of_field(type(table).model_fields[name])
    return si.unit if si else ""


def _tables(table: type[Table], value: Any = None) -> list[type[Table]]:
    """Of a table of several kinds the one that a value is, all where it says none; any other table."""
    if not issubclass(table, OneOf):
        return [table]
    word = value.get(table.by) if isinstance(value, Mapping) else None
    return (
        [table.kinds[word]] if isinstance(word, str) and word in table.kinds else list(table.kinds.values())
    )


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
    for name, field in Study.keys().items():
        if name not in _NEVER_SWEPT:
            value = _of_each_model(data) if name == "models" else data.get(name)
            for key, target in _targets(*type_of_field(field), name, (name,), value):
                found.setdefault(key, target)
    return found


def value_at(data: Any, loc: Loc) -> Any:
    """The value at a place in the data of a study, None where there is none."""
    for part in loc:
        try:
            data = data[part]
        except (LookupError, TypeError):
            return None
    return data


def _of_each_model(data: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of single models, empty where a model of the study has none."""
    study, given = data.get("study"), data.get("models")
    listed = study.get("models") if isinstance(study, dict) else None
    names = [name for name in listed if isinstance(name, str)] if isinstance(listed, list | tuple) else []
    return {name: {} for name in names} | (given if isinstance(given, dict) else {})


def _targets(annotation: Any, si: SI | None, key: str, loc: Loc, value: Any) -> Iterator[tuple[str, Target]]:
    origin = get_origin(annotation)
    if _is_table(annotation):
        if value is None and len(loc) > 1:
            return  # an optional table inside another, which a value of a sweep cannot complete
        inside = value if isinstance(value, dict) else {}
        fields = {name: field for table in _tables(annotation, value) for name, field in table.keys().items()}
        for name, field in fields.items():
            yield from _targets(*type_of_field(field), f"{key}.{name}", (*loc, name), inside.get(name))
    elif origin is dict or (origin is tuple and _is_table(unwrapped(get_args(annotation)[0])[0])):
        for name, place, item in islice(_named(value), MOST_NAMES):  # more are refused
            inner, _ = unwrapped(item_type(annotation, loc))
            yield from _targets(inner, None, f"{key}.{name}", (*loc, place), item)
    elif si is not None and isinstance(value, list | tuple):
        for place in range(len(value)):
            yield f"{key}.{place}", Target((*loc, place), SI(si.unit))
    elif si is not None and 1 in si.counts:
        yield key, Target(loc, SI(si.unit))
    elif si is None and origin in (None, Literal):
        yield key, Target(loc, None)


def _named(value: Any) -> Iterator[tuple[str, str | int, Any]]:
    """The items of a table of tables, or of the constraints, by name: (name, place, item)."""
    if isinstance(value, dict):
        yield from ((name, name, item) for name, item in value.items())
    elif isinstance(value, list | tuple):
        for place, item in enumerate(value):
            name = item.get("name", item.get("region")) if isinstance(item, dict) else None
            if isinstance(name, str):
                yield name, place, item


# --- the reference of all keys ---


class FieldRow(NamedTuple):
    """One key of the study file, as a reference shows it."""

    key: str
    kind: str
    default: str
    help: str


def field_table() -> list[FieldRow]:
    """Every key of a study file with its type and unit, default and help, in the file's order."""
    return list(_rows(Study, ""))


def _rows(table: type[Table], prefix: str) -> Iterator[FieldRow]:
    if issubclass(table, OneOf):
        yield from _rows_of_kinds(table, prefix)
        return
    for name, field in table.keys().items():
        annotation, _ = type_of_field(field)
        origin, args = get_origin(annotation), get_args(annotation)
        if _is_table(annotation) and not (table is Region and annotation is Region):
            yield from _rows(annotation, f"{prefix}{name}.")
        elif origin is dict:
            yield from _rows(unwrapped(args[1])[0], f"{prefix}{name}.NAME.")
        elif origin is tuple and table is not Region and _is_table(unwrapped(args[0])[0]):
            yield from _rows(unwrapped(args[0])[0], f"{prefix}{name}[].")
        else:
            yield _row(prefix + name, field, field.description or "")
    if table in _ENTRIES:
        inside, kind, told, closed = _ENTRIES[table]
        entry = f'{prefix}"KEY"'
        never = ", ".join(f"`{name}`" for name in sorted(closed))
        yield FieldRow(entry, kind, "", f"{told}; not of {never}")
        yield from _rows(inside, f"{entry}.")


# what the keys of these tables besides their own are: a table inside, its type and help, and of which tables not
_ENTRIES: dict[Any, tuple[type[Table], str, str, set[str]]] = {
    Sweep: (
        Range,
        "list of values, or a range",
        "an axis: KEY is the path of a key that takes one number or text, such as `regions.finger.cap.angle`, "
        "`constraints.finger.force` (a constraint goes by its name or region) or `gravity.acceleration.2` (a "
        "component by its index)",
        _NEVER_SWEPT,
    ),
    Inputs: (
        Known,
        "table",
        "how well a number is known: KEY is the path of a quantity, as in a sweep; sd or range",
        NEVER_AN_INPUT,
    ),
}


def _row(key: str, field: FieldInfo, told: str) -> FieldRow:
    return FieldRow(key, _kind(*type_of_field(field)), _default(field), told)


def _rows_of_kinds(table: type[OneOf], prefix: str) -> Iterator[FieldRow]:
    """The keys of all kinds, and of each key which kinds have it."""
    words = ", ".join(f"{word}: {(kind.__doc__ or word).strip()}" for word, kind in table.kinds.items())
    yield FieldRow(f"{prefix}{table.by}", " | ".join(table.kinds), "required", words)
    for name, field in table.keys().items():
        if name != table.by:
            yield _row(prefix + name, field, field.description or "")
    owners: dict[str, dict[str, FieldInfo]] = {}
    for word, kind in table.kinds.items():
        for name, field in kind.own_keys().items():
            owners.setdefault(name, {})[word] = field
    for name, fields in owners.items():
        rows = {word: _row(prefix + name, field, field.description or "") for word, field in fields.items()}
        of_all = {row.kind: None for row in rows.values()}
        told: dict[str, list[str]] = {}
        for word, row in rows.items():
            told.setdefault(row.help, []).append(word)
        first = next(iter(rows.values()))
        yield first._replace(
            kind=" or ".join(sorted(of_all, key=len)),
            help="; ".join(f"{', '.join(who)}: {text}" for text, who in told.items()),
        )


def _kind(annotation: Any, si: SI | None) -> str:
    if si is not None:
        return " or ".join(_count(count, si.unit) for count in si.counts)
    if get_origin(annotation) is Literal:
        return " | ".join(get_args(annotation))
    if get_origin(annotation) is tuple:
        inner, of_items = unwrapped(get_args(annotation)[0])
        if of_items is not None:
            return f"list of {_kind(inner, of_items).replace('list of', 'lists of')}"
        return {Region: "list of regions", int: "list of whole numbers"}.get(inner, "list of texts")
    return {bool: "true or false", int: "whole number", Region: "region", Any: "as of KEY"}.get(
        annotation, "text"
    )


def _count(count: int, unit: str) -> str:
    what = DIMENSIONS[unit][0].split(" ", 1)[1] if unit != "1" else "number"
    text = what if count == 1 else f"{'list' if count == 0 else f'list of {count}'}: {what}"
    return text if unit == "1" else f"{text} [{unit}]"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    if field.default is None or field.default == "":
        return ""
    if isinstance(field.default, bool):
        return str(field.default).lower()
    return str(list(field.default)) if isinstance(field.default, tuple) else str(field.default)


# --- The JSON schema of a study file, for editors: made by pydantic from the tables that validate it ---


class _OfFile(GenerateJsonSchema):
    """A file has no null and no titles, and a sweep may give what a table lacks."""

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        table = schema["cls"]
        if issubclass(table, OneOf) and table not in table.kinds.values():
            return self._by_kind(table)
        found = super().model_schema(schema)
        found.pop("title", None)
        if table not in (Study, StudyInfo):
            found.pop("required", None)
        if table in (Range, Known):  # or tables around entries
            found.pop("additionalProperties")
        if table in _ENTRIES:
            inside = _ENTRIES[table][0]
            inside.model_rebuild()
            kinds = [self.generate_inner(inside.__pydantic_core_schema__)]
            kinds += [{"type": "array", "items": {"type": ["number", "string"]}}] * (table is Sweep)
            found["additionalProperties"] = {"description": _ENTRIES[table][2], "anyOf": kinds}
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
