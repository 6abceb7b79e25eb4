"""Force against indentation: under a pressure contact, and where a region is moved by a given amount."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..body.surface_measures import facet_area_vectors
from ..measures.case import CaseResult
from ..verdict.digest import Array, Digest
from ..verdict.formatting import listed, quantity, scale_of
from .blocks import Figure, Figures, Section, Text
from .plots import Plot, Sheet, colour, line, marker

_CONTACT_NOTE = (
    "Under a contact the force is given and the indentation is the answer: the largest displacement of the nodes "
    "in contact along the undeformed normal, inwards, negative where they are pulled out."
)
_MOVED_NOTE = (
    "Where a region is moved by a given amount the force is the answer: the resultant of its nodes’ reactions, "
    "along the way that it is moved. A stiff model lies above the reference."
)
_WEIGHT_NOTE = "The body's weight acts without load too, so that no curve starts at the origin."


Curves = Mapping[str, tuple[Array, Array]]  # model -> (S,) lengths [m], (S,) loads


@dataclass(frozen=True)
class Push:
    """One place where cases are pushed; `curves` of a case has the models whose curve is known."""

    name: str
    x_label: str
    y_label: str
    unit: str  # of the loads
    note: str
    curves: Callable[[Digest, CaseResult], Curves]


def force_against_indentation(digest: Digest) -> Section | None:
    """How stiff the body feels where it is pushed: key cases, or without a load history all cases together."""
    figures: list[Figure] = []
    notes: dict[str, None] = {}
    sheet = Sheet()
    for cases, title in _groups(digest):
        for push in _pushes(cases):
            figure = _stiffness(digest, push, cases, title, f"f{len(figures)}", sheet)
            if figure is not None:
                figures.append(figure)
                notes[push.note] = None
                if any(_weighs(case) for case in cases):
                    notes[_WEIGHT_NOTE] = None
    if not figures:
        return None
    return Section(
        "force",
        "Force against indentation",
        [Text(" ".join(notes), kind="note"), Figures(figures, digest.legend)],
    )


def _groups(digest: Digest) -> list[tuple[Sequence[CaseResult], str]]:
    """(cases of one figure, what they are called)."""
    if digest.has_steps:
        return [
            ([case], f"{digest.case_name(case)}{f' ({role})' if role else ''}")
            for role, case in digest.key_cases
        ]
    if len(digest.cases) > 1:
        return [(list(digest.cases), "all cases")]
    only = digest.cases[0] if digest.cases else None
    # one load of a given pressure is a point that the table has; the force of a movement stands nowhere else
    return [([only], "the only case")] if only is not None and moved(only) else []


def _pushes(cases: Sequence[CaseResult]) -> list[Push]:
    contacts = [c for c in _constraints(cases[0]) if c.get("kind") == "contact"]
    names = list(moved(cases[0]))
    found: list[Push] = []
    how: tuple[str, str, Callable[[Digest, CaseResult], Curves]] | None
    if any(contact_resultant(case) is not None for case in cases):
        how = ("contact force", "N", _under_contact)
    elif any(contact_pressure(case) is not None for case in cases):
        how = ("contact pressure", "Pa", _under_pressure)
    elif len(cases) == 1 and (contacts or not names):
        how = ("load factor", "1", _under_load)
    else:
        how = None
    if how is not None:
        y_label, unit, curves = how
        place = listed(_name(c) for c in contacts)
        found.append(Push(place, "indentation", y_label, unit, _CONTACT_NOTE, curves))
    for name in names:
        found.append(
            Push(
                name,
                "prescribed displacement",
                "reaction force",
                "N",
                _MOVED_NOTE,
                partial(_of_movement, name=name),
            )
        )
    return found


def _constraints(case: CaseResult) -> Sequence[Mapping[str, object]]:
    return case.resolved.get("constraints", ())


def _weighs(case: CaseResult) -> bool:
    gravity = case.resolved.get("gravity")
    return isinstance(gravity, Mapping) and bool(np.any(gravity.get("acceleration", 0.0)))


def _name(constraint: Mapping[str, object]) -> str:
    return str(constraint.get("name") or constraint.get("region") or "")


def moved(case: CaseResult) -> dict[str, Mapping[str, object]]:
    """Constraints that move their region: name -> constraint."""
    return {
        _name(constraint): constraint
        for constraint in _constraints(case)
        if constraint.get("kind") == "constrained"
        and np.any(_prescribed(constraint))
        and str(constraint.get("region")) in case.regions
    }


def _prescribed(constraint: Mapping[str, object]) -> Array:
    """(3,) displacement at load factor 1 [m], zero where none is given."""
    given = constraint.get("displacement")
    if not isinstance(given, Sequence) or len(given) != 3:
        return np.zeros(3)
    return np.array(given, dtype=np.float64)


def supports(case: CaseResult) -> NDArray[np.bool_]:
    """(N,) nodes that a support holds or moves."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in _constraints(case):
        if (
            constraint.get("kind") in ("fixed", "constrained")
            and str(constraint.get("region")) in case.regions
        ):
            mask |= case.regions[str(constraint.get("region"))]
    return mask


def contact_resultant(case: CaseResult) -> float | None:
    """Force of a case's only contact at load factor 1 [N]; None where the stored inputs do not tell.

    Given as `force`, or the integral of a uniform pressure over the facets whose three nodes are in its region.
    """
    contacts = [c for c in _constraints(case) if c.get("kind") == "contact"]
    if len(contacts) != 1:
        return None
    contact = contacts[0]
    if isinstance(force := contact.get("force"), int | float):
        return float(force)
    mask = case.regions.get(str(contact.get("region")))
    pressure = contact.get("pressure")
    if (
        mask is None
        or not isinstance(pressure, int | float)
        or contact.get("profile", "uniform") != "uniform"
    ):
        return None
    first, second, third = mask[case.triangles].T
    vectors = facet_area_vectors(case.points, case.triangles[first & second & third])
    return float(pressure * np.linalg.norm(vectors.sum(axis=0)))


def contact_pressure(case: CaseResult) -> float | None:
    """Pressure of a case's only contact at load factor 1 [Pa], whatever its profile; None where none is given."""
    contacts = [c for c in _constraints(case) if c.get("kind") == "contact"]
    pressure = contacts[0].get("pressure") if len(contacts) == 1 else None
    return float(pressure) if isinstance(pressure, int | float) else None


def indentation(case: CaseResult, models: Iterable[str], normals: Array) -> dict[str, Array]:
    """Model -> (S,) displacement along the normal, inwards, of the node in contact that it moves farthest [m].

    Negative where the contact pulls. Of all nodes where no contact is stored.

    Parameters
    ----------
    normals : (N, 3) outward unit normals of the undeformed surface
    """
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in _constraints(case):
        if constraint.get("kind") == "contact" and str(constraint.get("region")) in case.regions:
            mask |= case.regions[str(constraint.get("region"))]
    nodes = np.flatnonzero(mask if mask.any() else ~mask)
    steps, along = np.arange(len(case.load_factors)), normals[nodes]
    found = {}
    for model in models:
        inward = -np.einsum("sij,ij->si", case.models[model].displacement[:, nodes], along)
        found[model] = inward[steps, np.abs(inward).argmax(axis=1)]
    return found


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
    mask = case.regions[str(constraint.get("region"))]
    resultant = case.models[model].reaction_force[:, mask].sum(axis=1)
    return case.load_factors * length, resultant @ (prescribed / length)


def _under_contact(digest: Digest, case: CaseResult) -> Curves:
    return _pushed_in(digest, case, contact_resultant(case))


def _under_pressure(digest: Digest, case: CaseResult) -> Curves:
    return _pushed_in(digest, case, contact_pressure(case))


def _under_load(digest: Digest, case: CaseResult) -> Curves:
    return _pushed_in(digest, case, 1.0)


def _pushed_in(digest: Digest, case: CaseResult, load: float | None) -> Curves:
    """Indentation under a load that is known at load factor 1."""
    if load is None:
        return {}
    depths = indentation(case, case.models, digest.surfaces[case.hash].normals)
    return {model: (depth, case.load_factors * load) for model, depth in depths.items()}


def _of_movement(_: Digest, case: CaseResult, name: str) -> Curves:
    if name not in moved(case):
        return {}
    return {model: movement_force(case, model, name) for model in case.models}


def _stiffness(
    digest: Digest, push: Push, cases: Sequence[CaseResult], title: str, salt: str, sheet: Sheet
) -> Figure | None:
    history = len(cases) == 1 and len(cases[0].load_factors) > 1
    curves: dict[str, tuple[Array, Array]] = {}
    of_cases = [push.curves(digest, case) for case in cases]
    for model in digest.models:
        xs, ys = [], []
        for case, known in zip(cases, of_cases, strict=True):
            steps = slice(None) if history else slice(case.full_load, case.full_load + 1)
            if model in known:
                xs.append(known[model][0][steps])
                ys.append(known[model][1][steps])
        if not xs:
            continue
        x, y = np.concatenate(xs), np.concatenate(ys)
        keep = np.isfinite(x) & np.isfinite(y)
        if keep.any():
            curves[model] = (x[keep], y[keep])
    if not curves:
        return None
    length, length_unit = scale_of("m", np.concatenate([x for x, _ in curves.values()]))
    force, force_unit = scale_of(push.unit, np.concatenate([y for _, y in curves.values()]))
    y_label = f"{push.y_label} [{force_unit}]" if force_unit else push.y_label
    plot = Plot(f"{push.x_label} [{length_unit}]", y_label, salt, sheet)
    with plot as axes:
        for model, (x, y) in curves.items():
            k = digest.colour(model)
            style = line(k) if history else "none"
            axes.plot(x / length, y / force, linestyle=style, marker=marker(k), color=colour(k))
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    place = f"{push.name}, {title}" if push.name else title
    farthest = {model: int(np.argmax(np.abs(x))) for model, (x, _) in curves.items()}
    told = listed(
        f"{model} {quantity(float(y[farthest[model]]), push.unit)} at {quantity(float(x[farthest[model]]), 'm')}"
        for model, (x, y) in curves.items()
    )
    what = f"{push.y_label[:1].upper()}{push.y_label[1:]}"
    return Figure(plot.drawn(f"{what} against {push.x_label}, {place}: {told}."), place)
