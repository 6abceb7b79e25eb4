"""[inputs]: how well the numbers of a study are known, each as a standard deviation or a range."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from .checks import fits_kind
from .fields import NEVER_AN_INPUT, EntryError, Target, entries, targets, value_at
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
    if not isinstance(data.get("inputs"), Mapping):
        return [], []
    known = {key: target for key, target in targets(data).items() if _can_vary(data, target)}
    found: dict[str, Input] = {}
    findings: list[Finding] = []
    for key, loc, entry in places(data, known):
        try:
            if key in found:
                raise EntryError("is given twice")
            found[key] = _input(data, key, entry, known)
        except EntryError as error:
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


def _can_vary(data: Mapping[str, Any], target: Target) -> bool:
    return target.si is not None and target.loc[0] not in NEVER_AN_INPUT and fits_kind(data, target.loc)


def places(data: Mapping[str, Any], known: Collection[str]) -> Iterator[tuple[str, Loc, Any]]:
    """(key, place, entry) of the table [inputs]."""
    table = {key: value for key, value in data["inputs"].items() if key not in OWN_KEYS}
    return entries(table, known, {"sd", "range"}, ("inputs",))


def _input(data: Mapping[str, Any], key: str, entry: Any, known: Mapping[str, Target]) -> Input:
    if key.partition(".")[0] == "geometry":
        raise EntryError("is another body with other nodes, which cannot be held against this one; sweep it")
    if key not in known:
        raise EntryError(unknown(key, list(known), "quantity", list_all=False))
    if not isinstance(entry, Mapping):
        raise EntryError(f"must be a table: {_FORMS}; not {type_name(entry)}")
    for name in entry:
        if name not in ("sd", "range"):
            raise EntryError(unknown(name, ("sd", "range"), "key"), name)
    if len(entry) != 1:
        raise EntryError(f"{_FORMS}, one of them")
    value = value_at(data, known[key].loc)
    if not isinstance(value, float):
        raise EntryError("has no value in this study; give it one, or leave it out here")
    target = known[key]
    if "sd" in entry:
        deviation = _number(target, entry["sd"], "sd")
        if deviation <= 0:
            raise EntryError(f"must be positive, not {deviation:g}", "sd")
        return Input(key, target.loc, target.unit, value, deviation, None)
    ends = entry["range"]
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        raise EntryError("must be a list of two values, the least and the most", "range")
    low, high = (_number(target, end, "range") for end in ends)
    if not low < high:
        raise EntryError("must begin with the smaller value, and end with another", "range")
    if not low <= value <= high:
        unit = "" if target.unit == "1" else f" {target.unit}"
        raise EntryError(f"does not hold the study's own value, {value:g}{unit}", "range")
    return Input(key, target.loc, target.unit, value, None, (low, high))


def _number(target: Target, value: Any, name: str) -> float:
    assert target.si is not None
    try:
        found = target.si.read(value)
    except ValueError as error:
        raise EntryError(str(error), name) from None
    assert isinstance(found, float)
    return found
