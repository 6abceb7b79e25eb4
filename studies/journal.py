"""What became of the tasks of one group, a line of JSON each: written where they run, read where they were sent."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .safe_open import open_regular, read_regular


@dataclass
class Journal:
    """A file that grows by a record at a time: {"begun": id}, or the outcome of {"id": id, "code": ...}.

    The file outlives whoever writes it, so that another can go on where it ends.
    """

    path: Path
    read: int = 0  # bytes of it that `news` has given
    told: bytes = b""  # what `catch_up` was told that the file holds
    begun: Counter[str] = field(default_factory=Counter)  # task id -> how often it was begun, by the news
    finished: set[str] = field(default_factory=set)  # ids of tasks with an outcome, by the news

    def add(self, record: dict[str, Any]) -> None:
        """Append a record in one write, on a line of its own whatever a killed writer left before it.

        Raises OSError where the directory is gone.
        """
        line = b"\n" + json.dumps(record).encode() + b"\n"
        handle = open_regular(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        with os.fdopen(handle, "ab", buffering=0) as file:
            file.write(line)

    def catch_up(self, told: str) -> None:
        """Take another machine's word for what the file holds: a shared file system may show it late."""
        self.told = told.encode()

    def content(self) -> bytes:
        """The whole file; nothing where there is none yet."""
        try:
            return read_regular(self.path)
        except FileNotFoundError:
            return b""

    def news(self) -> Iterator[dict[str, Any]]:
        """The records that were not read before, outcomes of the same task once. A line half-written can wait."""
        fresh = max(self.content(), self.told, key=len)[self.read :]
        for line in fresh.splitlines(keepends=True):
            if not line.endswith(b"\n"):
                return
            self.read += len(line)
            record = _record(line)
            if "begun" in record:
                self.begun[record["begun"]] += 1
                yield record
            elif "id" in record and record["id"] not in self.finished:
                self.finished.add(record["id"])
                yield record


def _record(line: bytes) -> dict[str, Any]:
    """A line's record; nothing where the line is empty or its writer was killed in the middle of it."""
    try:
        record: dict[str, Any] = json.loads(line)
    except ValueError:
        return {}
    return record
