"""Words that several checks of a study share."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from typing import Any

from .problems import Finding
from .table import Table
from .units import shown


def unknown(value: str, known: Sequence[str], what: str, *, list_all: bool = True) -> str:
    """A sentence that says that a name is unknown, with the closest known one, or all where none is close."""
    known = [name for name in known if name.isprintable()]
    close = difflib.get_close_matches(value[:80], known, n=1)
    if close:
        return f'unknown {what} {shown(value)}; did you mean "{close[0]}"?'
    return f"unknown {what} {shown(value)}" + (f"; known: {', '.join(known) or 'none'}" if list_all else "")


def given(table: Table) -> set[str]:
    """The keys that the file has, or that follow from others, as written there."""
    return {type(table).model_fields[name].alias or name for name in table.model_fields_set if name[0] != "_"}


def listed(keys: set[str]) -> str:
    """Keys in a sentence, sorted."""
    return " and ".join(sorted(keys)) if len(keys) < 3 else ", ".join(sorted(keys))


def named_twice(table: str, entries: Sequence[Any], what: str) -> Iterator[Finding]:
    """Entries of an array of tables that have the name of an earlier one."""
    names = [entry.name for entry in entries]
    for place, name in enumerate(names):
        if name and name in names[:place]:
            text = f"{shown(name)} is the name of another {what}; give each its own name"
            yield (table, place, "name"), text
