"""Plain data, as JSON has it, back to what a type says: the other way of `vdmbench.machine.plain`."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from pydantic import BaseModel

from ..study.schema import Study

T = TypeVar("T")
Reader = Callable[[Any], Any]


class StoreError(ValueError):
    """A stored result is damaged or of another schema; the message says which file and what to do."""


class OlderSchemaError(StoreError):
    """A stored result of an older version of the program, sound for that one."""


class MisfitError(ValueError):
    """Data of another shape: where, from the inside out, and what should be there."""

    def __init__(self, wanted: str) -> None:
        super().__init__(wanted)
        self.wanted, self.place = wanted, list[str]()

    def __str__(self) -> str:
        return f"{'.'.join(self.place[::-1])!r} is not {self.wanted}"


def typed(kind: type[T], value: Any, **given: Any) -> T:
    """A value of a dataclass, or of whatever type its fields have: NaN where a number is null.

    Parameters
    ----------
    given : fields of the dataclass that are known already

    Raises
    ------
    ValueError
        of another shape; one line says where.
    """
    if dataclasses.is_dataclass(kind):
        return cast(T, _fields(kind, value, given))
    return cast(T, _reader(cast(Any, kind))(value))


def _fields(kind: type, value: Any, given: dict[str, Any]) -> Any:
    _as(isinstance(value, dict), "a table")
    for name, read, needed in _parts(kind):
        if name in given:
            continue
        try:
            if name in value:
                given[name] = read(value[name])
            else:
                _as(not needed, "there")
        except MisfitError as error:
            error.place.append(name)
            raise
    return kind(**given)


@cache
def _parts(kind: type) -> list[tuple[str, Reader, bool]]:
    """Name, reader and need of each field of a dataclass."""
    hints = typing.get_type_hints(kind, localns={"Study": Study})  # which others name without loading it
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
        return lambda value: _as(type(value) is origin, f"of type {origin.__name__}", value)
    if origin in (Mapping, dict):
        return _each(dict, "a table", _reader(parts[1]))
    if origin is np.ndarray:  # in which a number that is null is NaN
        number = typing.get_args(parts[1])[0]
        return lambda value: np.array(_as(isinstance(value, list), "a list", value), dtype=number)
    if origin in (Sequence, tuple):
        read = _each(list, "a list", _reader(parts[0]))  # of one type, however many
        return (lambda value: tuple(read(value))) if origin is tuple else read
    if dataclasses.is_dataclass(kind):
        return lambda value: _fields(origin, value, {})
    return origin.model_validate if issubclass(origin, BaseModel) else lambda value: value


def _number(value: Any) -> float:
    _as(value is None or type(value) in (int, float), "a number")
    return np.nan if value is None else float(value)


def _any_of(optional: bool, readers: Sequence[Reader]) -> Reader:
    def read(value: Any) -> Any:
        if value is None and optional:
            return None
        for k, one in enumerate(readers):
            try:
                return one(value)
            except ValueError:
                if k + 1 == len(readers):
                    raise
        return None

    return read


def _each(container: type, wanted: str, read_one: Reader) -> Reader:
    def read(value: Any) -> Any:
        _as(isinstance(value, container), wanted)
        found = {}
        for key, entry in value.items() if container is dict else enumerate(value):
            try:
                found[key] = read_one(entry)
            except MisfitError as error:
                error.place.append(str(key))
                raise
        return found if container is dict else list(found.values())

    return read


def _as(right: bool, wanted: str, value: Any = None) -> Any:
    """The value, where it is right. Raises MisfitError."""
    if not right:
        raise MisfitError(wanted)
    return value
