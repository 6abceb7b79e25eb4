"""Up to which load a model is good enough: from the limits, the load history or the swept loads, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..measures.case import CaseResult
from ..study.model_name import FINITE_STRAIN, split
from ..verdict.acceptance import WITHIN, Acceptance
from ..verdict.digest import Digest
from ..verdict.formatting import listed, parameter_name, plain, quantity, short_percent, swept_value
from ..verdict.growth import limits_in_words
from ..verdict.loading import (
    contact_pressure,
    contact_resultant,
    indentation,
    moved,
    movement_force,
    supports,
)
from ..verdict.standing import at_full_load

_LOADS = ("force", "pressure", "displacement")  # parts of swept keys that are a load
# shares of the body's smallest extent and of its volume: beyond them a small-strain reference judges nothing
MOST_MOVED, MOST_DRIFT = 0.10, 0.05


def loads_in_words(digest: Digest, model: str, outside: str) -> list[str]:
    """Sentences on the load up to which `model` is within the tolerance, and on how large the loads are.

    Parameters
    ----------
    outside : what `beyond_small_strain` says of the run
    """
    sentences = limits_in_words(digest)
    loads = [key for key in digest.swept_keys if _is_load(key)]
    several = bool(sentences or digest.has_steps or loads)
    if not sentences and not outside:
        sentences = (
            [_over_history(digest, model)]
            if digest.has_steps
            else [_over_sweep(digest, model, key) for key in loads]
        )
    tried = _full_load_in_words(digest)
    if not several and tried:
        sentences = [f"One load was tried{' in each case' if len(digest.cases) > 1 else ''}: {tried}."]
    elif tried:
        sentences.append(f"Full load is {tried}.")
    if _is_small_strain(digest):
        sentences.append(
            f"{digest.reference} is a small-strain reference, so the errors of linear models do not grow with the "
            'load by construction: where small strain ends is only told by reference = "fem".'
        )
    return sentences


def _is_small_strain(digest: Digest) -> bool:
    return digest.reference is not None and split(digest.reference)[0] not in FINITE_STRAIN


def beyond_small_strain(digest: Digest) -> str:
    """Why the reference is outside its own theory at full load, and what to do; "" where it is not."""
    if not _is_small_strain(digest):
        return ""
    moved_by = drift = 0.0
    for case in digest.cases:
        if (result := case.models.get(str(case.reference))) is None:
            continue
        displacement = result.displacement[case.full_load]
        held = displacement[supports(case)]
        if held.any() and np.allclose(held, held[0], rtol=1e-9, atol=0.0):
            displacement = displacement - held[0]  # carried along with its supports it does not deform
        largest = math.sqrt(np.einsum("ij,ij->i", displacement, displacement).max())
        moved_by = max(moved_by, largest / digest.surfaces[case.hash].smallest_extent)
        drift = max(drift, abs(at_full_load(case, str(case.reference), "volume_drift")))
    parts = []
    if moved_by > MOST_MOVED:
        parts.append(f"moves the body by {short_percent(moved_by)} of its smallest extent")
    if drift > MOST_DRIFT:
        whose = "its" if parts else "the body's"
        parts.append(f"changes {whose} volume by {short_percent(drift)}")
    if not parts:
        return ""
    where = " in some case" if len(digest.cases) > 1 else ""
    return (
        f"the load {listed(parts)}{where}, more than {digest.reference}, which holds for small strain, can judge; "
        'lower it or take reference = "fem".'
    )


def _is_load(key: str) -> bool:
    return any(part in _LOADS for part in key.split("."))


def _over_history(digest: Digest, model: str) -> str:
    """Up to which step of their histories the cases are within the tolerance."""
    reached = [_reached(case, model, digest.limits.of_load) for case in digest.cases]
    whole = sum(step == case.full_load for step, case in zip(reached, digest.cases, strict=True))
    none = sum(step is None for step in reached)
    limit = digest.limits.of_load.in_words
    if len(reached) == 1:
        case, (step,) = digest.cases[0], reached
        if step is None:
            return f"At no load of the history is {model} surely within {limit}."
        load = f"load factor {plain(float(case.load_factors[step]))}{_at(digest, case, step)}"
        return (
            f"{model} stays within {limit} over the whole history, up to {load}; more was not tried."
            if whole
            else f"{model} stays within {limit} up to {load}; beyond that not surely."
        )
    parts = [f"over the whole load history in {whole} of {len(reached)} cases"]
    parts += [f"over a part of it in {len(reached) - whole - none}"] if len(reached) - whole - none else []
    parts += [f"at no load in {none}"] if none else []
    return f"{model} stays surely within {limit} {listed(parts)}."


def _reached(case: CaseResult, model: str, limits: Acceptance) -> int | None:
    """The step of the largest load up to which every step is within the tolerance, None where none is."""
    found = None
    for step in np.argsort(np.abs(case.load_factors), kind="stable"):
        if case.load_factors[step] == 0.0:
            continue
        if limits.state(case, model, int(step)) != WITHIN:
            return found
        found = int(step)
    return found


def _at(digest: Digest, case: CaseResult, step: int) -> str:
    """The force and the indentation of a step, where known, in brackets."""
    parts = []
    load, unit = _load(case, step)
    if unit:
        parts.append(quantity(load, unit))
    if math.isfinite(depth := _depth(digest, case, step)):
        parts.append(f"{quantity(depth, 'm')} of indentation")
    return f" ({', '.join(parts)})" if parts else ""


def _load(case: CaseResult, step: int) -> tuple[float, str]:
    """Force, else pressure, of the only contact at a step, and its unit; "" where neither is known."""
    factor = float(case.load_factors[step])
    if (resultant := contact_resultant(case)) is not None:
        return factor * resultant, "N"
    pressure = contact_pressure(case)
    return (math.nan, "") if pressure is None else (factor * pressure, "Pa")


def _depth(digest: Digest, case: CaseResult, step: int) -> float:
    """How far the reference is pushed in (pulled out: negative) or moved at a step [m]; NaN where it is not."""
    if case.reference is None or case.reference not in case.models:
        return math.nan
    if any(c.get("kind") == "contact" for c in case.resolved.get("constraints", ())):
        depths = indentation(case, [case.reference], digest.surfaces[case.hash].normals)
        return float(depths[case.reference][step])
    lengths = [float(movement_force(case, case.reference, name)[0][step]) for name in moved(case)]
    return max(lengths, default=math.nan)


def _over_sweep(digest: Digest, model: str, key: str) -> str:
    """Up to which value of a swept load every case is within the tolerance."""
    cases = [case for case in digest.cases if isinstance(case.swept.get(key), int | float)]
    at: dict[float, list[CaseResult]] = {}
    for case in cases:
        at.setdefault(float(case.swept[key]), []).append(case)
    values = sorted(at, key=abs)
    if not values:
        return ""
    unit = next((case.swept_units.get(key, "1") for case in cases), "1")
    held: float | None = None
    for value in values:
        if any(digest.limits.of_load.state(case, model, case.full_load) != WITHIN for case in at[value]):
            break
        held = value
    limit, name = digest.limits.of_load.in_words, parameter_name(key)
    tried = f"{swept_value(values[0], unit)} to {swept_value(values[-1], unit)}"
    if held is None:
        some = any(digest.limits.of_load.state(case, model, case.full_load) == WITHIN for case in cases)
        text = f"No {name} tried ({tried}) surely keeps every case within {limit}"
        return f"{text}: what else varies decides." if some and len(digest.swept_keys) > 1 else f"{text}."
    if held == values[-1]:
        return f"Every case stays surely within {limit} up to the largest {name} tried, {swept_value(held, unit)}."
    return f"Every case stays surely within {limit} up to a {name} of {swept_value(held, unit)} (tried: {tried})."


def _full_load_in_words(digest: Digest) -> str:
    """Force and indentation at full load, over the cases."""
    loads: dict[str, list[float]] = {}
    for case in digest.cases:
        load, unit = _load(case, case.full_load)
        loads.setdefault(unit, []).append(load)
    depths, shares = [], []
    for case in digest.cases:
        if math.isfinite(depth := _depth(digest, case, case.full_load)):
            depths.append(depth)
            shares.append(depth / digest.surfaces[case.hash].smallest_extent)
    parts = [value_range(loads[unit], unit) for unit in sorted(loads) if unit]
    if depths:
        deepest = int(np.argmax(np.abs(depths)))
        share = short_percent(abs(shares[deepest]))
        up_to = "up to " if len(depths) > 1 else ""
        parts.append(
            f"{up_to}{quantity(depths[deepest], 'm')} of indentation in the reference, {share} of the body's "
            "smallest extent"
        )
    return ", ".join(parts)


def value_range(values: Sequence[float], unit: str, digits: int = 3) -> str:
    """`low to high` of some SI values, one value where they look alike."""
    low, high = (quantity(f(values), unit, digits) for f in (min, max))
    return low if low == high else f"{low} to {high}"
