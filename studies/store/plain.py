"""Reads plain JSON data back into typed values: the inverse of `vdmbench.machine.plain`."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import BaseModel

from ..study.schema import Study

T = TypeVar("T")
Place = tuple[str | int, ...]  # path of a value, outermost key first
Reader = Callable[[Any, Place], Any]


class StoreError(ValueError):
    """A stored result is damaged or of another schema; the message names the file and the remedy."""


class OlderSchemaError(StoreError):
    """A stored result of an older version of the program, sound for that one."""


def typed(kind: type[T], value: Any, **given: Any) -> T:
    """A value of a dataclass, or of any type of its fields; null reads as NaN in numbers.

    Parameters
    ----------
    given : fields of the dataclass that are known already

    Raises
    ------
    ValueError
        wrong shape or type; one line names the place.
    """
    if dataclasses.is_dataclass(kind):
        return cast(T, _fields(kind, value, (), given))
    return cast(T, _reader(cast(Any, kind))(value, ()))


def _fields(kind: type, value: Any, place: Place, given: dict[str, Any]) -> Any:
    _as(isinstance(value, dict), "a table", place)
    for name, read, needed in _parts(kind):
        if name in given:
            continue
        if name in value:
            given[name] = read(value[name], (*place, name))
        else:
            _as(not needed, "there", (*place, name))
    return kind(**given)


@cache
def _parts(kind: type) -> list[tuple[str, Reader, bool]]:
    """Name, reader and whether it is required, for each field of a dataclass."""
    hints = typing.get_type_hints(kind, localns={"Study": Study})  # others name Study without loading it
    return [
        (
            field.name,
            _reader(hints[field.name]),
            field.default is field.default_factory is dataclasses.MISSING,
        )
        for field in dataclasses.fields(kind)
    ]


@cache
def _reader(kind: Any) -> Reader:
    origin, parts = typing.get_origin(kind) or kind, typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        return _any_of(types.NoneType in parts, [_reader(one) for one in parts if one is not types.NoneType])
    if origin is float:
        return _number
    if origin in (str, int, bool):
        wanted = f"of type {origin.__name__}"
        return lambda value, place: _as(type(value) is origin, wanted, place, value)
    if origin in (Mapping, dict):
        read = _reader(parts[1])
        return lambda value, place: {
            key: read(entry, (*place, key)) for key, entry in _as_table(value, place).items()
        }
    if origin is np.ndarray:  # null reads as NaN
        number = typing.get_args(parts[1])[0]
        return lambda value, place: np.array(_as_list(value, place), dtype=number)
    if origin in (Sequence, tuple):  # any number of values of one type
        read, kept = _reader(parts[0]), tuple if origin is tuple else list
        return lambda value, place: kept(
            read(entry, (*place, k)) for k, entry in enumerate(_as_list(value, place))
        )
    if dataclasses.is_dataclass(kind):
        return lambda value, place: _fields(origin, value, place, {})
    if issubclass(origin, BaseModel):
        return lambda value, _: origin.model_validate(value)
    return lambda value, _: value


def _number(value: Any, place: Place) -> float:
    _as(value is None or type(value) in (int, float), "a number", place)
    return np.nan if value is None else float(value)


def _any_of(optional: bool, readers: Sequence[Reader]) -> Reader:
    *first, last = readers

    def read(value: Any, place: Place) -> Any:
        if value is None and optional:
            return None
        for one in first:
            with suppress(ValueError):
                return one(value, place)
        return last(value, place)

    return read


def _as_table(value: Any, place: Place) -> Any:
    return _as(isinstance(value, dict), "a table", place, value)


def _as_list(value: Any, place: Place) -> Any:
    return _as(isinstance(value, list), "a list", place, value)


def _as(right: bool, wanted: str, place: Place, value: Any = None) -> Any:
    """The value, if it is right. Raises ValueError."""
    if not right:
        raise ValueError(f"{'.'.join(map(str, place))!r} is not {wanted}")
    return value
