"""Force against indentation: under a contact, under an indenter, and where a region is moved by a given amount."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes

from solver_common.arrays import Array

from ..measures.case import CaseResult
from ..measures.pushed import Answer
from ..verdict.digest import Digest
from ..verdict.formatting import quantity, scale_of
from ..verdict.loading import name_of, pushes
from .blocks import Block, Figure, Figures, Section, Text
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

# kind of a constraint -> what its depth and its force are called
_KINDS = {
    "contact": ("indentation", "contact force", _CONTACT_NOTE),
    "indenter": ("depth", "indenter force", _INDENTER_NOTE),
    "constrained": ("prescribed displacement", "reaction force", _MOVED_NOTE),
}


@dataclass(frozen=True)
class Push:
    """One place where a case is pushed: model -> (S,) lengths [m] and (S,) loads [unit]."""

    name: str
    length: str  # what it is called
    load: str
    unit: str
    note: str
    curves: Mapping[str, tuple[Array, Array]]


def force_against_indentation(digest: Digest) -> Section | None:
    """How stiff the body feels where the case that the page looks at first is pushed, if it has a load history."""
    role, case = digest.key_cases[0] if digest.cases else ("", None)
    if case is None or len(case.load_factors) == 1 or not (found := list(_pushes(digest, case))):
        return None
    title = f"{digest.case_name(case)}{f' ({role})' if role else ''}"
    figures = [
        _drawing(digest, case, push, ", ".join(filter(None, [push.name, title])), f"f{k}")
        for k, push in enumerate(found)
    ]
    notes = dict.fromkeys(push.note for push in found)
    if case.study.gravity is not None and any(case.study.gravity.acceleration):
        notes[_WEIGHT_NOTE] = None
    blocks: list[Block] = [Text(" ".join(notes), kind="note"), Figures(figures, digest.legend)]
    return Section("force", "Force against indentation", blocks)


def _pushes(digest: Digest, case: CaseResult) -> Iterator[Push]:
    """Where a case is pushed, with the models whose curve is known."""
    for pushed in pushes(case, digest.surfaces[case.hash]):
        curves = {model: pushed.curve(Answer.of(result)) for model, result in case.models.items()}
        known = {m: curve for m, curve in curves.items() if np.isfinite(curve).all(axis=0).any()}
        length, load, note = _KINDS[pushed.constraint.kind]
        load = "contact pressure" if pushed.unit == "Pa" else load
        if known:
            yield Push(name_of(pushed.constraint), length, load, pushed.unit, note, known)


def _drawing(digest: Digest, case: CaseResult, push: Push, place: str, salt: str) -> Figure:
    models = [model for model in digest.models if model in push.curves]
    (length, length_unit), (force, force_unit) = (
        scale_of(unit, np.concatenate([push.curves[model][k] for model in models]))
        for k, unit in enumerate(("m", push.unit))
    )
    curves = []
    for model in models:
        x, y = np.array(push.curves[model])[:, np.isfinite(push.curves[model]).all(axis=0)]
        curves.append(Curve(model, x / length, y / force, [digest.place[case.hash]] * len(x)))

    def finish(axes: Axes) -> None:
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))

    def told(curve: Curve) -> str:
        x, y = np.asarray(curve.x) * length, np.asarray(curve.y) * force
        last = int(np.argmax(np.abs(x)))
        return f"{quantity(float(y[last]), push.unit)} at {quantity(float(x[last]), 'm')}"

    x_label, y_label = f"{push.length} [{length_unit}]", f"{push.load} [{force_unit}]"
    title = f"{push.load.capitalize()} against {push.length}, {place}"
    return replace(
        lines(digest, curves, x_label, y_label, title, salt, finish=finish, told=told), title=place
    )
