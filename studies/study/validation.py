"""One pass over the data of a study: a Study, or every problem that it has, in plain words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import islice
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from .checks import check
from .fields import field_at, keys_of, table_at
from .problems import MOST_TOLD, Finding, Loc, Source
from .schema import Study
from .table import Context
from .units import type_name
from .wording import unknown

_WANTED = {  # kind of pydantic error -> what the value must be
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_type": "a text",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "int_from_float": "a whole number",
}


def validate(data: Mapping[str, Any], source: Source) -> tuple[Study | None, list[Finding]]:
    """The study in `data`, as parsed from TOML, or None and what is wrong with it.

    Where keys are faulty, the checks between keys run on what is left. Of either kind of problem one more than
    can be told is enough: some take a search for the name that was meant.
    """
    findings: list[Finding] = []
    faulty: set[Loc] = set()
    try:
        study = Study.model_validate(data, context=Context(source))
    except ValidationError as error:
        faults = sorted(error.errors(include_url=False), key=lambda details: source.line(_place(details)))
        findings += map(_finding, faults[: MOST_TOLD + 1])
        faulty = set(map(_place, faults))
        study = Study.model_validate(data, context=Context(source, lenient=True))
    findings += islice(
        (finding for finding in check(study) if not _inside(finding[0], faulty)), MOST_TOLD + 1
    )
    return (None if findings else study), findings


def _inside(loc: Loc, faulty: set[Loc]) -> bool:
    """Whether the key itself, or a table around it, is known to be faulty."""
    return any(loc[:end] in faulty for end in range(len(loc) + 1))


def _place(details: ErrorDetails) -> Loc:
    return tuple(part for part in details["loc"] if part not in ("<name>", "<table>"))


def _finding(details: ErrorDetails) -> Finding:
    loc = _place(details)
    kind, value = details["type"], details.get("input")
    if kind == "value_error":
        return loc, str(details["ctx"]["error"])
    if kind == "missing":
        field = field_at(loc)
        return loc, f"is missing: {field.description}" if field else "is missing"
    if kind == "extra_forbidden":
        return loc, unknown(str(loc[-1]), list(keys_of(table_at(loc[:-1]))), "key")
    if kind == "literal_error":
        options = re.findall(r"'([^']*)'", details["ctx"]["expected"])
        if isinstance(value, str):
            return loc, unknown(value, options, "choice")
        return loc, f"must be one of {', '.join(options)}, not {type_name(value)}"
    if kind in _WANTED:
        return loc, f"must be {_WANTED[kind]}, not {type_name(value)}"
    return loc, re.sub(r"^(Input|String|Tuple|Dictionary|Value) should", "must", details["msg"])
