"""The line of every key of a TOML text, which `tomllib` does not tell.

The scanner never converts a value, it only finds where each one is. It reads a text before `tomllib` does and
refuses what `tomllib` has no bound for: a dotted key of 40 kB takes 1.6 GB there.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator

Path = tuple[str | int, ...]

# tables and lists inside each other, and parts of a dotted key; also keeps recursion here and in the models shallow
MAX_DEPTH = 64
MAX_ITEMS = 100_000  # of a list

_SPACE = re.compile(r"(?:[ \t\n\r]|#[^\n]*)*")
_STRING = r'"""(?:[^\\]|\\.)*?"{3,5}(?!")|\'\'\'.*?\'{3,5}(?!\')|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\''
_KEY = re.compile(rf"{_STRING}|[A-Za-z0-9_-]+", re.DOTALL)
_VALUE = re.compile(rf"{_STRING}|[^,\]}}#\n]+", re.DOTALL)


class TooLarge(ValueError):
    """A text that is nested deeper than `MAX_DEPTH`, or has a list of more than `MAX_ITEMS`; and the line of it."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


def key_lines(text: str) -> dict[Path, int]:
    """Map the path of every key, list item and table to the 1-based line where it is (first) written.

    A path is what one would index the parsed document with: `("constraints", 0, "region")`.
    Raises TooLarge, and TOMLDecodeError of a text that is no TOML; not every fault is found: tomllib's task.
    """
    scanner = _Scanner(text)
    table: Path = ()
    while not scanner.at_end():
        table = scanner.statement(table)
    return scanner.lines


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text.replace("\r\n", "\n")
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.lengths: dict[Path, int] = {}  # items so far of each array of tables
        self._counted = (0, 1)  # a position and its line: counting goes on from there

    def at_end(self) -> bool:
        self._take("")
        return self.at == len(self.text)

    def statement(self, table: Path) -> Path:
        """Read a header or a key with its value; the table that the next statement is in."""
        if self._take("[["):
            *inside, last = self._key()
            array = (*self._resolved(inside), last)
            self._note(array)
            self.lengths[array] = self.lengths.get(array, 0) + 1
            table = (*array, self.lengths[array] - 1)
            self._note(table)
            self._need("]]")
        elif self._take("["):
            table = self._resolved(self._key())
            self._need("]")
        else:
            self._pair(table)
        return table

    def _resolved(self, key: list[str]) -> Path:
        """The path of a header: an array of tables on the way stands for its latest item."""
        path: Path = ()
        for part in key:
            path = (*path, part)
            self._note(path)
            if path in self.lengths:
                path = (*path, self.lengths[path] - 1)
        return path

    def _pair(self, path: Path) -> None:
        for part in self._key():
            path = (*path, part)
            self._note(path)
        self._need("=")
        self._value(path)

    def _value(self, path: Path) -> None:
        if self._take("["):
            for index in self._items("]"):
                self._note((*path, index))
                self._value((*path, index))
        elif self._take("{"):
            for _ in self._items("}"):
                self._pair(path)
        else:
            self._match(_VALUE)

    def _items(self, end: str) -> Iterator[int]:
        """Step through the items of a list or inline table up to its end; the caller reads each item."""
        for index in range(MAX_ITEMS + 1):
            if self._take(end):
                return
            if index == MAX_ITEMS:
                text = f"a list has more than {MAX_ITEMS:,} items; no study needs that"
                raise TooLarge(text, self._line())
            yield index
            if not self._take(","):
                self._need(end)
                return

    def _key(self) -> list[str]:
        """The parts of a dotted key."""
        parts = [_unquoted(self._match(_KEY))]
        while self._take("."):
            parts.append(_unquoted(self._match(_KEY)))
        return parts

    def _take(self, token: str) -> bool:
        """Whether a token comes next, after space and comments."""
        self.at = _SPACE.match(self.text, self.at).end()  # type: ignore[union-attr]  # it matches nothing too
        found = self.text.startswith(token, self.at)
        self.at += len(token) if found else 0
        return found

    def _need(self, token: str) -> None:
        if not self._take(token):
            raise tomllib.TOMLDecodeError(f"{token} is missing on line {self._line()}")

    def _match(self, pattern: re.Pattern[str]) -> str:
        self._take("")
        match = pattern.match(self.text, self.at)
        if match is None:
            raise tomllib.TOMLDecodeError(f"cannot read line {self._line()}")
        self.at = match.end()
        return match.group()

    def _line(self) -> int:
        position, line = self._counted
        self._counted = (self.at, line + self.text.count("\n", position, self.at))
        return self._counted[1]

    def _note(self, path: Path) -> None:
        if len(path) > MAX_DEPTH:
            raise TooLarge(f"nested more than {MAX_DEPTH} levels deep; no study needs that", self._line())
        self.lines.setdefault(path, self._line())


def _unquoted(key: str) -> str:
    """The text of a bare key, or of a one-line string."""
    return next(iter(tomllib.loads(f"{key} = 0"))) if key[0] in "\"'" else key
