"""Errors that a user can mend: one sentence each."""

from __future__ import annotations


class InputError(ValueError):
    """What the user gave cannot be used; the message says what is wrong and what to do."""


class MeshError(InputError):
    """A geometry that cannot be used; `key` is what its [geometry] has to change, where that is known."""

    def __init__(self, text: str, key: str = "") -> None:
        super().__init__(text)
        self.key = key
