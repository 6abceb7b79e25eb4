"""The line of every key of a TOML text, which `tomllib` does not tell.

The scanner never converts a value, it only finds where each one is. It reads a text before `tomllib` does and
refuses what `tomllib` has no bound for: a dotted key of 40 kB takes 1.6 GB there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

Path = tuple[str | int, ...]

# tables and lists inside each other, and parts of a dotted key; also keeps recursion here and in the models shallow
MAX_DEPTH = 64
MAX_ITEMS = 100_000  # of a list

_SPACE = re.compile(r"(?:[ \t\n\r]|#[^\n]*)*")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_STRING = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}(?!")|\'\'\'.*?\'{3,5}(?!\')|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'', re.DOTALL
)
_SCALAR = re.compile(r"[^,\]}#\n]*")
_ESCAPE = re.compile(r'\\(?:u([0-9A-Fa-f]{4})|U([0-9A-Fa-f]{8})|([btnfr"\\]))')
_ESCAPED = {"b": "\b", "t": "\t", "n": "\n", "f": "\f", "r": "\r", '"': '"', "\\": "\\"}


class TooLarge(ValueError):
    """A text that is nested deeper than `MAX_DEPTH`, or has a list of more than `MAX_ITEMS`; and the line of it."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.line = line


class NotToml(ValueError):
    """The text is not what `tomllib` would have accepted."""


def key_lines(text: str) -> dict[Path, int]:
    """Map the path of every key, list item and table to the 1-based line where it is (first) written.

    A path is what one would index the parsed document with: `("constraints", 0, "region")`.
    Raises TooLarge, and NotToml on a text that is not TOML (not every fault is found: that is tomllib's task).
    """
    return _Scanner(text).scan()


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text.replace("\r\n", "\n")
        self.at = 0
        self.lines: dict[Path, int] = {}
        self.lengths: dict[Path, int] = {}  # items so far of each array of tables
        self._counted = (0, 1)  # a position and its line: counting goes on from there

    def scan(self) -> dict[Path, int]:
        table: Path = ()
        self._skip_space()
        while self.at < len(self.text):
            if self._take("[["):
                table = self._array_item(tuple(self._key()))
                self._expect("]]")
            elif self._take("["):
                table = self._resolve(tuple(self._key()))
                self._note(table)
                self._expect("]")
            else:
                self._key_value(table)
            self._skip_space()
        return self.lines

    def _array_item(self, key: Path) -> Path:
        """Start the next item of the array of tables `key`."""
        parent = self._resolve(key[:-1])
        array = (*parent, key[-1])
        self._note(array)
        index = self.lengths.get(array, 0)
        self.lengths[array] = index + 1
        self._note((*array, index))
        return (*array, index)

    def _resolve(self, key: Path) -> Path:
        """The path of a header: an array of tables on the way stands for its latest item."""
        path: Path = ()
        for part in key:
            path = (*path, part)
            self._note(path)
            if path in self.lengths:
                path = (*path, self.lengths[path] - 1)
        return path

    def _key_value(self, table: Path) -> None:
        path = table
        for part in self._key():
            path = (*path, part)
            self._note(path)
        self._expect("=")
        self._skip_blanks()
        self._value(path)

    def _value(self, path: Path) -> None:
        if self._take("["):
            for index in self._items("]"):
                self._note((*path, index))
                self._value((*path, index))
        elif self._take("{"):
            for _ in self._items("}"):
                self._key_value(path)
        elif self.text.startswith(('"', "'"), self.at):
            self._string()
        elif not self._match(_SCALAR).strip():
            raise NotToml(f"a value is missing on line {self._line()}")

    def _items(self, end: str) -> Iterator[int]:
        """Step through the items of a list or inline table up to its end; the caller reads each item."""
        index = 0
        self._skip_space()
        while not self._take(end):
            if index == MAX_ITEMS:
                raise TooLarge(f"a list has more than {MAX_ITEMS:,} items; no study needs that", self._line())
            yield index
            index += 1
            self._skip_space()
            if not self._take(","):
                self._expect(end)
                return
            self._skip_space()

    def _key(self) -> Iterator[str]:
        """The parts of a dotted key."""
        while True:
            self._skip_blanks()
            if self.text.startswith(('"', "'"), self.at):
                yield _unquoted(self._string())
            else:
                yield self._match(_BARE_KEY)
            self._skip_blanks()
            if not self._take("."):
                return

    def _string(self) -> str:
        return self._match(_STRING)

    def _match(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        if match is None:
            raise NotToml(f"cannot read line {self._line()}")
        self.at = match.end()
        return match.group()

    def _take(self, token: str) -> bool:
        if not self.text.startswith(token, self.at):
            return False
        self.at += len(token)
        return True

    def _expect(self, token: str) -> None:
        self._skip_blanks()
        if not self._take(token):
            raise NotToml(f"{token} is missing on line {self._line()}")

    def _skip_blanks(self) -> None:
        while self.at < len(self.text) and self.text[self.at] in " \t":
            self.at += 1

    def _skip_space(self) -> None:
        self._match(_SPACE)

    def _line(self) -> int:
        position, line = self._counted
        line += self.text.count("\n", position, self.at)
        self._counted = (self.at, line)
        return line

    def _note(self, path: Path) -> None:
        if len(path) > MAX_DEPTH:
            raise TooLarge(f"nested more than {MAX_DEPTH} levels deep; no study needs that", self._line())
        self.lines.setdefault(path, self._line())


def _unquoted(quoted: str) -> str:
    """The text of a one-line basic or literal string."""
    if quoted.startswith("'"):
        return quoted[1:-1]

    def plain(match: re.Match[str]) -> str:
        short, long, letter = match.groups()
        return _ESCAPED[letter] if letter else chr(int(short or long, 16))

    return _ESCAPE.sub(plain, quoted[1:-1])
