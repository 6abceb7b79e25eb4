"""Numbers for readers: few digits, a suitable unit prefix, a true minus sign."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from ..study.units import IN_METRES

NOT_MEASURED = "not measured"
NOTHING = "–"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MINUS = "−"

# SI unit -> (factor, shown unit), largest first: the first whose factor the value reaches is taken
_SCALES: dict[str, tuple[tuple[float, str], ...]] = {
    "m": ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm")),
    "m^3": ((1e-3, "l"), (1e-6, "ml"), (1e-9, "µl")),
    "Pa": ((1e9, "GPa"), (1e6, "MPa"), (1e3, "kPa"), (1.0, "Pa")),
    "s": ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")),
    "N": ((1e3, "kN"), (1.0, "N"), (1e-3, "mN")),
    "J": ((1.0, "J"), (1e-3, "mJ"), (1e-6, "µJ")),
    "B": ((1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "B")),
}


def number(value: float, digits: int = 3, *, signed: bool = False) -> str:
    """`value` to `digits` significant digits; powers of ten outside 1e-4 to 1e6."""
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else f"{_MINUS}∞"
    sign = _MINUS if value < 0 else "+" if signed and value > 0 else ""
    size = abs(value)
    if size == 0.0:
        return "0"
    mantissa, _, exponent = f"{size:.{digits - 1}e}".partition("e")
    power = int(exponent)
    if -4 <= power < 6:
        return f"{sign}{float(mantissa) * 10.0**power:.{max(digits - 1 - power, 0)}f}"
    if float(mantissa) == 1.0:
        return f"{sign}10{str(power).translate(_SUPERSCRIPT)}"
    return f"{sign}{float(mantissa):g}×10{str(power).translate(_SUPERSCRIPT)}"


def plain(value: float, digits: int = 3) -> str:
    """As `number`, without zeros at the end: for ticks and sentences."""
    text = number(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "×" not in text else text


def percent(ratio: float, *, signed: bool = False) -> str:
    """A ratio as a percentage, for a table."""
    if math.isnan(ratio):
        return NOTHING
    digits = 3 if abs(ratio) >= 0.01 else 2
    return f"{number(ratio * 100.0, digits, signed=signed)} %"


def short_percent(ratio: float) -> str:
    """A ratio as a percentage with a tenth of a per cent, to compare with a limit: 11.6 %, not 12 %."""
    if 0.01 <= abs(ratio) < 1.0:
        return f"{plain(round(100.0 * ratio, 1))} %"
    return f"{plain(100.0 * ratio, 2 if abs(ratio) < 1.0 else 3)} %"


def scale_of(unit: str, values: Iterable[float], digits: int = 3) -> tuple[float, str]:
    """(factor, shown unit) that suits the largest of some SI values at some digits; shown = SI / factor."""
    largest = max((abs(v) for v in values if math.isfinite(v)), default=0.0)
    scales = _SCALES.get(unit)
    if scales is None or largest == 0.0:
        return 1.0, "" if unit == "1" else unit
    if unit == "m" and 1e-3 <= largest < IN_METRES:
        return 1e-3, "mm"
    return next(((f, u) for f, u in scales if largest >= f * (1.0 - 0.5 * 0.1**digits)), scales[-1])


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """An SI value with the unit prefix that suits it."""
    if math.isnan(value):
        return NOTHING
    if unit == "1":
        return number(value, digits)
    factor, shown = scale_of(unit, [value], digits)
    return f"{number(value / factor, digits)} {shown}"


def of_unit(value: float, unit: str, bar: float = math.nan) -> str:
    """A metric's value, a percentage if it has no unit, and its error bar if known."""
    text = percent(value) if unit == "1" else quantity(value, unit)
    return f"{text} ± {of_unit(bar, unit)}" if math.isfinite(bar) else text


def measure(value: float, unit: str = "1", bar: float = math.nan) -> str:
    """A number to compare with a limit, and its error bar if known and not zero: `39.7 % ± 2 %`."""
    text = short_percent(value) if unit == "1" else quantity(value, unit)
    return f"{text} ± {measure(bar, unit)}" if 0.0 < bar < math.inf else text


def loads_in_words(loads: Sequence[float], unit: str) -> str:
    """A range of loads, `0.1 to 0.4 N`; of loads without a unit as shares of the full load."""
    if unit != "1":
        return span(loads, unit, 3)
    if loads[-1] == loads[0] == 1.0:
        return "the full load"
    return f"{' to '.join(dict.fromkeys(f'{load:.3g}' for load in loads))} of the full load"


def span(values: Sequence[float], unit: str, digits: int = 4) -> str:
    """A range `0.1 to 0.4 N`; one number if all are equal; "" for no values."""
    if not values:
        return ""
    # forces from 0.01 N on are shown in newtons, not in millinewtons
    in_newtons = unit == "N" and 0.01 <= max(map(abs, values)) < 1e3
    factor, shown = (1.0, "N") if in_newtons else scale_of(unit, values)
    ends = dict.fromkeys(plain(end / factor, digits) for end in (min(values), max(values)))
    return f"{' to '.join(ends)} {shown}".strip()


def lengths(values: Sequence[float]) -> str:
    """`100 × 80 × 40 mm`."""
    factor, unit = scale_of("m", values)
    return f"{' × '.join(plain(float(value) / factor, 2) for value in values)} {unit}"


def round_below(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a positive value."""
    decade = 10.0 ** math.floor(math.log10(value))
    return decade * max(step for step in (1.0, 2.0, 5.0) if step * decade <= value * 1.001)


def swept_value(value: float | str, unit: str) -> str:
    """A swept parameter's value with six digits, which tell it from its neighbours."""
    if isinstance(value, str):
        return value
    factor, shown = scale_of(unit, [float(value)])
    return f"{value / factor:.6g} {shown}".strip().replace("-", _MINUS)


def listed(items: Iterable[str]) -> str:
    """`a, b and c`."""
    *head, last = list(items) or [""]
    return f"{', '.join(head)} and {last}" if head else last


def first_of(names: Sequence[str], most: int) -> str:
    """The first `most` of the names, and how many more there are."""
    more = [f"{len(names) - most} more"] if len(names) > most else []
    return listed([*names[:most], *more])


def parameter_name(key: str) -> str:
    """A swept key as words: `tissue.poisson_ratio` is "Poisson ratio"."""
    parts = key.split(".")
    if parts[-1].isdecimal() and len(parts) > 1:  # a component of a vector
        parts = [*parts[:-2], f"{parts[-2]} {'xyz'[int(parts[-1])] if int(parts[-1]) < 3 else parts[-1]}"]
    words = parts[-1].replace("_", " ")
    words = words.replace("poisson", "Poisson").replace("youngs", "Young's")
    return f"{words} of {parts[-2]}" if len(parts) > 2 else words


def input_name(key: str) -> str:
    """An input as words; for the shape of a region, with the region: `fraction of below (base)`."""
    parts = key.split(".")
    return f"{parameter_name(key)} ({parts[1]})" if parts[0] == "regions" else parameter_name(key)


def capital(text: str) -> str:
    """The text with a capital first letter."""
    return f"{text[:1].upper()}{text[1:]}"
