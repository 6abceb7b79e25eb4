"""The sweep of a study: its axes, their values in SI, and the cases that they make."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

from .checks import validate
from .errors import MOST_TOLD, Finding, Loc, Source, unknown
from .fields import NEVER_AN_INPUT, EntryError, Target, entries, targets, value_at
from .files import GEOMETRY_PATH, short_path
from .schema import Inputs, Study
from .units import shown, type_name

Value = float | str
# label, swept values by key, the data of a study with them
Case = tuple[str, dict[str, Value], dict[str, Any]]

OWN_KEYS = ("mode", "samples", "seed")  # of [sweep], which are no axis
_OF_INPUTS = ("method", "samples", "seed")  # of [inputs], which are no input
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
    given = {k: v for k, v in sweep.items() if k not in OWN_KEYS}
    known = targets(data) if given else {}  # slow, and every case of a sweep is asked
    sampled = sweep.get("mode") == "latin-hypercube"
    axes: dict[str, Axis] = {}
    findings: list[Finding] = []
    for key, loc, value in entries(given, known, {"start", "stop"}, ("sweep",)):
        if key not in known:
            findings.append((loc, _unknown_key(key, list(known))))
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
            resolved.append(ResolvedCase(label, swept, swept_units, study))
    found = [
        (loc, texts[0] + (f"; {len(texts) - 1} more cases are alike" if len(texts) > 1 else ""))
        for loc, texts in faults.items()
    ]
    repeated = next((label for label, count in labels.items() if count > 1), None)
    if repeated is not None:
        found.append((("sweep",), f"makes the case {repeated} more than once"))
    return resolved, found


# --- [inputs]: how well the numbers of a study are known, each as a standard deviation or a range ---


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


def inputs_of(study: Study) -> list[Input]:
    """What is not known of a sound study, in the order of its keys."""
    return read_inputs(study.model_dump())[0]


def read_inputs(data: Mapping[str, Any]) -> tuple[list[Input], list[Finding]]:
    """The inputs in a study's data, with all defaults, and what is wrong with them."""
    if not isinstance(data.get("inputs"), Mapping):
        return [], []
    known = {
        key: target
        for key, target in targets(data).items()
        if target.si is not None and target.loc[0] not in NEVER_AN_INPUT
    }
    found: dict[str, Input] = {}
    findings: list[Finding] = []
    for key, loc, entry in _entries(data, known):
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
    own = {key: table[key] for key in _OF_INPUTS if key in table}
    for one in read_inputs(data)[0]:
        own[one.key] = {"sd": one.sd} if one.span is None else {"range": list(one.span)}
    return own


def _entries(data: Mapping[str, Any], known: Collection[str]) -> Iterator[tuple[str, Loc, Any]]:
    """(key, place, entry) of the table [inputs]."""
    table = {key: value for key, value in data["inputs"].items() if key not in _OF_INPUTS}
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
        deviation = float(_value(target, entry["sd"], "sd"))
        if deviation <= 0:
            raise EntryError(f"must be positive, not {deviation:g}", "sd")
        return Input(key, target.loc, target.unit, value, deviation, None)
    ends = entry["range"]
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        raise EntryError("must be a list of two values, the least and the most", "range")
    low, high = (float(_value(target, end, "range")) for end in ends)
    if not low < high:
        raise EntryError("must begin with the smaller value, and end with another", "range")
    if not low <= value <= high:
        unit = "" if target.unit == "1" else f" {target.unit}"
        raise EntryError(f"does not hold the study's own value, {value:g}{unit}", "range")
    return Input(key, target.loc, target.unit, value, None, (low, high))


# --- The studies with other values of the inputs that tell what comes of not knowing them ---


SENSITIVITIES, SAMPLING, SOBOL = "sensitivities", "sampling", "sobol"
INSTALL = "pip install --constraint constraints.txt --editable '.[sensitivity]'"
_SAMPLES = 64
_MOST = 2000  # variations of a case
# what no variation has: it decides nothing of an answer, or would begin anew
_NOT_VARIED = ("inputs", "sweep", "measured", "limits", "calibration")


@dataclass(frozen=True)
class Variation:
    """A study in which some inputs have other values: key -> value, SI."""

    values: Mapping[str, float]
    study: Study


def unit_cube(keys: int) -> dict[str, Any]:
    """What SALib calls a problem: so many numbers from 0 to 1."""
    names = [f"x{k}" for k in range(keys)]
    return {"num_vars": keys, "names": names, "bounds": [[0.0, 1.0]] * keys}


def salib(module: str) -> Any:
    """A module of SALib. Raises ImportError, whose message has the command that installs it."""
    try:
        return import_module(f"SALib.{module}")
    except ImportError:
        raise ImportError(f"Sobol's indices need SALib, which is not installed: {INSTALL}") from None


def _varied_values(inputs: Sequence[Input], table: Inputs) -> list[dict[str, float]]:
    """The values of each variation: per key the lower and the upper, or the samples. Raises ImportError."""
    if table.method == SENSITIVITIES:
        return [{one.key: end} for one in inputs for end in one.ends]
    keys, number, seed = len(inputs), table.samples or _SAMPLES, table.seed or 0
    if table.method == SAMPLING:
        from scipy.stats import qmc

        shares = qmc.LatinHypercube(keys, rng=seed).random(number)
    else:
        sobol = salib("sample.sobol").sample
        shares = sobol(unit_cube(keys), number, calc_second_order=False, seed=seed)
    return [{one.key: one.at(float(share)) for one, share in zip(inputs, row, strict=True)} for row in shares]


def variations(study: Study) -> tuple[list[Variation], list[Finding]]:
    """The studies that tell what comes of not knowing the inputs, or the first thing that is wrong with them."""
    if study.inputs is None:
        return [], []
    data = study.model_dump()
    inputs, findings = read_inputs(data)
    if findings:
        return [], findings
    keys, number = len(inputs), study.inputs.samples or _SAMPLES
    count = {SENSITIVITIES: 2 * keys, SAMPLING: number, SOBOL: number * (keys + 2)}[study.inputs.method]
    if count > _MOST:
        text = f"makes {count:,} variations of each case, more than the {_MOST:,} allowed; take fewer samples"
        return [], [(("inputs",), text)]
    try:
        values = _varied_values(inputs, study.inputs)
    except ImportError as error:
        return [], [(("inputs", "method"), str(error))]
    locs = {one.key: one.loc for one in inputs}
    rest = {key: value for key, value in data.items() if key not in _NOT_VARIED}
    found: list[Variation] = []
    for changed in values:
        varied = rest
        for key, value in changed.items():
            varied = substituted(varied, locs[key], value)
        other, faults = validate(varied, study._source)
        if other is None:  # told at the input that makes the fault
            loc, text = faults[0]
            key = next((key for key in changed if locs[key] == loc), next(iter(changed)))
            place = {name: place for name, place, _ in _entries(data, targets(data))}.get(key, ("inputs",))
            return [], [(place, f"at {changed[key]:g}: {text}; give a range that ends before")]
        found.append(Variation(changed, other))
    return found, []
