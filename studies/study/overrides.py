"""A study's text with some of its values replaced."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

import tomli_w


class OverrideError(ValueError):
    """A change that a study cannot take; the message says which."""


def overridden(text: str, changes: Mapping[str, Any]) -> str:
    """The TOML of a study in which tables are changed key by key; of a value that is no table all is replaced.

    An entry of an array of tables, such as a constraint, goes by its name or its region. None drops a key.

    Raises
    ------
    OverrideError
        an entry that is not there, or a text that is no TOML.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise OverrideError(f"TOML syntax: {error}") from None
    return tomli_w.dumps(_merged(data, changes, ""))


def _merged(table: Mapping[str, Any], changes: Mapping[str, Any], place: str) -> dict[str, Any]:
    new = dict(table)
    for key, value in changes.items():
        where, old = f"{place}.{key}" if place else key, table.get(key)
        if value is None:
            new.pop(key, None)
        elif isinstance(value, Mapping) and isinstance(old, list):
            new[key] = _entries(old, value, where)
        elif isinstance(value, Mapping):
            new[key] = _merged(old if isinstance(old, Mapping) else {}, value, where)
        else:
            new[key] = value
    return new


def _entries(entries: list[Any], changes: Mapping[str, Any], place: str) -> list[Any]:
    names = [entry.get("name", entry.get("region")) if isinstance(entry, dict) else None for entry in entries]
    if wrong := sorted(set(changes) - set(names)):
        known = ", ".join(str(name) for name in names if name)
        raise OverrideError(f"{place} has no entry {wrong[0]!r}; it has: {known or 'none'}")
    return [
        _merged(entry, changes[str(name)], f"{place}.{name}") if name in changes else entry
        for name, entry in zip(names, entries, strict=True)
    ]
