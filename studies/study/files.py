"""The studies that come with the package, and the file of a study by its name."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from .errors import InputError, entry_name, unknown

SHIPPED = Path(__file__).parents[1] / "cases"


def shipped_studies() -> dict[str, Path]:
    """Name -> file, sorted."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def study_path(study: str | Path) -> Path:
    """The file of a study: a path, or the name of a shipped one.

    Raises
    ------
    InputError
        neither of them; the message has the names that are near.
    """
    path, known = Path(study), shipped_studies()
    if path.exists():
        return path
    if str(study) in known:
        return known[str(study)]
    beside = sorted(map(str, path.parent.glob("*.toml")))
    raise InputError(unknown(str(study), [*beside, *known], "study"))


# --- A study's text with some of its values replaced ---


def changes_of(text: str) -> dict[str, Any]:
    """The change `tissue.youngs_modulus=3 kPa` as nested tables; a value that is no TOML is a text.

    Raises
    ------
    InputError
        no key, or no value.
    """
    key, equals, value = text.partition("=")
    if equals and value.strip():
        for line in (text, f"{key} = {json.dumps(value.strip())}"):
            try:
                return tomllib.loads(line)
            except tomllib.TOMLDecodeError:
                pass
    raise InputError(f"write KEY=VALUE, such as tissue.youngs_modulus='3 kPa', not {text!r}")


def changed_keys(changes: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """The dotted keys that changes give a value."""
    for key, value in changes.items():
        if isinstance(value, Mapping):
            yield from changed_keys(value, f"{before}{key}.")
        else:
            yield f"{before}{key}"


def merged(table: Mapping[str, Any], changes: Mapping[str, Any], place: str = "") -> dict[str, Any]:
    """Tables changed key by key; of a value that is no table all is replaced.

    An entry of an array of tables, such as a constraint, goes by its name or its region. None drops a key.

    Raises
    ------
    InputError
        an entry that is not there.
    """
    new = dict(table)
    for key, value in changes.items():
        where, old = f"{place}.{key}" if place else key, table.get(key)
        if value is None:
            new.pop(key, None)
        elif isinstance(value, Mapping) and isinstance(old, list):
            new[key] = _entries(old, value, where)
        elif isinstance(value, Mapping):
            new[key] = merged(old if isinstance(old, Mapping) else {}, value, where)
        else:
            new[key] = value
    return new


def _entries(entries: list[Any], changes: Mapping[str, Any], place: str) -> list[Any]:
    names = [entry_name(entry) for entry in entries]
    if wrong := sorted(set(changes) - set(names)):
        known = ", ".join(str(name) for name in names if name)
        raise InputError(f"{place} has no entry {wrong[0]!r}; it has: {known or 'none'}")
    return [
        merged(entry, changes[str(name)], f"{place}.{name}") if name in changes else entry
        for name, entry in zip(names, entries, strict=True)
    ]


# --- Studies as results keep them: files and directories by their names, for folders may name a patient ---


# a quoted absolute path to a mesh, on any system
_ABSOLUTE = re.compile(
    r"""(["'])(?:/|~|[A-Za-z]:[\\/])[^"'\n]*[\\/]([^"'\\/\n]+\.(?:stl|obj|ply|vtp|vtk|vtu|msh))\1""",
    re.IGNORECASE,
)


def without_folders(value: Any) -> Any:
    """Plain data with the name alone of each file that has an absolute path."""
    if isinstance(value, Mapping):
        return {key: without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_folders(item) for item in value]
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def text_without_folders(text: str) -> str:
    """The text of a study file with the name alone of each mesh file that has an absolute path."""
    return _ABSOLUTE.sub(r"\1\2\1", text)
