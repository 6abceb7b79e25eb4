"""Quantities of a study file: a number is SI, a text with a unit is converted to SI.

Numbers are multiplied as decimals, so `"0.3 mm"` and `0.0003` give the same float and the same case hash.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal, InvalidOperation
from functools import lru_cache
from typing import Any

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_FACTOR = r"[^\W\d_]+(?:_[^\W\d_]+)*(?:(?:\*\*|\^)-?\d|[²³])?"  # a unit, perhaps to a power of one digit
_UNIT = rf"(?:1/)?(?:{_FACTOR}|[°%])(?:\s?[*/·]\s?{_FACTOR})*"
_QUANTITY = re.compile(rf"\s*({NUMBER})\s*({_UNIT})?\s*")
_LONGEST = 80  # characters; a longer text is no quantity

DIMENSIONS = {
    "m": ("a length", "50 mm"),
    "rad": ("an angle", "25 deg"),
    "Pa": ("a pressure or modulus", "5 kPa"),
    "N": ("a force", "2 N"),
    "N/m": ("a force per length", "58 N/m"),
    "Pa/m": ("a pressure per length", "1 kPa/mm"),
    "kg/m^3": ("a density", "1060 kg/m^3"),
    "m/s^2": ("an acceleration", "9.81 m/s^2"),
    "s": ("a time", "1 ms"),
    "1": ("a plain number", "0.45"),
}
# common units, in the unit of their dimension; pint, which takes 0.4 s to load, knows all others
_COMMON = {
    "m": {"m": "1", "cm": "0.01", "mm": "0.001", "um": "1e-6"},
    "rad": {"rad": "1", "deg": "0.01745329251994329576923690768"},
    "Pa": {"Pa": "1", "kPa": "1e3", "MPa": "1e6", "GPa": "1e9"},
    "N": {"N": "1", "mN": "0.001"},
    "N/m": {"N/m": "1"},
    "Pa/m": {"Pa/m": "1"},
    "kg/m^3": {"kg/m^3": "1"},
    "m/s^2": {"m/s^2": "1"},
    "s": {"s": "1", "ms": "0.001", "us": "1e-6"},
}
_ANGLES = {"radian", "degree", "turn", "arcminute", "arcsecond", "milliradian", "grade"}


class QuantityError(ValueError):
    """A value that is not a finite quantity of the wanted dimension; the message says what is wanted."""


IN_METRES = 0.5  # m: shorter lengths are told in millimetres, even where a surface is a decimetre across
LARGEST = 1e100  # of a number: its third power is still finite


def to_si(value: Any, unit: str) -> float:
    """Return `value`, a number in SI or a text such as "5 kPa", as a finite float in `unit`.

    `unit` is a key of `DIMENSIONS`. Raises QuantityError with a sentence for the user: wrong type, unknown unit,
    wrong dimension, not finite.
    """
    what, example = DIMENSIONS[unit]
    if isinstance(value, str):
        return _finite(_parse(value, unit))
    if isinstance(value, bool) or not isinstance(value, int | float):
        wanted = (
            f"{what}, such as {example}"
            if unit == "1"
            else f'{what}, such as "{example}" or a number in {unit}'
        )
        raise QuantityError(f"must be {wanted}, not {type_name(value)}")
    return _finite(value)


def _finite(value: float | Decimal) -> float:
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not abs(number) <= LARGEST:
        told = (
            f"must be at most {LARGEST:.0e} in size" if math.isfinite(number) else "must be a finite number"
        )
        raise QuantityError(told)
    return number + 0.0  # -0.0 and 0.0 are one value, and one hash


def _parse(text: str, unit: str) -> Decimal:
    what, example = DIMENSIONS[unit]
    match = _QUANTITY.fullmatch(text) if len(text) <= _LONGEST else None
    if match is None:
        raise QuantityError(f'{shown(text)} is not {what}; write a number and a unit, such as "{example}"')
    number, unit_text = match.groups()
    if unit == "1":
        raise QuantityError(f"must be a plain number without quotes or a unit, such as {example}")
    if unit_text is None:
        raise QuantityError(
            f'{shown(text)} has no unit; write {what} with one, such as "{example}", or a bare number in {unit}'
        )
    try:
        return Decimal(number) * _factor(unit_text, unit)
    except (InvalidOperation, ArithmeticError):
        raise QuantityError("must be a finite number") from None


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint  # 0.4 s: only where a study writes a unit

    return pint.UnitRegistry(non_int_type=Decimal)


@lru_cache(maxsize=256)
def _factor(text: str, unit: str) -> Decimal:
    """Factor from the unit `text` to the SI `unit`."""
    what, example = DIMENSIONS[unit]
    wrong = f'"{text}" is not a unit of {what}; write it as in "{example}"'
    if text in _COMMON[unit]:
        return Decimal(_COMMON[unit][text])
    import pint

    registry = _registry()
    try:
        parsed = registry.parse_units(text)
        dimension = parsed.dimensionality
    except (pint.errors.PintError, ValueError, TypeError, AssertionError, AttributeError):
        raise QuantityError(f'unknown unit "{text}"; write {what}, such as "{example}"') from None
    if dimension != registry.parse_units(unit).dimensionality:
        raise QuantityError(wrong)
    # pint counts angles and percentages alike as dimensionless
    if unit == "rad" and (len(parsed._units) != 1 or not _ANGLES.issuperset(parsed._units)):
        raise QuantityError(wrong)
    return Decimal(registry.Quantity(Decimal(1), parsed).to(unit).magnitude)


def type_name(value: Any) -> str:
    """The type of a value read from TOML, in a user's words."""
    if isinstance(value, bool):
        return "true or false"
    for kind, name in ((str, "a text"), (int, "a whole number"), (float, "a number"), (dict, "a table")):
        if isinstance(value, kind):
            return name
    if isinstance(value, list | tuple):
        return "a list"
    return "a date or time" if hasattr(value, "isoformat") else type(value).__name__


def shown(value: object, longest: int = 60) -> str:
    """`value` quoted for a message: one line, no control characters, not too long."""
    text = ascii(value) if isinstance(value, str) and not value.isprintable() else repr(value)
    if text.startswith("'") and text.endswith("'") and '"' not in text:
        text = f'"{text[1:-1]}"'
    return text if len(text) <= longest else text[: longest - 3] + "..."
