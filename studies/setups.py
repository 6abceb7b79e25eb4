"""Set-ups that several solves share: kept for a while by the content of what they were made from.

A model asks for its operators and factors by `shared(make, ...)`. Inside `sharing()` the same question gets the
same object; outside everything is made anew. Nothing else of a model's path differs.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

T = TypeVar("T")
MOST_WAITING = 8  # set-ups of one model that are kept for their next use


@dataclass
class Setup:
    """One thing that was made, the turn up to which it is needed, how often it was asked for, and what memory a
    solve took."""

    value: Any
    turn: int
    uses: int = 0
    peak_bytes: int = 0


_kept: dict[str, Setup] | None = None
_turn = 0
_watched: list[list[Setup]] = []


@contextmanager
def sharing() -> Iterator[None]:
    """Keep every set-up made inside until the outermost such block is left."""
    global _kept
    outermost = _kept is None
    if outermost:
        _kept = {}
    try:
        yield
    finally:
        if outermost:
            _kept = None


def next_turn() -> None:
    """Begin the next piece of work: what neither it nor the one before it asks for is let go of, unless needed."""
    global _turn
    _turn += 1
    _keep_from(_turn - 1)


def let_go() -> None:
    """Let go now of everything that is not needed in a turn to come."""
    _keep_from(_turn + 1)


def _keep_from(turn: int) -> None:
    """Let go of what was asked for, or is needed, before a turn only."""
    for key in [key for key, setup in (_kept or {}).items() if setup.turn < turn]:
        del (_kept or {})[key]


@contextmanager
def needed_again(turns: int) -> Iterator[None]:
    """The set-ups that are asked for inside are kept for so many turns more."""
    with watched() as used:
        yield
    for setup in used:
        setup.turn = max(setup.turn, _turn + turns)


def next_uses(keys: Sequence[str]) -> list[int | None]:
    """Of uses one after the other, by the set-up of each: the place of its next use, None where it is not kept.

    Of set-ups that are used again those are kept that were used last, `MOST_WAITING` of them. So as many uses need
    a new set-up as are nobody's next.
    """
    found: list[int | None] = [None] * len(keys)
    waiting: dict[str, int] = {}  # set-up -> its last use, the latest at the end
    for place, key in enumerate(keys):
        if key in waiting:
            found[waiting.pop(key)] = place
        waiting[key] = place
        if len(waiting) > MOST_WAITING:
            del waiting[next(iter(waiting))]
    return found


def most_at_once(uses: Sequence[int | None]) -> int:
    """How many set-ups are there at the same time, at most, where `next_uses` says which are kept."""
    found = set(uses)
    there = most = 0
    for place, following in enumerate(uses):
        there += place not in found
        most = max(most, there)
        there -= following is None
    return most


@contextmanager
def watched() -> Iterator[list[Setup]]:
    """The set-ups that are asked for inside."""
    used: list[Setup] = []
    _watched.append(used)
    try:
        yield used
    finally:
        _watched.pop()


def shared(make: Callable[..., T], **inputs: Any) -> T:
    """make(**inputs), or what it made before of the same inputs. What it makes must not change when it is used,
    but for what it remembers of its last use.

    Inputs are arrays, plain values, meshes, tables of a study, dataclasses and containers of them.
    """
    key = _key(make, inputs)
    setup = _used(key)
    if setup is None:
        setup = Setup(make(**inputs), _turn)
        if _kept is not None:
            _kept[key] = setup
        _watch(setup)
    value: T = setup.value
    return value


def kept(make: Callable[..., T], **inputs: Any) -> Setup | None:
    """What `shared` made of the same inputs, as one more use of it; None where it would have to be made."""
    return _used(_key(make, inputs))


def _key(make: Callable[..., T], inputs: Mapping[str, Any]) -> str:
    return "" if _kept is None else f"{make.__module__}.{make.__qualname__} {content_key(inputs)}"


def _used(key: str) -> Setup | None:
    setup = (_kept or {}).get(key)
    if setup is not None:
        _watch(setup)
    return setup


def _watch(setup: Setup) -> None:
    setup.uses += 1
    setup.turn = max(setup.turn, _turn)
    for used in _watched:
        used.append(setup)


def content_key(value: Any) -> str:
    """SHA-256 (hex) of arrays, plain values, meshes, tables of a study, dataclasses and containers of them."""
    digest = hashlib.sha256()
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype.str} {value.shape} ".encode())
        digest.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        digest.update(f"mapping {len(value)} ".encode())
        for key in sorted(value):
            _feed(digest, key)
            _feed(digest, value[key])
    elif isinstance(value, list | tuple):
        digest.update(f"sequence {len(value)} ".encode())
        for item in value:
            _feed(digest, item)
    elif isinstance(getattr(value, "content_hash", None), str):  # which knows its own
        _feed(digest, (type(value).__qualname__, value.content_hash))
    elif isinstance(value, BaseModel):
        _feed(digest, (type(value).__qualname__, value.model_dump()))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        _feed(
            digest,
            (type(value).__qualname__, {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}),
        )
    elif value is None or isinstance(value, str | bytes | bool | int | float):
        digest.update(f"{type(value).__name__} {value!r} ".encode())
    else:
        raise TypeError(f"{type(value).__name__} has no content key")
