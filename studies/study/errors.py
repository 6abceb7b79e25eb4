"""Errors that a user can correct: one sentence each."""

from __future__ import annotations

import difflib
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from .units import shown


class InputError(ValueError):
    """Unusable input; the message says what is wrong and what to do.

    `place` is its path in a study, or in the part of it that was read; () if unknown.
    """

    def __init__(self, text: str, *place: str | int) -> None:
        super().__init__(text)
        self.place: Loc = place


class MeshError(InputError):
    """An unusable geometry; its place is the key of [geometry] that has to change."""


# --- missing packages and libraries ---


# Debian's packages of the shared libraries that the gmsh and VTK wheels load from the system
LIBRARIES = ("libgomp1", "libglu1-mesa", "libxft2", "libxcursor1", "libxinerama1", "libgl1")
_DISTRIBUTIONS = {"skfem": "scikit-fem", "vtkmodules": "vtk", "tomli_w": "tomli-w"}
_NO_LIBRARY = re.compile(r"lib\S+\.so\S*: cannot open shared object file")


def install_line(error: BaseException) -> str:
    """The command that installs the package or library that an import lacks; "" for any other error."""
    if isinstance(error, ModuleNotFoundError) and error.name:
        name = error.name.partition(".")[0]
        return f"pip install --constraint constraints.txt {_DISTRIBUTIONS.get(name, name)}"
    if isinstance(error, ImportError | OSError) and _NO_LIBRARY.search(str(error)):
        return f"apt-get install {' '.join(LIBRARIES)}"
    return ""


# --- mistakes in a study file and their places: the error with every problem, and the file ---


Loc = tuple[str | int, ...]  # indices that lead to a value of the parsed file
Finding = tuple[Loc, str]

MOST_TOLD = 20  # problems reported for a file; checks stop after that

_LONGEST_KEY = 200  # characters shown
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class Problem(NamedTuple):
    """One mistake: file, 1-based line, key as written in the file (empty for the file itself), sentence."""

    path: str
    line: int
    key: str
    message: str

    def __str__(self) -> str:
        key = f"{self.key}: " if self.key else ""
        return f"{self.path}:{self.line}: {key}{self.message}"


class StudyError(ValueError):
    """An unusable study file; `problems` holds every mistake found."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = list(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))


@dataclass(frozen=True)
class Source:
    """The file of a study. Two studies with equal content are equal, whatever their source."""

    path: str = field(default="study", compare=False)
    lines: Mapping[Loc, int] = field(default_factory=dict, compare=False)
    text: str = field(default="", compare=False)  # of the file, changes made
    directory: Path | None = field(default=None, compare=False)

    def line(self, loc: Loc) -> int:
        """The line of a key, or of the innermost table around it that is in the file."""
        for end in range(len(loc), 0, -1):
            if loc[:end] in self.lines:
                return self.lines[loc[:end]]
        return 1

    def locate(self, path: str | Path) -> Path:
        """The absolute path of a file that the study names. Raises ValueError with a sentence."""
        if self.directory is None:
            return Path(path)
        if fault := file_fault(self.directory / path):
            raise ValueError(f"{shown(str(path), 200)} {fault}")
        return (self.directory / path).resolve()

    def error(self, findings: Sequence[Finding], data: Mapping[str, Any]) -> StudyError:
        """The error for these findings about `data`, without repeats, in the file's order; at most `MOST_TOLD`."""
        unique = sorted(dict.fromkeys(findings), key=lambda finding: self.line(finding[0]))
        told, more = unique[:MOST_TOLD], unique[MOST_TOLD:]
        problems = [Problem(self.path, self.line(loc), key_text(loc, data), text) for loc, text in told]
        if more:
            rest = f"there are more problems from here on; mend the first {MOST_TOLD} and check again"
            problems.append(Problem(self.path, self.line(more[0][0]), "", rest))
        return StudyError(problems)


def file_fault(path: Path) -> str | None:
    """Why a path is no readable file; None if it is."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return "does not exist"
    except OSError as error:  # too long a name, no permission, a loop of links
        return f"cannot be read: {error.strerror}"
    except ValueError:  # a NUL
        return "is not a usable path"
    return None if stat.S_ISREG(mode) else "is not a file"


def key_text(loc: Loc, data: Mapping[str, Any]) -> str:
    """A key as in a file: constraints by their name, other items of lists by their index."""
    text = ""
    value: Any = data
    for part in loc:
        value = value_at(value, (part,))
        if isinstance(part, int):
            name = entry_name(value) or ""
            named = text == "constraints" and _BARE_KEY.fullmatch(name)
            text += f".{name}" if named else f"[{part}]"
        else:
            text += ("." if text else "") + (part if _BARE_KEY.fullmatch(part) else shown(part))
    return text if len(text) <= _LONGEST_KEY else f"{text[: _LONGEST_KEY - 3]}..."


def entry_name(entry: Any) -> str | None:
    """The name of an entry of an array of tables, or of its region; None if it has none."""
    name = entry.get("name", entry.get("region")) if isinstance(entry, dict) else None
    return name if isinstance(name, str) else None


def value_at(data: Any, loc: Loc) -> Any:
    """The value at a place in the data of a study, None where there is none."""
    for part in loc:
        try:
            data = data[part]
        except (LookupError, TypeError):
            return None
    return data


# --- sentences that several checks share ---


def unknown(value: str, known: Sequence[str], what: str, *, list_all: bool = True) -> str:
    """A sentence that says that a name is unknown, with the closest known one, or all where none is close."""
    known = [name for name in known if name.isprintable() and len(name) <= _LONGEST_KEY]
    small = {name.lower(): name for name in known}
    close = difflib.get_close_matches(value[:80].lower(), small, n=1)
    if close:
        return f'unknown {what} {shown(value)}; did you mean "{small[close[0]]}"?'
    return f"unknown {what} {shown(value)}" + (f"; known: {', '.join(known) or 'none'}" if list_all else "")


def plural(count: int, noun: str, several: str = "") -> str:
    """`3 cases`, `1 case`."""
    return f"{count} {noun if count == 1 else several or noun + 's'}"


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
