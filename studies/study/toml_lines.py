"""The line of every key of a TOML text, which `tomllib` does not tell.

A text is cut into its statements, and `tomllib` reads each: what it finds is on the statement's line, an item of a
list on its own. Nesting is counted before `tomllib` sees the text: a dotted key of 40 kB takes 1.6 GB there.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

Path = tuple[str | int, ...]

# tables and lists inside each other, and parts of a dotted key; also keeps recursion here and in the models shallow
MAX_DEPTH = 64

_STRING = "|".join(
    (
        r'"""(?:[^\\]|\\.)*?"{3,5}(?!")',
        r"'''.*?'{3,5}(?!')",
        r'"(?!"")(?:[^"\\\n]|\\.)*"',
        r"'(?!'')[^'\n]*'",
        r"[\"'].*",  # without an end: all of the rest, of a text that is no TOML
    )
)
_TOKEN = re.compile(rf"#[^\n]*|{_STRING}|[^\"'#\n\[\]{{}}.,=]+|.", re.DOTALL)


class TooLarge(ValueError):
    """A text that is nested deeper than `MAX_DEPTH`; and the line of it."""

    def __init__(self, line: int) -> None:
        super().__init__(f"nested more than {MAX_DEPTH} levels deep; no study needs that")
        self.line = line


class Statement(NamedTuple):
    """A header, or a key with its value: its 1-based line, its text, and of a list the line of each item."""

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
    """Map the path of every key, list item and table of a sound text to the 1-based line where it is first written.

    A path is what one would index the parsed document with: `("constraints", 0, "region")`.
    """
    lines: dict[Path, int] = {}
    counts: dict[Path, int] = {}  # entries so far of each array of tables
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
    """Note a value and what is in it; `items` are the lines of the outermost list, where that is all of a value."""
    lines.setdefault(path, line)
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _note(lines, (*path, key), inner, line, items)
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            _note(lines, (*path, place), inner, items[place] if items else line, ())
