"""The sweep of a study: its axes, their values in SI, and the cases that they make."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from .checks import fits_kind
from .fields import EntryError, Target, entries, targets, value_at
from .folders import GEOMETRY_PATH, short_path
from .problems import MOST_TOLD, Finding, Loc, Source
from .schema import Study
from .units import shown, type_name
from .validation import validate
from .wording import unknown

Value = float | str
# label, swept values by key, the data of a study with them
Case = tuple[str, dict[str, Value], dict[str, Any]]

_OWN_KEYS = ("mode", "samples", "seed")
_STAR = "one-at-a-time"
_BASE = "base"  # label of the case that a star is about
_RANGE_KEYS = ("start", "stop", "num", "scale")
_MOST_VALUES = 100_000  # of one axis


class Span(NamedTuple):
    """The range of an axis, in SI."""

    start: float
    stop: float
    log: bool

    def at(self, fraction: float) -> float:
        """The value at a fraction of the range, to 12 digits, so that 0.45 to 0.49 passes through 0.46."""
        if fraction in (0.0, 1.0):
            return self.stop if fraction else self.start
        if self.log:
            low, high = math.log(self.start), math.log(self.stop)
            value = math.exp(low + (high - low) * fraction)
        else:
            value = self.start + (self.stop - self.start) * fraction
        return float(f"{value:.12g}")


@dataclass(frozen=True)
class Axis:
    """One swept key: its values in SI; where a Latin hypercube samples it, the ends and the range itself."""

    key: str
    loc: Loc  # of the axis in the file
    target: Target
    values: tuple[Value, ...]
    span: Span | None = None

    def as_written(self) -> list[Value] | dict[str, Value]:
        """The axis as a study file could hold it, in SI."""
        if self.span is None:
            return list(self.values)
        return {
            "start": self.span.start,
            "stop": self.span.stop,
            "scale": "log" if self.span.log else "linear",
        }


@dataclass(frozen=True)
class ResolvedCase:
    """One case, ready to run.

    Attributes
    ----------
    label : what tells it from its neighbours, such as "poisson_ratio = 0.45"; empty in a study of one case
    swept : swept key -> value, SI
    swept_units : swept key -> SI unit, "1" where it has none
    study : the study with these values and without a sweep
    """

    label: str
    swept: dict[str, Value]
    swept_units: dict[str, str]
    study: Study


# --- axes ---


def read_axes(data: Mapping[str, Any]) -> tuple[list[Axis], list[Finding]]:
    """The axes of a study's data, as parsed from TOML, and what is wrong with them."""
    sweep = data.get("sweep")
    if not isinstance(sweep, dict):
        return [], []
    given = {k: v for k, v in sweep.items() if k not in _OWN_KEYS}
    known = targets(data) if given else {}  # slow, and every case of a sweep is asked
    fitting = [name for name, target in known.items() if fits_kind(data, target.loc)]
    sampled = sweep.get("mode") == "latin-hypercube"
    axes: dict[str, Axis] = {}
    findings: list[Finding] = []
    for key, loc, value in entries(given, known, {"start", "stop"}, ("sweep",)):
        if key not in known:
            findings.append((loc, _unknown_key(key, fitting)))
        elif key in axes:
            findings.append((loc, "is swept twice"))
        else:
            try:
                axes[key] = _axis(key, loc, known[key], value, sampled=sampled)
            except EntryError as error:
                findings.append(((*loc, *error.inside), str(error)))
        if len(findings) > MOST_TOLD:
            break  # the search for the key that was meant is slow
    findings += _check_mode(sweep, list(axes.values()), complete=not findings)
    return list(axes.values()), findings


def _unknown_key(key: str, known: Sequence[str]) -> str:
    return unknown(key, known, "key", list_all=False) + " (an axis is the path of a key of the study)"


def _axis(key: str, loc: Loc, target: Target, value: Any, *, sampled: bool) -> Axis:
    if isinstance(value, dict):
        span, count = _span(target, value, sampled=sampled)
        if count is None:
            return Axis(key, loc, target, (span.start, span.stop), span)
        return Axis(key, loc, target, tuple(span.at(i / (count - 1)) for i in range(count)))
    if not isinstance(value, list):
        raise EntryError(f"must be a list of values, or {{ start, stop, num }}, not {type_name(value)}")
    if sampled:
        raise EntryError("a latin-hypercube samples ranges: write { start, stop } instead of a list")
    if not value:
        raise EntryError("has no values; list at least one")
    return Axis(key, loc, target, tuple(_value(target, item, place) for place, item in enumerate(value)))


def _value(target: Target, value: Any, *inside: str | int) -> Value:
    """One value in SI. Raises EntryError."""
    if target.si is not None:
        try:
            number = target.si.read(value)
        except ValueError as error:
            raise EntryError(str(error), *inside) from None
        if isinstance(number, float):
            return number
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise EntryError(f"must be a text or a whole number, not {type_name(value)}", *inside)
    return value


def _span(target: Target, table: Mapping[str, Any], *, sampled: bool) -> tuple[Span, int | None]:
    """A range and its number of values, None where it is sampled. Raises EntryError."""
    for name in table:
        if name not in _RANGE_KEYS:
            raise EntryError(unknown(name, _RANGE_KEYS, "key"), name)
    if target.si is None:
        raise EntryError("has no range: list its values")
    for name in ("start", "stop"):
        if name not in table:
            raise EntryError(f"{name} is missing")
    start, stop = (float(_value(target, table[name], name)) for name in ("start", "stop"))
    if start == stop:
        raise EntryError("start and stop are the same value")
    if not math.isfinite(stop - start):
        raise EntryError("start and stop are too far apart")
    scale = table.get("scale", "linear")
    if scale not in ("linear", "log"):
        raise EntryError("must be linear or log", "scale")
    if scale == "log" and min(start, stop) <= 0:
        raise EntryError("a log scale needs a positive start and stop")
    span = Span(start, stop, scale == "log")
    if sampled:
        if "num" in table:
            raise EntryError("a latin-hypercube has one number of samples for all axes: leave num out", "num")
        return span, None
    count = table.get("num")
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= _MOST_VALUES:
        raise EntryError(f"must be a whole number from 2 to {_MOST_VALUES}", "num")
    return span, count


def _check_mode(sweep: Mapping[str, Any], axes: Sequence[Axis], *, complete: bool) -> Iterator[Finding]:
    mode = sweep.get("mode", "grid")
    if mode == "latin-hypercube":
        if "samples" not in sweep:
            yield ("sweep", "samples"), "is missing: the number of cases of a latin-hypercube"
        if complete and not axes:
            yield ("sweep", "mode"), "there is no axis to sample; add one, as the path of a key and its range"
        return
    for key in ("samples", "seed"):
        if key in sweep:
            yield ("sweep", key), 'only mode = "latin-hypercube" takes it'
    if mode == "zip" and complete and len({len(axis.values) for axis in axes}) > 1:
        lengths = ", ".join(f"{axis.key} has {len(axis.values)}" for axis in axes)
        yield ("sweep",), f"zip needs axes of one length, but {lengths}"
    if mode in ("grid", _STAR):
        for axis in axes:
            for value, count in Counter(axis.values).items():
                if count > 1:
                    yield axis.loc, f"{_shown(value)} is listed {count} times"


# --- cases ---


def case_count(data: Mapping[str, Any], axes: Sequence[Axis]) -> int:
    """How many cases a sound sweep has."""
    sweep = data.get("sweep", {})
    if sweep.get("mode") == "latin-hypercube":
        return int(sweep["samples"])
    if sweep.get("mode") == _STAR:
        return 1 + sum(len(_off_base(axis, _as_written(data, axis))) for axis in axes)
    lengths = [len(axis.values) for axis in axes]
    return min(lengths, default=1) if sweep.get("mode") == "zip" else math.prod(lengths)


def cases(data: Mapping[str, Any], axes: Sequence[Axis]) -> Iterator[Case]:
    """The cases of a sound sweep, in order: the last axis of a grid varies fastest, a star begins with its base."""
    sweep = data.get("sweep", {})
    rest = {key: value for key, value in data.items() if key != "sweep"}
    if axes and sweep.get("mode") == _STAR:
        yield from _star(rest, axes)
        return
    for values in _combinations(sweep, axes):
        case = rest
        for axis, value in zip(axes, values, strict=True):
            case = substituted(case, axis.target.loc, value)
        swept = dict(zip((axis.key for axis in axes), values, strict=True))
        yield _label(axes, values), swept, case


def _combinations(sweep: Mapping[str, Any], axes: Sequence[Axis]) -> Iterator[tuple[Value, ...]]:
    if not axes:
        return iter([()])
    mode = sweep.get("mode", "grid")
    if mode == "grid":
        return itertools.product(*(axis.values for axis in axes))
    if mode == "zip":
        return iter(zip(*(axis.values for axis in axes), strict=True))
    from scipy.stats import qmc  # half a second: only where a study samples

    points = qmc.LatinHypercube(len(axes), rng=sweep.get("seed", 0)).random(int(sweep["samples"]))
    order = sorted(axis.key for axis in axes)  # the samples do not depend on the order in the file
    columns = [
        [axis.span.at(float(fraction)) for fraction in points[:, order.index(axis.key)]]
        for axis in axes
        if axis.span is not None
    ]
    return iter(zip(*columns, strict=True))


def _star(data: dict[str, Any], axes: Sequence[Axis]) -> Iterator[Case]:
    """The study as it is written, then each axis alone; a key that the file leaves out has no value in the base."""
    written = {axis.key: value for axis in axes if (value := _as_written(data, axis)) is not None}
    yield _BASE, written, data
    names = _names(axes)
    for axis in axes:
        for value in _off_base(axis, written.get(axis.key)):
            label = _named_value(names[axis.key], axis, value)
            yield label, {**written, axis.key: value}, substituted(data, axis.target.loc, value)


def _as_written(data: Mapping[str, Any], axis: Axis) -> Value | None:
    """The study's own value of an axis' key, None where it has none that is sound."""
    value = value_at(data, axis.target.loc)
    if value is None:
        return None
    try:
        return _value(axis.target, value)
    except EntryError:
        return None  # the study's own checks say what is wrong


def _off_base(axis: Axis, base: Value | None) -> list[Value]:
    """The values of an axis that are not the base's own."""
    return [value for value in axis.values if not _same(value, base)]


def _same(value: Value, base: Value | None) -> bool:
    if isinstance(value, str) or isinstance(base, str) or base is None:
        return value == base
    return math.isclose(value, base, rel_tol=1e-14)  # "1 mm" and 0.001 may differ in their last bit


def substituted(data: Any, loc: Loc, value: Value) -> Any:
    """A copy of `data` with `value` at a place; tables on the way that are missing are made."""
    if not loc:
        return value
    first, *rest = loc
    if isinstance(data, list | tuple) and isinstance(first, int):
        return [substituted(item, tuple(rest), value) if i == first else item for i, item in enumerate(data)]
    table = data if isinstance(data, dict) else {}
    return {**table, first: substituted(table.get(first), tuple(rest), value)}


def first_case(data: dict[str, Any], axes: Sequence[Axis]) -> dict[str, Any]:
    """`data` with the first value of those axes whose key the file leaves to the sweep; a star leaves it none."""
    if isinstance(data.get("sweep"), dict) and data["sweep"].get("mode") == _STAR:
        return data
    for axis in axes:
        if _is_absent(data, axis.target.loc):
            data = substituted(data, axis.target.loc, axis.values[0])
    return data


def _is_absent(data: Any, loc: Loc) -> bool:
    """Whether a key, or a table on the way to it, is not there; what is there but of another kind is not absent."""
    for part in loc:
        if isinstance(data, dict):
            if part not in data:
                return True
            data = data[part]
        elif isinstance(data, list | tuple) and isinstance(part, int) and part < len(data):
            data = data[part]
        else:
            return False
    return False


def _label(axes: Sequence[Axis], values: Sequence[Value]) -> str:
    names = _names(axes)
    return ", ".join(
        _named_value(names[axis.key], axis, value) for axis, value in zip(axes, values, strict=True)
    )


def _names(axes: Sequence[Axis]) -> dict[str, str]:
    """Axis key -> what labels call it: its last part, or all of it where two axes share that."""
    short = {axis.key: _short(axis.key) for axis in axes}
    count = Counter(short.values())
    return {key: name if count[name] == 1 else key for key, name in short.items()}


def _named_value(name: str, axis: Axis, value: Value) -> str:
    unit = "" if axis.target.unit == "1" else f" {axis.target.unit}"
    shown_value = short_path(value) if axis.key == GEOMETRY_PATH else value
    return f"{name} = {_shown(shown_value)}{unit}"


def _short(key: str) -> str:
    """The last part of a key; of a component of a vector, `direction x`."""
    rest, _, last = key.rpartition(".")
    if not last.isdecimal():
        return last
    return f"{rest.rpartition('.')[2]} {'xyz'[int(last)] if int(last) < 3 else last}"


def _shown(value: Value) -> str:
    if isinstance(value, str):
        return value if value.isprintable() and len(value) <= 40 else shown(value, 40)
    short = f"{value:.6g}"
    return short if float(short) == value else f"{value:.12g}"


def check_cases(
    data: Mapping[str, Any], axes: Sequence[Axis], most: int, source: Source
) -> tuple[list[ResolvedCase], list[Finding]]:
    """The cases of a sound sweep, or what is wrong with some of them: per key the first case, with a count."""
    count = case_count(data, axes)
    if count > most:
        text = f"makes {count} cases, more than the {most} allowed; sweep less, or raise study.max_cases"
        return [], [(("sweep",), text)]
    swept_units = {axis.key: axis.target.unit for axis in axes}
    at_axis = {axis.target.loc: axis.loc for axis in axes}
    resolved: list[ResolvedCase] = []
    faults: dict[Loc, list[str]] = {}
    labels: Counter[str] = Counter()
    for label, swept, case in cases(data, axes):
        study, findings = validate(case, source)
        labels[label] += 1
        for loc, text in findings:
            place = loc if label == _BASE else at_axis.get(loc, loc)  # the base is what the file says
            faults.setdefault(place, []).append(f"{text} (in the case {label})" if label else text)
        if study is not None:
            study._source = source
            resolved.append(ResolvedCase(label, swept, swept_units, study))
    found = [
        (loc, texts[0] + (f"; {len(texts) - 1} more cases are alike" if len(texts) > 1 else ""))
        for loc, texts in faults.items()
    ]
    repeated = next((label for label, count in labels.items() if count > 1), None)
    if repeated is not None:
        found.append((("sweep",), f"makes the case {repeated} more than once"))
    return resolved, found
