"""Line numbers of all keys of a TOML text, which `tomllib` does not give.

A text is split into statements, and `tomllib` reads each. Its keys are on the statement's line, items of a list
on their own. Nesting is checked before `tomllib` sees the text: there a dotted key of 40 kB takes 1.6 GB.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

Path = tuple[str | int, ...]

# depth of nested tables and lists, and parts of a dotted key; limits recursion here and in the models too
MAX_DEPTH = 64

_STRING = "|".join(
    (
        r'"""(?:[^\\]|\\.)*?"{3,5}(?!")',
        r"'''.*?'{3,5}(?!')",
        r'"(?!"")(?:[^"\\\n]|\\.)*"',
        r"'(?!'')[^'\n]*'",
        r"[\"'].*",  # unterminated: the rest of an invalid text
    )
)
_TOKEN = re.compile(rf"#[^\n]*|{_STRING}|[^\"'#\n\[\]{{}}.,=]+|.", re.DOTALL)


class TooLarge(ValueError):
    """A text that is nested deeper than `MAX_DEPTH`, with the line."""

    def __init__(self, line: int) -> None:
        super().__init__(f"nested more than {MAX_DEPTH} levels deep; no study needs that")
        self.line = line


class Statement(NamedTuple):
    """A header, or a key with its value: its 1-based line, its text, and for a list the line of each item."""

    line: int
    text: str
    items: Sequence[int]


def statements(text: str) -> Iterator[Statement]:
    """The statements of a TOML text, comments and empty lines among them. Raises TooLarge."""
    text = f"{text}\n".replace("\r\n", "\n")
    start = line = 1
    begin = depth = dots = 0
    items: list[int] = []
    in_value = in_list = awaits_item = False
    for match in _TOKEN.finditer(text):
        token = match.group()
        if awaits_item and token.strip() and token[0] not in "#]":
            items.append(line)
            awaits_item = False
        if token in ("[", "{"):
            in_list = in_list or (token == "[" and in_value and depth == 0)
            awaits_item = awaits_item or (in_list and depth == 0)
            depth += 1
        elif token in ("]", "}"):
            depth = max(depth - 1, 0)
        elif token == ",":
            awaits_item = in_list and depth == 1
        in_value = in_value or token == "="
        dots = dots + 1 if token == "." else 0 if token in ("=", ",", "[", "{", "\n") else dots
        if max(depth, dots) >= MAX_DEPTH:
            raise TooLarge(line)
        line += token.count("\n")
        if token == "\n" and depth == 0:
            yield Statement(start, text[begin : match.start()], items)
            start, begin, items = line, match.end(), []
            in_value = in_list = awaits_item = False


def key_lines(found: Sequence[Statement]) -> dict[Path, int]:
    """The path of every key, list item and table of a valid text -> the 1-based line where it first appears.

    A path indexes the parsed document: `("constraints", 0, "region")`.
    """
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}  # entries of each array of tables so far
    table: Path = ()
    for one in found:
        read: Any = tomllib.loads(one.text)
        if not one.text.lstrip().startswith("["):
            for key, value in read.items():
                _note(lines, (*table, key), value, one.line, one.items)
            continue
        table = ()
        while read:
            ((key, read),) = read.items()
            table = (*table, key)
            lines.setdefault(table, one.line)
            if isinstance(read, list):
                counts[table] = counts.get(table, 0) + 1
                read = read[0]
            if table in counts:  # its latest entry
                table = (*table, counts[table] - 1)
                lines.setdefault(table, one.line)
    return lines


def _note(lines: dict[Path, int], path: Path, value: Any, line: int, items: Sequence[int]) -> None:
    """Note the line of a value and its parts; `items` are the lines of the outermost list, if the value is one."""
    lines.setdefault(path, line)
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _note(lines, (*path, key), inner, line, items)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            _note(lines, (*path, place), inner, items[place] if items else line, ())
