"""The place of each model in the palette, which its name decides, so that it is the same in every report.

A place is a number. It gives colour, marker and line style; see `vdmbench.report.plots`.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable

COLOURS = 7  # and as many markers; later places pair them differently, with broken lines
_KNOWN = (
    "vdm-paper",
    "vdm-consistent",
    "vdm-vector",
    "bem",
    "fem-linear",
    "bem-sparse",
    "fem-condensed",
    "fem-p2",
    "fem-p1",
    "fem",
)
_PLACES = COLOURS**2


def places(names: Iterable[str]) -> dict[str, int]:
    """Name -> place. A known model has a fixed place, any other the first free place from its hash on."""
    wanted = sorted(set(names))
    found = {name: _KNOWN.index(name) for name in wanted if name in _KNOWN}
    free = list(range(len(_KNOWN), max(_PLACES, len(_KNOWN) + len(wanted))))
    for name in wanted:
        if name not in found:
            start = len(_KNOWN) + zlib.crc32(name.encode("utf-8", "replace")) % (_PLACES - len(_KNOWN))
            found[name] = min(free, key=lambda place: (place < start, place))
            free.remove(found[name])
    return found
