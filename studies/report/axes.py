"""One panel of a figure as SVG: curves, clouds of points, bands and bars on linear or logarithmic axes.

Colours are the page's CSS variables, so that one drawing serves light, dark and print, and fonts are the reader's.
Only what the report draws is here: a panel takes a millisecond or two, where a plotting library takes a tenth of a
second, and longer to start than the page to write.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise

from markupsafe import Markup, escape

from .ticks import Name, linear_ticks, log_ticks, names_of

INK, GRID = "var(--ink)", "var(--grid)"
_WIDTH, _HEIGHT = 316.8, 216.0  # as wide as a phone, so that text stays readable there
# the same for all panels, so that their axes line up on the page; room for a label and ticks of eight characters
_LEFT, _RIGHT, _TOP, _BOTTOM = 60.2, 307.3, 4.3, 182.5
_LEFT_OF_BARS, _BOTTOM_OF_SLANTED = 133.0, 142.5  # room for names in place of numbers
_FONT, _LETTER = 8.3, 4.9  # size of the texts, and what a letter of them takes
_TICK, _GAP = 3.5, 7.0  # length of a tick, and how far off its name is
_FAR = 1e5  # from the panel
_ROOM = 0.05  # of the data's extent, free on either side of it
_LARGEST = 1e250  # beyond, and below its inverse on a logarithmic axis, nothing is drawn
_DASHES = {"-": "", "--": "5.9 2.6", "-.": "10.2 2.6 1.6 2.6", ":": "1.6 2.6"}
# corners of a marker of size 1; the circle has none, and the cross is not closed
_MARKERS: dict[str, tuple[tuple[float, float], ...]] = {
    "o": (),
    "s": ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    "^": ((0.0, -0.5), (0.5, 0.5), (-0.5, 0.5)),
    "v": ((0.0, 0.5), (0.5, -0.5), (-0.5, -0.5)),
    "D": ((0.0, -0.7), (0.7, 0.0), (0.0, 0.7), (-0.7, 0.0)),
    "P": tuple(
        (x / 6, y / 6)
        for x, y in (
            *((-1, -3), (1, -3), (1, -1), (3, -1), (3, 1), (1, 1)),
            *((1, 3), (-1, 3), (-1, 1), (-3, 1), (-3, -1), (-1, -1)),
        )
    ),
    "X": tuple(
        (x / 4, y / 4)
        for x, y in (
            *((-1, -2), (0, -1), (1, -2), (2, -1), (1, 0), (2, 1)),
            *((1, 2), (0, 1), (-1, 2), (-2, 1), (-1, 0), (-2, -1)),
        )
    ),
    "x": ((-0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, -0.5)),
}


@dataclass
class Axis:
    """A scale: from what is on it, unless its ends are set; linear, unless it is logarithmic.

    Attributes
    ----------
    seen : the values that it must hold
    low, high : its ends where set
    log, inverted : how it runs
    ticks : (position, name) of each where these are not round numbers
    most : steps between round numbers at most
    name : of a round number
    """

    seen: list[float] = field(default_factory=list)
    low: float | None = None
    high: float | None = None
    log: bool = False
    inverted: bool = False
    ticks: Sequence[tuple[float, str]] | None = None
    most: int = 7
    name: Name | None = None

    def see(self, values: Iterable[float]) -> None:
        """Widen the scale to hold these too; what is not finite, or nearly not, has no place on it."""
        self.seen += [float(v) for v in values if abs(v) < _LARGEST]

    def from_zero(self) -> None:
        """Begin at zero where everything is above it."""
        self.low = min(0.0, self.limits()[0])

    def limits(self) -> tuple[float, float]:
        """Its ends, the smaller first."""
        seen = [v for v in self.seen if v > 1.0 / _LARGEST] if self.log else self.seen
        if not seen:
            low, high = (1.0, 10.0) if self.log else (0.0, 1.0)
        elif self.log:
            low, high = min(seen), max(seen)
            ratio = (high / low) ** _ROOM if high > 1.0001 * low else 10.0**0.5
            low, high = low / ratio, high * ratio
        else:
            low, high = min(seen), max(seen)
            room = _ROOM * (high - low) if high > low else _ROOM * abs(low) or _ROOM
            low, high = low - room, high + room
        if self.low is not None and not (self.log and self.low <= 0.0):
            low = self.low
        high = high if self.high is None else self.high
        return (low, high) if high > low else (low, low + max(1.0, abs(low)))

    def place(self, value: float) -> float:
        """Where a value stands between the ends, as 0 to 1; NaN where the scale has no place for it."""
        low, high = self.limits()
        if self.log:
            if value <= 0.0:
                return math.nan
            value, low, high = math.log10(value), math.log10(low), math.log10(high)
        share = (value - low) / (high - low)
        return 1.0 - share if self.inverted else share

    def marks(self) -> list[tuple[float, str]]:
        """(position, name) of its ticks."""
        if self.ticks is not None:
            return list(self.ticks)
        low, high = self.limits()
        at = log_ticks(low, high) if self.log else linear_ticks(low, high, self.most)
        if self.name is not None:
            return [(tick, self.name(tick)) for tick in at]
        return list(zip(at, names_of(at), strict=True))


@dataclass(frozen=True)
class Curve:
    """Points, joined where `linestyle` is not "none", and marked where there is a `marker`."""

    x: Sequence[float]
    y: Sequence[float]
    linestyle: str
    marker: str
    color: str
    linewidth: float
    markersize: float
    hollow: bool
    alpha: float
    of_height: bool  # y is a share of the panel's height


@dataclass(frozen=True)
class _Band:
    x: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    color: str
    alpha: float


class Axes:
    """A panel: draw on it, then take it as `drawn`. `salt` names it; it must be unique on the page."""

    def __init__(self, x_label: str, y_label: str, salt: str) -> None:
        self.x, self.y = Axis(), Axis(most=6)
        self.curves: list[Curve] = []
        self._labels = (x_label, y_label)
        self._salt = salt
        self._bands: list[_Band] = []
        self._bars: list[tuple[str, float, str]] = []
        self._across: list[tuple[str, float, str]] = []

    def plot(
        self,
        x: Sequence[float],
        y: Sequence[float],
        linestyle: str = "-",
        *,
        color: str,
        marker: str = "",
        linewidth: float = 1.6,
        markersize: float = 4.5,
        hollow: bool = False,
        alpha: float = 1.0,
        of_height: bool = False,
    ) -> None:
        """A curve; `linestyle` is one of - -- -. : and none, `marker` one of o s ^ v D P X x."""
        self.x.see(x)
        if not of_height:
            self.y.see(y)
        self.curves.append(
            Curve(x, y, linestyle, marker, color, linewidth, markersize, hollow, alpha, of_height)
        )

    def band(
        self, x: Sequence[float], low: Sequence[float], high: Sequence[float], *, color: str, alpha: float
    ) -> None:
        """What lies between two curves."""
        self.x.see(x)
        self.y.see([*low, *high])
        self._bands.append(_Band(x, low, high, color, alpha))

    def horizontal(self, y: float, *, color: str) -> None:
        """A dashed line across the panel."""
        self.y.see([y])
        self._across.append(("y", y, color))

    def vertical(self, x: float, *, color: str) -> None:
        """A dashed line from bottom to top."""
        self.x.see([x])
        self._across.append(("x", x, color))

    def bar(self, name: str, value: float, *, color: str) -> None:
        """A bar to the right, below those there are; a panel has bars or curves."""
        self.x.see([value])
        self.x.low = 0.0 if min(self.x.seen, default=0.0) >= 0.0 else None
        self._bars.append((name, value, color))
        rows = len(self._bars)
        self.y = Axis(low=-0.5, high=rows - 0.5, inverted=True)
        self.y.ticks = [(float(k), name) for k, (name, _, _) in enumerate(self._bars)]

    def drawn(self, alt: str) -> Markup:
        """The <svg> element; `alt` says in words what it shows."""
        left = _LEFT_OF_BARS if self._bars else _LEFT
        named = self.x.ticks is not None and sum(len(name) for _, name in self.x.ticks) > 34
        bottom = _BOTTOM_OF_SLANTED if named else _BOTTOM
        frame = _Frame(self.x, self.y, left, bottom)
        parts = [
            f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{escape(alt)}" class="plot">',
            f'<clipPath id="{self._salt}"><rect x="{left:g}" y="{_TOP:g}" width="{_RIGHT - left:g}" '
            f'height="{bottom - _TOP:g}"/></clipPath>',
            frame.grid(across=not self._bars),
            f'<g clip-path="url(#{self._salt})">',
            *(_band(band, frame) for band in self._bands),
            *(_bar(k, value, color, frame) for k, (_, value, color) in enumerate(self._bars)),
            *(part for curve in self.curves for part in _curve(curve, frame)),
            *(_straight(which, value, color, frame) for which, value, color in self._across),
            "</g>",
            frame.edges(),
            *frame.texts(self._labels, slanted=named),
            "</svg>",
        ]
        return Markup("\n".join(part for part in parts if part))


class _Frame:
    """Where the values of two settled scales are on the drawing."""

    def __init__(self, x: Axis, y: Axis, left: float, bottom: float) -> None:
        self.left, self.bottom = left, bottom
        self._x, self._y = _settled(x, _RIGHT - left), _settled(y)
        self._ticks = tuple(
            [(at, name) for value, name in axis.marks() if -1e-6 <= (at := axis.place(value)) <= 1.0 + 1e-6]
            for axis in (self._x, self._y)
        )

    def across(self, x: float) -> float:
        return self.left + (_RIGHT - self.left) * self._x.place(x)

    def up(self, y: float) -> float:
        return self.at_height(self._y.place(y))

    def at_height(self, share: float) -> float:
        return self.bottom + (_TOP - self.bottom) * share

    def _tick(self, which: int, share: float) -> float:
        return self.at_height(share) if which else self.left + (_RIGHT - self.left) * share

    def grid(self, *, across: bool) -> str:
        path = [f"M{_n(self._tick(0, at))} {_n(self.bottom)}V{_TOP:g}" for at, _ in self._ticks[0]]
        if across:
            path += [f"M{_n(self.left)} {_n(self._tick(1, at))}H{_RIGHT:g}" for at, _ in self._ticks[1]]
        return _path("".join(path), f"fill:none;stroke:{GRID};stroke-width:.6") if path else ""

    def edges(self) -> str:
        path = [f"M{_n(self.left)} {_TOP:g}V{_n(self.bottom)}H{_RIGHT:g}"]
        path += [f"M{_n(self._tick(0, at))} {_n(self.bottom)}v{_TICK:g}" for at, _ in self._ticks[0]]
        path += [f"M{_n(self.left)} {_n(self._tick(1, at))}h-{_TICK:g}" for at, _ in self._ticks[1]]
        return _path("".join(path), f"fill:none;stroke:{INK};stroke-width:.7")

    def texts(self, labels: tuple[str, str], *, slanted: bool) -> list[str]:
        below, beside = self._ticks
        out = [f'<g style="font-size:{_FONT:g}px;fill:{INK};text-anchor:{"end" if slanted else "middle"}">']
        for at, name in below:
            x, y = self._tick(0, at), self.bottom + _GAP + (4.0 if slanted else 6.3)
            turn = f' transform="rotate(-30 {_n(x)} {_n(y)})"' if slanted else ""
            out.append(f'<text x="{_n(x)}" y="{_n(y)}"{turn}>{escape(name)}</text>')
        out.append(f'</g><g style="font-size:{_FONT:g}px;fill:{INK};text-anchor:end">')
        for at, name in beside:
            y = self._tick(1, at) + 3.1
            out.append(f'<text x="{_n(self.left - _GAP)}" y="{_n(y)}">{escape(name)}</text>')
        out.append(f'</g><g style="font-size:{_FONT:g}px;fill:{INK};text-anchor:middle">')
        middle = (self.left + _RIGHT) / 2
        out.append(f'<text x="{_n(middle)}" y="{_HEIGHT - 7.9:g}">{escape(labels[0])}</text>')
        if labels[1]:
            widest = max((len(name) for _, name in beside), default=0)
            x, y = max(self.left - _GAP - _LETTER * widest - 6.0, 7.0), (_TOP + self.bottom) / 2
            turn = f"rotate(-90 {_n(x)} {_n(y)})"
            out.append(f'<text x="{_n(x)}" y="{_n(y)}" transform="{turn}">{escape(labels[1])}</text>')
        return [*out, "</g>"]


def _settled(axis: Axis, width: float = math.inf) -> Axis:
    """The same scale with its ends fixed, and of round numbers no more than have room in a width."""
    low, high = axis.limits()
    settled = replace(axis, seen=[], low=low, high=high)
    while settled.most > 2 and sum(_LETTER * (len(name) + 2) for _, name in settled.marks()) > width:
        settled = replace(settled, most=settled.most - 1)
    return settled


def _curve(curve: Curve, frame: _Frame) -> list[str]:
    up = frame.at_height if curve.of_height else frame.up
    at = [(frame.across(float(x)), up(float(y))) for x, y in zip(curve.x, curve.y, strict=True)]
    faint = f";opacity:{curve.alpha:g}" if curve.alpha < 1.0 else ""
    parts = []
    if curve.linestyle != "none" and (path := _joined(at)):
        dashes = _DASHES[curve.linestyle]
        dashed = f";stroke-dasharray:{dashes}" if dashes else ""
        parts.append(
            _path(path, f"fill:none;stroke:{curve.color};stroke-width:{curve.linewidth:g}{dashed}{faint}")
        )
    known = [(x, y) for x, y in at if math.isfinite(x) and math.isfinite(y)]
    if curve.marker and known:
        dx, dy, outline = _outline(curve.marker, curve.markersize)
        path = "".join(f"M{_n(x + dx)} {_n(y + dy)}{outline}" for x, y in known)
        fill = "none" if curve.hollow or curve.marker == "x" else curve.color
        parts.append(_path(path, f"fill:{fill};stroke:{curve.color}{faint}"))
    return parts


def _joined(at: Sequence[tuple[float, float]]) -> str:
    """A path through the points, interrupted where one has no place."""
    path, pen = [], "M"
    for x, y in at:
        if math.isfinite(x) and math.isfinite(y):
            path.append(f"{pen}{_n(x)} {_n(y)}")
            pen = "L"
        else:
            pen = "M"
    return "".join(path)


@cache
def _outline(marker: str, size: float) -> tuple[float, float, str]:
    """Where a marker's outline begins beside its middle, and how it goes on from there."""
    if marker == "o":
        r = _n(size / 2)
        return 0.0, -size / 2, f"a{r} {r} 0 1 1 0 {_n(size)}a{r} {r} 0 1 1 0 -{_n(size)}z"
    corners = [(size * x, size * y) for x, y in _MARKERS[marker]]
    steps = [
        f"{'m' if marker == 'x' and k == 1 else 'l'}{_n(b[0] - a[0])} {_n(b[1] - a[1])}"
        for k, (a, b) in enumerate(pairwise(corners))
    ]
    return *corners[0], "".join(steps) + ("" if marker == "x" else "z")


def _band(band: _Band, frame: _Frame) -> str:
    there = [(frame.across(float(x)), frame.up(float(y))) for x, y in zip(band.x, band.high, strict=True)]
    back = [(frame.across(float(x)), frame.up(float(y))) for x, y in zip(band.x, band.low, strict=True)]
    outline = [point for point in there + back[::-1] if math.isfinite(point[1])]
    return _path(f"{_joined(outline)}z", f"fill:{band.color};opacity:{band.alpha:g}") if outline else ""


def _bar(row: int, value: float, color: str, frame: _Frame) -> str:
    end = frame.across(value)
    begin = frame.across(0.0)
    begin = frame.left if not math.isfinite(begin) else max(begin, frame.left)
    if not math.isfinite(end):
        return ""
    top, bottom = sorted((frame.up(row - 0.3), frame.up(row + 0.3)))
    return _path(f"M{_n(begin)} {_n(top)}H{_n(end)}V{_n(bottom)}H{_n(begin)}z", f"fill:{color}")


def _straight(which: str, value: float, color: str, frame: _Frame) -> str:
    if which == "y":
        path = f"M{_n(frame.left)} {_n(frame.up(value))}H{_RIGHT:g}"
    else:
        path = f"M{_n(frame.across(value))} {_n(frame.bottom)}V{_TOP:g}"
    return _path(path, f"fill:none;stroke:{color};stroke-dasharray:3.7 1.6")


def _path(path: str, style: str) -> str:
    return f'<path d="{path}" style="{style}"/>'


def _n(value: float) -> str:
    """A coordinate: a hundredth of a pixel is enough, and what is far outside may as well be near."""
    text = f"{min(max(value, -_FAR), _FAR):.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
