"""The sweep of a study, its axes and cases; and the uncertain inputs of a study."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from .checks import validate
from .errors import MOST_TOLD, Finding, InputError, Loc, Source, unknown, value_at
from .files import located, substituted, without_folders
from .kinds import Enters, Table
from .schema import NEVER_AN_INPUT, NEVER_SWEPT, Known, Range, Study, Sweep
from .units import IN_METRES, shown, to_si, type_name

Value = float | str
Entry = tuple[
    str, Loc, Loc, Any
]  # of [sweep] or [inputs]: key, where that is in the file and in the study, value
# label, swept values by key, the data of a study with them
Case = tuple[str, dict[str, Value], dict[str, Any]]

STAR, _HYPERCUBE = "one-at-a-time", "latin-hypercube"
_BASE = "base"  # label of a star's central case


@dataclass(frozen=True)
class Axis:
    """One swept key with its values in SI; for a Latin hypercube the ends of its range.

    Attributes
    ----------
    loc, place : of the axis in the file, and of the varied value in the study
    unit : SI; "" for a value that is no quantity
    """

    key: str
    loc: Loc
    place: Loc
    values: tuple[Value, ...] = ()
    unit: str = ""
    log: bool = False

    def at(self, fraction: float) -> float:
        """The value at a fraction of the range, to 12 digits, so that 0.45 to 0.49 passes through 0.46."""
        start, stop = float(self.values[0]), float(self.values[-1])
        if fraction in (0.0, 1.0):
            return stop if fraction else start
        if self.log:
            value = math.exp(math.log(start) + (math.log(stop) - math.log(start)) * fraction)
        else:
            value = start + (stop - start) * fraction
        return float(f"{value:.12g}")


@dataclass(frozen=True)
class ResolvedCase:
    """One case, ready to run.

    Attributes
    ----------
    label : distinguishes it, such as "poisson_ratio = 0.45"; empty in a study of one case
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
    """The axes of a study's data, as parsed from TOML, and their mistakes.

    A study with the first value of each axis provides keys and units. If that study has mistakes, each axis has
    only its first value, as written. The start of a hypercube's range is no sample, and may be invalid; the end
    is then tried.
    """
    sweep = data.get("sweep")
    if not isinstance(sweep, dict):
        return [], []
    entries, findings = _entries("sweep", sweep, data, Range, NEVER_SWEPT)
    findings += _check_mode(sweep, complete=bool(entries or findings))
    places = {place: key for key, _, place, _ in entries}
    for entry in list(entries):
        if part_of := [places[entry[2][:end]] for end in range(len(entry[2])) if entry[2][:end] in places]:
            findings.append((entry[1], f"is part of {part_of[0]}, another axis; vary one of them"))
            entries.remove(entry)
    if not entries:
        return [], findings
    first = dict(data)
    for _, _, place, value in entries:
        if value and isinstance(value, list | dict):
            first = substituted(first, place, value[0] if isinstance(value, list) else value.get("start"))
    axes: list[Axis] = []
    sampled = sweep.get("mode") == _HYPERCUBE
    study, faults = _typed(first)
    wrong = {fault["loc"] for fault in faults} if sampled else set()
    if ranges := [
        one for one in entries if one[2] in wrong and isinstance(one[3], dict) and "stop" in one[3]
    ]:
        for _, _, place, value in ranges:
            first = substituted(first, place, value["stop"])
        study, faults = _typed(first)
    for key, loc, place, value in entries:
        with _told(findings, loc):
            axes.append(_axis(Axis(key, loc, place), value, study, sampled=sampled))
    findings += [(told_at(axes, data, fault["loc"]), fault["msg"]) for fault in faults]
    if sweep.get("mode") == "zip" and len({len(axis.values) for axis in axes}) > 1 and not findings:
        lengths = ", ".join(f"{axis.key} has {len(axis.values)}" for axis in axes)
        findings.append((("sweep",), f"zip needs axes of one length, but {lengths}"))
    return axes, findings


def _typed(data: Mapping[str, Any]) -> tuple[Study | None, list[ErrorDetails]]:
    """The study of given data, or the type errors of its values."""
    try:
        return Study.model_validate(data), []
    except ValidationError as error:
        return None, error.errors()


@contextlib.contextmanager
def _told(findings: list[Finding], loc: Loc) -> Iterator[None]:
    """Report the mistakes of an entry at its place."""
    try:
        yield
    except ValidationError as error:
        findings += [((*loc, *fault["loc"]), fault["msg"]) for fault in error.errors()]
    except InputError as error:
        findings.append(((*loc, *error.place), str(error)))


def told_at(axes: Sequence[Axis], data: Mapping[str, Any], loc: Loc) -> Loc:
    """The place to report a mistake: the axis that varies the value, or creates what the file lacks."""
    for axis in axes:
        if loc == axis.place or (isinstance(axis.place[-1], int) and loc == axis.place[:-1]):
            return axis.loc
    made = next((loc[:end] for end in range(1, len(loc) + 1) if value_at(data, loc[:end]) is None), None)
    return next((axis.loc for axis in axes if made and axis.place[: len(made)] == made), loc)


def _entries(
    name: str, table: Mapping[str, Any], data: Mapping[str, Any], kind: type[Table], never: Set[str]
) -> tuple[list[Entry], list[Finding]]:
    """The entries of [sweep] or [inputs], and the mistakes in their keys."""
    own = Sweep.model_fields.keys() if kind is Range else ()
    tables = [one for one in Study.model_fields if one not in never]
    found: dict[str, Entry] = {}
    findings: list[Finding] = []
    entries = {key: value for key, value in table.items() if key not in own}
    for key, loc, value in _flattened(entries, kind, (name,)):
        path = key.split(".")
        with _told(findings, loc):
            if key in found:
                raise InputError("is given twice")
            if path[0] == "geometry" and path[0] in never:
                told = "is another body with other nodes, which cannot be held against this one; sweep it"
                raise InputError(told)
            if path[0] not in tables:
                raise InputError(unknown(path[0], [*tables, *own], "key"))
            found[key] = key, loc, located(data, path, kind.model_fields), value
        if len(findings) > MOST_TOLD:
            break  # the search for the intended key is slow
    return list(found.values()), findings


def _flattened(
    table: Mapping[str, Any], kind: type[Table], loc: Loc, prefix: str = ""
) -> Iterator[tuple[str, Loc, Any]]:
    """(key, place, entry) of a table of dotted keys; `tissue.poisson_ratio = ...` is as good as with quotes.

    An entry that is a table has a key of `kind`; the others are tables around entries.
    """
    for name, value in table.items():
        key, place = prefix + name, (*loc, name)
        if isinstance(value, Mapping) and value and not kind.model_fields.keys() & value.keys():
            yield from _flattened(value, kind, place, f"{key}.")
        else:
            yield key, place, value


def at(study: Table, loc: Loc) -> tuple[Any, str]:
    """The value at a place of a valid study, None if it has none, and its SI unit, "" if it is no quantity.

    Raises
    ------
    InputError
        no such key.
    """
    value, unit = study, ""
    for part in loc:
        if isinstance(value, Table):
            known = type(value).model_fields
            if part not in known:
                raise InputError(unknown(str(part), list(known), "key"))
            value, unit = getattr(value, str(part)), value.unit(str(part))
        else:
            value = value_at(value, (part,))
    return value, unit


def _axis(axis: Axis, value: Any, study: Study | None, *, sampled: bool) -> Axis:
    """An axis with its values; without a valid study only the first one, as written.

    Raises
    ------
    InputError, ValidationError
        the entry is no axis of such values.
    """
    if not isinstance(value, list | dict):
        raise InputError(f"must be a list of values, or {{ start, stop, num }}, not {type_name(value)}")
    if isinstance(value, list) and sampled:
        raise InputError("a latin-hypercube samples ranges: write { start, stop } instead of a list")
    if not value:
        raise InputError("has no values; list at least one")
    given = Range.model_validate(value) if isinstance(value, dict) else None
    if study is None:
        return replace(axis, values=(given.start if given else value[0],))
    found, unit = at(study, axis.place)
    if isinstance(found, tuple | Table):
        raise InputError(f"is no single value; vary one of its own, such as {axis.key}.0")
    if given is None:
        values = tuple(_value(unit, item, place) for place, item in enumerate(value))
        return replace(axis, unit=unit, values=values)
    if not unit:
        raise InputError("has no range: list its values")
    start, stop = (float(_value(unit, getattr(given, name), name)) for name in ("start", "stop"))
    if start == stop:
        raise InputError("start and stop are the same value")
    if given.scale == "log" and min(start, stop) <= 0:
        raise InputError("a log scale needs a positive start and stop")
    axis = replace(axis, unit=unit, values=(start, stop), log=given.scale == "log")
    if sampled == (given.num is not None):
        told = "a latin-hypercube has one number of samples for all axes: leave num out"
        raise InputError(told if sampled else f"is missing: {Range.model_fields['num'].description}", "num")
    count = given.num or 2
    return replace(axis, values=tuple(axis.at(k / (count - 1)) for k in range(count)))


def _value(unit: str, value: Any, *inside: str | int) -> Value:
    """One value in SI. Raises InputError."""
    if unit:
        try:
            return to_si(value, unit)
        except ValueError as error:
            raise InputError(str(error), *inside) from None
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise InputError(f"must be a text or a whole number, not {type_name(value)}", *inside)
    return value


def _check_mode(sweep: Mapping[str, Any], *, complete: bool) -> Iterator[Finding]:
    mode = sweep.get("mode", "grid")
    if mode == _HYPERCUBE:
        if "samples" not in sweep:
            yield ("sweep", "samples"), "is missing: the number of cases of a latin-hypercube"
        if not complete:
            yield ("sweep", "mode"), "there is no axis to sample; add one, as the path of a key and its range"
        return
    for key in ("samples", "seed"):
        if key in sweep:
            yield ("sweep", key), 'only mode = "latin-hypercube" takes it'


# --- cases ---


def cases(data: Mapping[str, Any], axes: Sequence[Axis]) -> Iterator[Case]:
    """The cases of a sound sweep, in order: the last axis of a grid varies fastest, a star begins with its base."""
    sweep = data.get("sweep", {})
    rest = {key: value for key, value in data.items() if key != "sweep"}
    last = {axis.key: _short(axis.key) for axis in axes}
    often = Counter(last.values())  # labels use the last part of a key if it is unique

    def told(axis: Axis, value: Value) -> str:
        name = last[axis.key] if often[last[axis.key]] == 1 else axis.key
        unit = axis.unit.removeprefix("1")
        if unit == "m" and not isinstance(value, str) and abs(value) < IN_METRES:
            value, unit = 1e3 * value, "mm"
        return f"{name} = {_shown(without_folders(value))} {unit}".rstrip()

    base: dict[str, Value] = {}
    if star := bool(axes) and sweep.get("mode") == STAR:
        own = {axis.key: value_at(rest, axis.place) for axis in axes}
        base = {key: value for key, value in own.items() if value is not None}
    for changed in _off_base(axes, base) if star else _combinations(sweep, axes):
        case = rest
        for axis, value in changed:
            case = substituted(case, axis.place, value)
        label = ", ".join(told(axis, value) for axis, value in changed)
        yield label or _BASE * star, base | {axis.key: value for axis, value in changed}, case


def _combinations(sweep: Mapping[str, Any], axes: Sequence[Axis]) -> Iterator[list[tuple[Axis, Value]]]:
    mode = sweep.get("mode", "grid")
    rows: Any = itertools.product(*(axis.values for axis in axes))
    if mode == "zip" and axes:
        rows = zip(*(axis.values for axis in axes), strict=True)
    elif mode == _HYPERCUBE:
        from scipy.stats import qmc  # half a second: only where a study samples

        points = qmc.LatinHypercube(len(axes), rng=sweep.get("seed", 0)).random(int(sweep["samples"]))
        order = sorted(axis.key for axis in axes)  # the samples do not depend on the order in the file
        rows = ([axis.at(float(row[order.index(axis.key)])) for axis in axes] for row in points)
    for row in rows:
        yield list(zip(axes, row, strict=True))


def _off_base(axes: Sequence[Axis], base: Mapping[str, Value]) -> Iterator[list[tuple[Axis, Value]]]:
    """No change, then each axis alone, with its values other than the base's."""
    yield []
    for axis in axes:
        own = base.get(axis.key)
        for value in axis.values:
            if isinstance(value, str) or isinstance(own, str | None):
                same = value == own
            else:  # "1 mm" and 0.001 may differ in the last bit
                same = math.isclose(value, own, rel_tol=1e-14)
            if not same:
                yield [(axis, value)]


def first_case(data: dict[str, Any], axes: Sequence[Axis]) -> dict[str, Any]:
    """`data` with the first value of axes whose key the file leaves out; unchanged for a star.

    For the range of a hypercube it is the middle: the ends are no samples.
    """
    if isinstance(data.get("sweep"), dict) and data["sweep"].get("mode") == STAR:
        return data
    for axis in axes:
        if value_at(data, axis.place) is None:
            middle = axis.unit and data["sweep"].get("mode") == _HYPERCUBE
            data = substituted(data, axis.place, axis.at(0.5) if middle else axis.values[0])
    return data


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
    made = list(itertools.islice(cases(data, axes), most + 1))
    if len(made) > most:
        text = f"makes more cases than the {most} allowed; sweep less, or raise study.max_cases"
        return [], [(("sweep",), text)]
    swept_units = {axis.key: axis.unit or "1" for axis in axes}
    resolved: list[ResolvedCase] = []
    faults: dict[Loc, list[str]] = {}
    for label, swept, case in made:
        study, findings = validate(case, source)
        for loc, text in findings:
            faults.setdefault(told_at(axes, data, loc), []).append(
                f"{text} (in the case {label})" if label else text
            )
        if study is not None:
            resolved.append(ResolvedCase(label, swept, swept_units, study))
    alike = {
        loc: f"; {len(texts) - 1} more cases are alike" * (len(texts) > 1) for loc, texts in faults.items()
    }
    found = [(loc, texts[0] + alike[loc]) for loc, texts in faults.items()]
    repeated = [label for label, count in Counter(label for label, *_ in made).items() if count > 1]
    if repeated:
        found.append((("sweep",), f"makes the case {repeated[0]} more than once; leave a value out"))
    return resolved, found


# --- [inputs]: uncertain numbers of a study, each with a standard deviation or a range ---


_FORMS = 'write { sd = "..." }, a standard deviation, or { range = ["...", "..."] }'


@dataclass(frozen=True)
class Input:
    """One uncertain number: a key of the study, its value and its uncertainty, in SI.

    Attributes
    ----------
    ends : values at which answers are compared: the ends of the range, or one standard deviation either way
    weight : factor from half the difference of these answers to a standard deviation
    written, entry : its table as in a file, and the place of that
    """

    key: str
    loc: Loc
    unit: str
    value: float
    ends: tuple[float, float]
    weight: float
    written: dict[str, Any]
    entry: Loc = field(compare=False)

    @property
    def deviation(self) -> float:
        """Standard deviation."""
        return self.weight * (self.ends[1] - self.ends[0]) / 2.0

    @property
    def place(self) -> float:
        """Position of the study's value between the ends, from 0 to 1."""
        low, high = self.ends
        return (self.value - low) / (high - low)


def inputs_of(study: Study) -> list[Input]:
    """The uncertain inputs of a valid study, in the order of its keys."""
    return read_inputs(study)[0]


def read_inputs(study: Study) -> tuple[list[Input], list[Finding]]:
    """The uncertain inputs of a study whose other keys are valid, and their mistakes."""
    if study.inputs is None:
        return [], []
    data = study.model_dump()
    entries, findings = _entries("inputs", data["inputs"], data, Known, NEVER_AN_INPUT)
    found: list[Input] = []
    for key, loc, place, value in entries:
        with _told(findings, loc):
            found.append(_input(study, key, loc, place, value))
    if not found and not findings:
        findings.append((("inputs",), f"names no key; add one, such as tissue.youngs_modulus: {_FORMS}"))
    return sorted(found, key=lambda one: one.key), findings


def _input(study: Study, key: str, loc: Loc, place: Loc, entry: Any) -> Input:
    """Raises InputError, ValidationError."""
    value, unit = at(study, place)
    if not isinstance(entry, Mapping):
        raise InputError(f"must be a table: {_FORMS}; not {type_name(entry)}")
    given = Known.model_validate(dict(entry))
    if (given.sd is None) == (given.range is None):
        raise InputError(f"{_FORMS}, one of them")
    if not (unit and isinstance(value, float)):
        raise InputError("has no number in this study; give it one, or leave it out here")
    if given.sd is not None:
        sd = float(_value(unit, given.sd, "sd"))
        if sd <= 0:
            raise InputError(f"must be positive, not {sd:g}", "sd")
        return Input(key, place, unit, value, (value - sd, value + sd), 1.0, {"sd": sd}, loc)
    if not isinstance(given.range, list | tuple) or len(given.range) != 2:
        raise InputError("must be a list of two values, the least and the most", "range")
    low, high = (float(_value(unit, end, "range")) for end in given.range)
    if not low < high:
        raise InputError("must begin with the smaller value, and end with another", "range")
    if not low <= value <= high:
        raise InputError(
            f"does not hold the study's own value, {value:g} {unit.removeprefix('1')}".rstrip(), "range"
        )
    even = 1.0 / math.sqrt(3.0)  # for a uniform distribution
    return Input(key, place, unit, value, (low, high), even, {"range": [low, high]}, loc)


# --- variations of a study: other values of the uncertain inputs ---


def variations(study: Study) -> tuple[list[ResolvedCase], list[Finding]]:
    """The study with each input at both its ends in turn, or the first mistake in that."""
    if study.inputs is None:
        return [], []
    data = study.model_dump()
    inputs, findings = read_inputs(study)
    # other tables do not affect an answer
    rest = {key: table for key, table in data.items() if Enters.of(Study.model_fields[key]) is None}
    found: list[ResolvedCase] = []
    for one, value in [(known, end) for known in inputs for end in known.ends if not findings]:
        other, faults = validate(substituted(rest, one.loc, value), study._source)
        if other is None:
            return [], [(one.entry, f"at {value:g}: {faults[0][1]}; give a range that ends before")]
        found.append(ResolvedCase(f"{one.key} = {value:.6g}", {one.key: value}, {one.key: one.unit}, other))
    return found, findings
