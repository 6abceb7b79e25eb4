"""A cursor over the numbers of a mesh file, as text or binary, that never reads past the end."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..study.errors import MeshError

_TRUNCATED = "is truncated or damaged: it announces more numbers than it holds"


class Numbers:
    """The numbers in a piece of a file, taken one after the other.

    `binary` numbers have the byte order `order` ("<" little, ">" big endian) and the type asked for; text
    holds them in words. Raises MeshError for words that are no numbers.
    """

    def __init__(self, data: bytes, *, binary: bool, order: str = "<") -> None:
        self._data = data
        self._order = order
        self._binary = binary
        self._at = 0
        if not binary:
            try:
                self._values = np.array(data.split(), dtype=np.float64)
            except ValueError as error:
                raise MeshError("is damaged: it holds words where numbers belong") from error

    @property
    def left(self) -> int:
        """How many numbers of a text, or bytes of a binary piece, are left."""
        return len(self._data if self._binary else self._values) - self._at

    @property
    def position(self) -> int:
        """Where the cursor is, for `rewind`."""
        return self._at

    def rewind(self, position: int) -> None:
        """Go back to a `position` taken before."""
        self._at = position

    def integers(self, kind: str, count: int) -> NDArray[np.int64]:
        """The next `count` integers, stored as the numpy type `kind` (such as "i4") where binary.

        Raises MeshError where there are fewer, and where one is not an integer below 2^53.
        """
        numbers = self._take(kind, count)
        if numbers.size and not (np.abs(numbers.astype(np.float64)) < 2.0**53).all():
            raise MeshError("is damaged: a number that must be a small integer is not")
        whole = numbers.astype(np.int64)
        if not np.array_equal(whole, numbers):
            raise MeshError("is damaged: a number that must be an integer is not")
        return whole

    def integer(self, kind: str) -> int:
        """The next integer."""
        return int(self.integers(kind, 1)[0])

    def reals(self, kind: str, count: int) -> NDArray[np.float64]:
        """The next `count` numbers, stored as the numpy type `kind` (such as "f8") where binary."""
        return self._take(kind, count).astype(np.float64)

    def records(self, fields: list[tuple[str, str, int]], count: int) -> dict[str, NDArray[Any]]:
        """`count` rows of the fields (name, numpy type, how many numbers), as one (count, n) array for each."""
        if not self._binary:
            width = sum(n for _, _, n in fields)
            table = self._take("f8", count * width).reshape(count, width)
            ends = np.cumsum([n for _, _, n in fields])
            return {name: table[:, end - n : end] for (name, _, n), end in zip(fields, ends, strict=True)}
        row = np.dtype([(name, self._order + kind, (n,)) for name, kind, n in fields])
        raw = self._take("V", count * row.itemsize).tobytes()
        table = np.frombuffer(raw, dtype=row)
        return {name: table[name] for name, _, _ in fields}

    def _take(self, kind: str, count: int) -> NDArray[Any]:
        start = self._at
        if not self._binary:
            if not 0 <= count <= len(self._values) - start:
                raise MeshError(_TRUNCATED)
            self._at = start + count
            return self._values[start : self._at]
        dtype = np.dtype("u1" if kind == "V" else self._order + kind)
        if not 0 <= count <= (len(self._data) - start) // dtype.itemsize:
            raise MeshError(_TRUNCATED)
        self._at = start + count * dtype.itemsize
        return np.frombuffer(self._data, dtype=dtype, count=count, offset=start)
