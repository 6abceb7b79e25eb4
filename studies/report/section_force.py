"""Force against indentation: under a pressure contact, and where a region is moved by a given amount."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..study.schema import Constraint
from ..verdict.digest import Digest
from ..verdict.formatting import listed, quantity, scale_of
from ..verdict.loading import (
    contact_pressure,
    contact_resultant,
    indentation,
    moved,
    movement_force,
    name_of,
    weighs,
)
from .blocks import Block, Cell, Field, Figure, Figures, Section, Table, Text, frame_table
from .plots import Curve, lines

_CONTACT_NOTE = (
    "The force of a contact is given; the indentation is the answer. It is the largest displacement of a node in "
    "contact, inwards along the normal of the body at rest. It is negative where the nodes are pulled out."
)
_MOVED_NOTE = (
    "A region is moved by a given amount; the force is the answer. It is the sum of the reactions of its nodes, "
    "along the movement. A model that is too stiff lies above the reference."
)
_INDENTER_NOTE = (
    "A rigid indenter is pushed in by a given depth; its force along the push is the answer. A "
    "model that is too stiff lies above the reference."
)
_WEIGHT_NOTE = "The body's weight acts without load too: no curve starts at the origin."


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
    tables: list[Table] = []
    notes: dict[str, None] = {}
    for cases, title in _groups(digest):
        for push in _pushes(cases):
            curves = _curves(digest, push, cases)
            if not curves:
                continue
            place = f"{push.name}, {title}" if push.name else title
            if _is_one_load(curves):
                tables.append(_table(digest, push, curves, place, f"force-{len(tables)}"))
            else:
                figures.append(_drawing(digest, push, curves, place, f"f{len(figures)}"))
            notes[push.note] = None
            if any(weighs(case) for case in cases):
                notes[_WEIGHT_NOTE] = None
    if not notes:
        return None
    drawn = [Figures(figures, digest.legend)] if figures else []
    blocks: list[Block] = [Text(" ".join(notes), kind="note"), *drawn, *tables]
    return Section("force", "Force against indentation", blocks)


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
    return [([only], "the only case")] if only is not None and (moved(only) or _indenters(only)) else []


def _pushes(cases: Sequence[CaseResult]) -> list[Push]:
    contacts = [c for c in cases[0].study.constraints if c.kind == "contact"]
    names, indenters = list(moved(cases[0])), _indenters(cases[0])
    # what pulls has no inwards; on an edge the normals of its nodes are no direction of it
    pulls = any(c.kind in ("line", "traction") for c in cases[0].study.constraints)
    found: list[Push] = []
    how: tuple[str, str, Callable[[CaseResult], float | None]] | None = None
    if any(contact_resultant(case) is not None for case in cases):
        how = ("contact force", "N", contact_resultant)
    elif any(contact_pressure(case) is not None for case in cases):
        how = ("contact pressure", "Pa", contact_pressure)
    elif len(cases) == 1 and (contacts or not (names or indenters or pulls)):
        how = ("load factor", "1", lambda _: 1.0)
    if how is not None:
        y_label, unit, load_of = how
        place, curves = listed(name_of(c) for c in contacts), partial(_pushed_in, load_of=load_of)
        found.append(Push(place, "indentation", y_label, unit, _CONTACT_NOTE, curves))
    for indenter in indenters:
        place = name_of(indenter)
        found.append(Push(place, "depth", "indenter force", "N", _INDENTER_NOTE, _of_indenter))
    for name in names:
        curves = partial(_of_movement, name=name)
        found.append(Push(name, "prescribed displacement", "reaction force", "N", _MOVED_NOTE, curves))
    return found


def _pushed_in(digest: Digest, case: CaseResult, load_of: Callable[[CaseResult], float | None]) -> Curves:
    """Indentation under a load that is known at load factor 1."""
    load = load_of(case)
    if load is None:
        return {}
    depths = indentation(case, case.models, digest.surfaces[case.hash].normals)
    return {model: (depth, case.load_factors * load) for model, depth in depths.items()}


def _of_movement(_: Digest, case: CaseResult, name: str) -> Curves:
    if name not in moved(case):
        return {}
    return {model: movement_force(case, model, name) for model in case.models}


def _of_indenter(_: Digest, case: CaseResult) -> Curves:
    depths = [float(entry.depth) for entry in _indenters(case)]  # a study has one
    return {
        name: (case.load_factors * depths[0], result.scalars["indenter_force"])
        for name, result in case.models.items()
        if depths and "indenter_force" in result.scalars
    }


def _indenters(case: CaseResult) -> list[Constraint]:
    return [entry for entry in case.study.constraints if entry.kind == "indenter"]


@dataclass(frozen=True)
class _Curve:
    """The answers of one model: K lengths [m] and loads, the case of each, and whether they are one history."""

    lengths: Array
    loads: Array
    cases: Sequence[int]
    joined: bool


def _curves(digest: Digest, push: Push, cases: Sequence[CaseResult]) -> dict[str, _Curve]:
    """Model -> its curve, of those that have one: a case's history, or the full load of each of several cases."""
    history = len(cases) == 1 and len(cases[0].load_factors) > 1
    numbers = [digest.place[case.hash] for case in cases]
    of_cases = [push.curves(digest, case) for case in cases]
    found = {}
    for model in digest.models:
        points = []
        for number, case, known in zip(numbers, cases, of_cases, strict=True):
            for step in range(len(case.load_factors)) if history else (case.full_load,):
                if model in known and np.isfinite([part[step] for part in known[model]]).all():
                    points.append((float(known[model][0][step]), float(known[model][1][step]), number))
        if points:
            lengths, loads, of = zip(*points, strict=True)
            found[model] = _Curve(np.array(lengths), np.array(loads), of, history)
    return found


def _is_one_load(curves: Mapping[str, _Curve]) -> bool:
    """Whether all loads are one, or all movements: numbers in a row, which a chart shows as an empty frame."""
    for values in ([c.lengths for c in curves.values()], [c.loads for c in curves.values()]):
        gathered = np.concatenate(values)
        if np.ptp(gathered) <= 1e-9 * np.abs(gathered).max():
            return True
    return False


def _table(digest: Digest, push: Push, curves: Mapping[str, _Curve], place: str, name: str) -> Table:
    fields = [
        Field("Model", lambda model: model),
        Field(_capital(push.x_label), lambda model: _range(curves[model].lengths, "m"), "m"),
        Field(_capital(push.y_label), lambda model: _range(curves[model].loads, push.unit), push.unit),
    ]
    return frame_table(list(curves), fields, name, caption=place, mark=digest.mark)


def _range(values: Array, unit: str) -> Cell:
    """One value, or the least and the largest."""
    ends = dict.fromkeys(quantity(float(end), unit) for end in (values.min(), values.max()))
    return Cell(" to ".join(ends), value=float(values[0]) if len(ends) == 1 else None)


def _capital(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}"


def _drawing(digest: Digest, push: Push, curves: Mapping[str, _Curve], place: str, salt: str) -> Figure:
    length, length_unit = scale_of("m", np.concatenate([curve.lengths for curve in curves.values()]))
    force, force_unit = scale_of(push.unit, np.concatenate([curve.loads for curve in curves.values()]))
    found = [
        Curve(
            model,
            curve.lengths / length,
            curve.loads / force,
            curve.cases,
            {"named": curve.joined} | ({} if curve.joined else {"linestyle": "none"}),
        )
        for model, curve in curves.items()
    ]

    def finish(axes: Axes) -> None:
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))

    def told(curve: Curve) -> str:
        own = curves[curve.model]
        last = int(np.argmax(np.abs(own.lengths)))
        return f"{quantity(float(own.loads[last]), push.unit)} at {quantity(float(own.lengths[last]), 'm')}"

    x_label, y_label = f"{push.x_label} [{length_unit}]", f"{push.y_label} [{force_unit}]".replace(" []", "")
    title = f"{_capital(push.y_label)} against {push.x_label}, {place}"
    return replace(lines(digest, found, x_label, y_label, title, salt, finish=finish, told=told), title=place)
