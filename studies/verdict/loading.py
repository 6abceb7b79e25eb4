"""What pushes a body, how hard, how far it gives way, and up to which load a model is within its limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.pushed import along_movement, inward, resultant
from ..study.loads import Constraint
from .acceptance import BEYOND, OPEN, WITHIN, States

_SAME = 1e-9  # of a load: the difference of two that are one


def weighs(case: CaseResult) -> bool:
    return case.study.gravity is not None and bool(np.any(case.study.gravity.acceleration))


def name_of(constraint: Constraint) -> str:
    return constraint.name or constraint.region


def kind_of(constraint: Constraint) -> str:
    """Its kind; what is moved by nothing is held."""
    held = constraint.kind == "constrained" and not np.any(_prescribed(constraint))
    return "fixed" if held else constraint.kind


def moved(case: CaseResult) -> dict[str, Constraint]:
    """Constraints that move their region: name -> constraint."""
    return {name_of(c): c for c in case.study.constraints if kind_of(c) == "constrained"}


def _prescribed(constraint: Constraint) -> Array:
    """(3,) displacement at load factor 1 [m], zero where none is given."""
    return np.array(constraint.displacement or (0.0, 0.0, 0.0), dtype=np.float64)


def supports(case: CaseResult) -> NDArray[np.bool_]:
    """(N,) nodes that a support holds or moves."""
    return _nodes_of(case, "fixed", "constrained")


def _nodes_of(case: CaseResult, *kinds: str) -> NDArray[np.bool_]:
    """(N,) nodes of the regions of all constraints of these kinds."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in case.study.constraints:
        if constraint.kind in kinds:
            mask |= case.regions[constraint.region]
    return mask


def _contacts(case: CaseResult) -> list[Constraint]:
    return [c for c in case.study.constraints if c.kind == "contact"]


def contact_resultant(case: CaseResult) -> float | None:
    """Force of a case's only contact at load factor 1 [N]; None where the stored inputs do not tell.

    Given as `force`, or the integral of a uniform pressure over the facets whose three nodes are in its region.
    """
    if len(contacts := _contacts(case)) != 1:
        return None
    (contact,) = contacts
    if contact.force is not None:
        return float(contact.force)
    if contact.pressure is None or contact.profile != "uniform":
        return None
    return resultant(contact.pressure, case.regions[contact.region], case.points, case.triangles)


def contact_pressure(case: CaseResult) -> float | None:
    """Pressure of a case's only contact at load factor 1 [Pa], whatever its profile; None where none is given."""
    contacts = _contacts(case)
    return contacts[0].pressure if len(contacts) == 1 else None


def indentation(case: CaseResult, models: Iterable[str], normals: Array) -> dict[str, Array]:
    """Model -> (S,) displacement along the normal, inwards, of the node in contact that it moves farthest [m].

    Negative where the contact pulls. Of all nodes where no contact is stored.

    Parameters
    ----------
    normals : (N, 3) outward unit normals of the undeformed surface
    """
    mask = _nodes_of(case, "contact", "indenter")
    nodes = np.flatnonzero(mask if mask.any() else ~mask)
    return {model: inward(case.models[model].displacement, nodes, normals) for model in models}


def movement_force(case: CaseResult, model: str, name: str) -> tuple[Array, Array]:
    """(S,) prescribed displacement [m] of a region and (S,) force along it [N] that holds the region there.

    The force is the sum of the reactions of the region's nodes, projected on the direction of the displacement.

    Raises
    ------
    KeyError
        no constraint of this name moves its region.
    """
    constraint = moved(case)[name]
    prescribed = _prescribed(constraint)
    length = float(np.linalg.norm(prescribed))
    mask = case.regions[constraint.region]
    force = along_movement(prescribed, case.models[model].reaction_force, mask)
    return case.load_factors * length, force


def load_unit(case: CaseResult) -> str:
    """Unit of a case's load: of its only contact, or of what moves its only moved region; "" of none."""
    if contact_resultant(case) is not None or _carried(case) is not None:
        return "N"
    if contact_pressure(case) is not None:
        return "Pa"
    return "N" if len(moved(case)) == 1 and not _contacts(case) and case.reference in case.models else ""


def loads_of(case: CaseResult, unit: str) -> Array:
    """(S,) the load of each step in `load_unit`; its share of the largest for "1"."""
    if unit == "1":
        return case.load_factors / max(np.abs(case.load_factors).max(), np.finfo(float).tiny)
    if (resultant := contact_resultant(case)) is not None:
        return case.load_factors * resultant
    if (pressure := contact_pressure(case)) is not None:
        carried = _carried(case)
        return case.load_factors * pressure if unit == "Pa" or carried is None else carried
    (name,) = moved(case)
    return movement_force(case, str(case.reference), name)[1]


def _carried(case: CaseResult) -> Array | None:
    """(S,) what the supports of the reference carry of a pressure on the only contact [N]; None where more acts."""
    result = case.models.get(str(case.reference))
    held = supports(case)
    if contact_pressure(case) is None or weighs(case) or moved(case) or result is None or not held.any():
        return None
    forces = np.linalg.norm(result.reaction_force[:, held].sum(axis=1), axis=1)
    return forces if np.isfinite(forces).all() and forces.max() > 0.0 else None


def depths_of(case: CaseResult, normals: Array) -> Array:
    """(S,) how far the reference is pushed in, pulled out (negative) or moved [m]; NaN where it is not."""
    if case.reference is None or case.reference not in case.models:
        return np.full(len(case.load_factors), math.nan)
    if _contacts(case):
        return indentation(case, [case.reference], normals)[case.reference]
    lengths = [movement_force(case, case.reference, name)[0] for name in moved(case)]
    return np.max(lengths, axis=0) if lengths else np.full(len(case.load_factors), math.nan)


# --- up to which load ---


@dataclass(frozen=True)
class UpTo:
    """The largest load up to which every case and every step that was tried is within the limits.

    Attributes
    ----------
    load, unit : that load, NaN where there is none; its unit, "1" where it is told as a share of the full load
    depth : how far the reference gives way there, in every case at least [m]; NaN where not known or none
    least, most : the smallest and the largest load tried
    open : whether the next load is undecided, not beyond
    """

    load: float
    unit: str
    depth: float
    least: float
    most: float
    open: bool

    @property
    def none(self) -> bool:
        """Whether there is no such load."""
        return math.isnan(self.load)

    @property
    def all(self) -> bool:
        """Whether it is the largest tried."""
        return not self.none and self.load >= self.most


@dataclass(frozen=True)
class KnownLoads:
    """The K steps of all cases that carry a load: unit, (K,) loads, (K,) depths [m], (K,) cases and steps."""

    unit: str
    loads: Array
    depths: Array
    cases: NDArray[np.int64]
    steps: NDArray[np.int64]


def known_loads(cases: Sequence[CaseResult], normals: Mapping[str, Array]) -> KnownLoads:
    """Of a share of the full load, "1", where cases do not tell it in the same unit.

    Parameters
    ----------
    normals : hash of each case -> (N, 3) outward unit normals of its undeformed surface
    """
    units = {load_unit(case) for case in cases}
    unit = units.pop() or "1" if len(units) == 1 else "1"
    rows = []
    for k, case in enumerate(cases):
        loads, depths = np.abs(loads_of(case, unit)), depths_of(case, normals[case.hash])
        loaded = (case.load_factors != 0.0) & np.isfinite(loads) & (loads > 0.0)
        rows += [(loads[step], depths[step], k, step) for step in np.flatnonzero(loaded)]
    loads, depths, numbers, steps = np.array(rows or np.zeros((0, 4))).T
    return KnownLoads(unit, loads, depths, numbers.astype(int), steps.astype(int))


def up_to(known: KnownLoads, states: States) -> UpTo | None:
    """Of all steps that carry a load, from the (C, S) states of a model; None where no step carries any."""
    if not len(known.loads):
        return None
    order = np.argsort(known.loads, kind="stable")
    loads, depths = known.loads[order], known.depths[order]
    states = states[known.cases[order], known.steps[order]]
    # points of one load are one group, of which the worst decides
    starts = np.flatnonzero(np.concatenate([[True], np.diff(loads) > _SAME * loads[1:]]))
    worst = np.maximum.reduceat(states, starts)
    within = int(np.argmin(np.append(worst, BEYOND) == WITHIN))  # groups before the first that is not
    last = slice(starts[within - 1], starts[within] if within < len(starts) else None)
    reached = np.abs(depths[last]) if within else np.zeros(0)
    return UpTo(
        load=float(loads[starts[within - 1]]) if within else math.nan,
        unit=known.unit,
        depth=min((depth for depth in reached.tolist() if math.isfinite(depth)), default=math.nan),
        least=float(loads[0]),
        most=float(loads[starts[-1]]),
        open=within < len(starts) and int(worst[within]) == OPEN,
    )
