"""What a measurement says of the models, in one sentence or two for the verdict."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..measures.case import CaseResult
from .digest import Digest
from .formatting import listed, plural, short_percent


def measured_in_words(digest: Digest, models: Sequence[str]) -> tuple[str, ...]:
    """How far the reference and some models are from what was measured; nothing where nothing was.

    Parameters
    ----------
    models : those that decide in a family; where there is neither reference nor any of them, all are told
    """
    cases = [case for case in digest.cases if case.measurement is not None]
    if not cases:
        return ()
    names = [name for name in dict.fromkeys((digest.reference or "", *models)) if name]
    names = names or list(digest.models)
    told = [text for name in names if (text := _off(cases, name))]
    if not told:
        return ()
    several = f" in {plural(len(cases), 'case')}" if len(digest.cases) > 1 else ""
    return (
        f"Against measurement{several} {listed(told)}.",
        "All other errors are differences between computations.",
    )


def _off(cases: list[CaseResult], name: str) -> str:
    """`fem is 5.1 % off (root mean square), within the validation uncertainty in 4 of 9 values`."""
    parts: dict[str, list[tuple[float, float]]] = {}  # unit -> (E, D)
    within = count = 0
    for case in cases:
        found = case.measurement
        if found is None or name not in found.simulated:
            continue
        for one, error, inside in zip(found.quantities, found.error(name), found.within(name), strict=True):
            if np.isfinite(error):
                within, count = within + int(inside), count + 1
                if one.value:  # distances of a whole surface have no size of their own
                    parts.setdefault(one.unit, []).append((float(error), one.value))
    if not parts:
        return ""
    shares = {unit: np.linalg.norm(np.array(pairs), axis=0) for unit, pairs in parts.items()}
    several = len(parts) > 1
    told = [
        f"{short_percent(float(error / size))} off{f' in {_WHAT[unit]}' if several else ''}"
        for unit, (error, size) in shares.items()
    ]
    return (
        f"{name} is {listed(told)} (root mean square), within the validation uncertainty in {within} "
        f"of {plural(count, 'value')}"
    )


_WHAT = {"m": "displacement", "N": "force"}
