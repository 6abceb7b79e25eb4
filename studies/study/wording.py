"""Words that several checks of a study share."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

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
