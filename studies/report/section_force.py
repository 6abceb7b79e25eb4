"""Force against indentation: under a pressure contact, and where a region is moved by a given amount."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..measures.case import CaseResult
from ..verdict.digest import Array, Digest
from ..verdict.formatting import listed, quantity, scale_of
from ..verdict.loading import (
    constraints,
    contact_pressure,
    contact_resultant,
    indentation,
    moved,
    movement_force,
    name_of,
    weighs,
)
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
                if any(weighs(case) for case in cases):
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
    contacts = [c for c in constraints(cases[0]) if c.get("kind") == "contact"]
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
        place = listed(name_of(c) for c in contacts)
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
