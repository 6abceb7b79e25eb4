"""[inputs]: how well the numbers of a study are known, each as a standard deviation or a range."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .checks import fits_kind
from .fields import NEVER_AN_INPUT, Target, targets
from .problems import MOST_TOLD, Finding, Loc
from .units import type_name
from .wording import unknown

if TYPE_CHECKING:
    from .schema import Study

OWN_KEYS = ("method", "samples", "seed")
_TAIL = 1e-6  # share of all values that no sample reaches
_FORMS = 'write { sd = "..." }, a standard deviation, or { range = ["...", "..."] }'


@dataclass(frozen=True)
class Input:
    """One number that is not known: a key of the study, its value, and how far it may be off, in SI.

    Attributes
    ----------
    value : that of the study
    sd : standard deviation; None of a range
    span : the ends of a range in which every value is as likely; None of a standard deviation
    """

    key: str
    loc: Loc
    unit: str
    value: float
    sd: float | None
    span: tuple[float, float] | None

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return float(self.sd or 0.0) if self.span is None else (self.span[1] - self.span[0]) / math.sqrt(12.0)

    @property
    def ends(self) -> tuple[float, float]:
        """The values whose answers are subtracted: those of a range, or one standard deviation either way."""
        return self.span or (self.value - self.deviation, self.value + self.deviation)

    @property
    def place(self) -> float:
        """Where the study's value is between the ends, from 0 to 1."""
        low, high = self.ends
        return (self.value - low) / (high - low)

    @property
    def weight(self) -> float:
        """What half the difference of these answers is multiplied by, to be a standard deviation."""
        return 1.0 if self.span is None else 1.0 / math.sqrt(3.0)

    def at(self, share: float) -> float:
        """The value that a share of all is below."""
        if self.span is not None:
            return self.span[0] + (self.span[1] - self.span[0]) * share
        from scipy.special import ndtri  # only where a study samples

        return self.value + self.deviation * float(ndtri(min(max(share, _TAIL), 1 - _TAIL)))

    def on_grid(self, share: float) -> float:
        """The value at a share of the range; of a standard deviation the range that has the same one."""
        if self.span is not None:
            return self.at(share)
        return self.value + self.deviation * math.sqrt(3.0) * (2.0 * share - 1.0)


def inputs_of(study: Study) -> list[Input]:
    """What is not known of a sound study, in the order of its keys."""
    return read_inputs(study.model_dump(by_alias=True, exclude_none=True))[0]


def read_inputs(data: Mapping[str, Any]) -> tuple[list[Input], list[Finding]]:
    """The inputs in a study's data, with all defaults, and what is wrong with them."""
    table = data.get("inputs")
    if not isinstance(table, Mapping):
        return [], []
    known = {key: target for key, target in targets(data).items() if _can_vary(data, target)}
    found: dict[str, Input] = {}
    findings: list[Finding] = []
    for key, loc, entry in entries({k: v for k, v in table.items() if k not in OWN_KEYS}, known):
        try:
            if key in found:
                raise _InputError("is given twice")
            found[key] = _input(data, key, entry, known)
        except _InputError as error:
            findings.append(((*loc, *error.inside), str(error)))
        if len(findings) > MOST_TOLD:
            break
    if not found and not findings:
        findings.append((("inputs",), f"names no key; add one, such as tissue.youngs_modulus: {_FORMS}"))
    return [found[key] for key in sorted(found)], findings


def as_written(data: Mapping[str, Any]) -> dict[str, Any]:
    """The table [inputs] as a file could hold it, in SI."""
    table: Mapping[str, Any] = data["inputs"]
    own = {key: table[key] for key in OWN_KEYS if key in table}
    for one in read_inputs(data)[0]:
        own[one.key] = {"sd": one.sd} if one.span is None else {"range": list(one.span)}
    return own


class _InputError(ValueError):
    def __init__(self, message: str, *inside: str | int) -> None:
        super().__init__(message)
        self.inside = inside


def _can_vary(data: Mapping[str, Any], target: Target) -> bool:
    return target.si is not None and target.loc[0] not in NEVER_AN_INPUT and fits_kind(data, target.loc)


def entries(
    table: Mapping[str, Any], known: Mapping[str, Target], prefix: str = "", loc: Loc = ("inputs",)
) -> Iterator[tuple[str, Loc, Any]]:
    """(key, place, entry); `tissue.youngs_modulus = ...` is as good as with quotes."""
    for name, value in table.items():
        key, place = prefix + name, (*loc, name)
        inner = isinstance(value, Mapping) and bool(value) and not {"sd", "range"} & value.keys()
        if inner and key not in known:
            yield from entries(value, known, f"{key}.", place)
        else:
            yield key, place, value


def _input(data: Mapping[str, Any], key: str, entry: Any, known: Mapping[str, Target]) -> Input:
    if key.partition(".")[0] == "geometry":
        raise _InputError("is another body with other nodes, which cannot be held against this one; sweep it")
    if key not in known:
        raise _InputError(unknown(key, list(known), "quantity", list_all=False))
    if not isinstance(entry, Mapping):
        raise _InputError(f"must be a table: {_FORMS}; not {type_name(entry)}")
    for name in entry:
        if name not in ("sd", "range"):
            raise _InputError(unknown(name, ("sd", "range"), "key"), name)
    if len(entry) != 1:
        raise _InputError(f"{_FORMS}, one of them")
    value = _value_at(data, known[key].loc)
    if value is None:
        raise _InputError("has no value in this study; give it one, or leave it out here")
    target = known[key]
    if "sd" in entry:
        deviation = _number(target, entry["sd"], "sd")
        if deviation <= 0:
            raise _InputError(f"must be positive, not {deviation:g}", "sd")
        return Input(key, target.loc, target.unit, value, deviation, None)
    ends = entry["range"]
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        raise _InputError("must be a list of two values, the least and the most", "range")
    low, high = (_number(target, end, "range") for end in ends)
    if not low < high:
        raise _InputError("must begin with the smaller value, and end with another", "range")
    if not low <= value <= high:
        unit = "" if target.unit == "1" else f" {target.unit}"
        raise _InputError(f"does not hold the study's own value, {value:g}{unit}", "range")
    return Input(key, target.loc, target.unit, value, None, (low, high))


def _number(target: Target, value: Any, name: str) -> float:
    assert target.si is not None
    try:
        found = target.si.read(value)
    except ValueError as error:
        raise _InputError(str(error), name) from None
    assert isinstance(found, float)
    return found


def _value_at(data: Any, loc: Loc) -> float | None:
    for part in loc:
        try:
            data = data[part]
        except (LookupError, TypeError):
            return None
    return data if isinstance(data, float) else None
