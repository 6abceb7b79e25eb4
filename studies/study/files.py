"""The studies that come with the package, and the file of a study by its name."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from .errors import InputError, Loc, entry_name, unknown, value_at
from .units import shown, type_name

SHIPPED = Path(__file__).parents[1] / "cases"


def shipped_studies() -> dict[str, Path]:
    """Name -> file, sorted."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def study_path(study: str | Path) -> Path:
    """The file of a study: a path, or a shipped one by its name.

    Raises
    ------
    InputError
        neither of them; the message has similar names.
    """
    path, known = Path(study), shipped_studies()
    if path.exists():
        return path
    if str(study) in known:
        return known[str(study)]
    names = [*sorted(map(str, path.parent.glob("*.toml"))), *known]
    if len(path.parts) == 1:
        raise InputError(unknown(str(study), names, "study"))
    close = unknown(str(study), names, "study", list_all=False).partition("; ")[1:]
    raise InputError(f"{shown(str(study), 200)}: there is no such file or directory{''.join(close)}")


# --- A study with some of its values replaced ---


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
    if ":" in key and '"' not in key:
        quoted = re.sub(r"[^.\s]*:[^.\s]*", r'"\g<0>"', key)
        raise InputError(f"{key}: a name with a colon needs quotes: {shlex.quote(quoted + equals + value)}")
    raise InputError(f"write KEY=VALUE, such as tissue.youngs_modulus='3 kPa', not {text!r}")


def changed(changes: Mapping[str, Any], *before: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Paths and values of the keys that nested tables of changes set; empty tables count as values.

    Raises
    ------
    InputError
        a key that is not text.
    """
    for key, value in changes.items():
        if not isinstance(key, str):
            raise InputError(f"a change names its key by a text, not by {type_name(key)}")
        if isinstance(value, Mapping) and value:
            yield from changed(value, *before, key)
        else:
            yield (*before, key), value


def located(data: Any, path: Sequence[str], of_value: Collection[str] = ()) -> Loc:
    """The place of a path of keys in the data of a study; missing keys keep the path's own names.

    An entry of an array of tables goes by its name or its region, a component of a vector by its index. Existing
    names may contain dots; the path may be split at each.

    Parameters
    ----------
    of_value : keys to suggest in the error for a key inside a single value

    Raises
    ------
    InputError
        a missing entry; a key inside a value that is no table.
    """
    loc: Loc = ()
    while path:
        if isinstance(data, list | tuple):
            known = {entry_name(item) or str(place): place for place, item in enumerate(data)}
        elif data is None or isinstance(data, Mapping):
            known = {key: key for key in data or ()}
        else:
            told = f"{'.'.join(map(str, loc))} is a value and has no key {shown(path[0])}"
            raise InputError(unknown(path[0], list(of_value), "key") if of_value else told)
        ends = (end for end in range(len(path), 0, -1) if ".".join(path[:end]) in known)
        end = next(ends, 1)
        word = ".".join(path[:end])
        if isinstance(data, list | tuple) and word not in known:
            raise InputError(unknown(word, list(known), f"entry of {'.'.join(map(str, loc))}"))
        loc, path = (*loc, known.get(word, word)), path[end:]
        data = value_at(data, loc[-1:])
    return loc


def substituted(data: Any, loc: Loc, value: Any) -> Any:
    """A copy of `data` with `value` at a place; missing tables on the way are made. None drops a key."""
    if not loc:
        return value
    first, rest = loc[0], loc[1:]
    if isinstance(data, list | tuple):
        return [substituted(item, rest, value) if k == first else item for k, item in enumerate(data)]
    new = {**(data or {}), first: substituted((data or {}).get(first), rest, value)}
    return {key: inner for key, inner in new.items() if key != first or inner is not None}


def merged(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The data of a study with nested tables of changes, key by key (`located`). Raises InputError.

    An empty table creates a missing one.
    """
    new = dict(data)
    for path, value in changed(changes):
        loc = located(new, path)
        if value is None and isinstance(loc[-1], int):
            raise InputError(f"{'.'.join(path)} is one of a list, which is written anew to leave it out")
        if not (isinstance(value, Mapping) and isinstance(value_at(new, loc), Mapping | list | tuple)):
            new = substituted(new, loc, value)
    return new


# --- studies as results store them: files by name only, because folders may name a patient ---


# a quoted absolute path to a mesh, on any system
_ABSOLUTE = re.compile(
    r"""(["'])(?:/|~|[A-Za-z]:[\\/])[^"'\n]*[\\/]([^"'\\/\n]+\.(?:stl|obj|ply|vtp|vtk|vtu|msh))\1""",
    re.IGNORECASE,
)


def without_folders(value: Any) -> Any:
    """Plain data in which files with an absolute path keep only their name."""
    if isinstance(value, Mapping):
        return {key: without_folders(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [without_folders(item) for item in value]
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def text_without_folders(text: str) -> str:
    """The text of a study file in which mesh files with an absolute path keep only their name."""
    return _ABSOLUTE.sub(r"\1\2\1", text)
