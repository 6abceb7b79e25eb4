"""What is not known of the inputs: what each makes of the answers, beside the errors of the models."""

from __future__ import annotations

import math
from typing import Any

from ..measures.case import CaseResult
from ..measures.input_spread import STRAIGHT, InputSpread
from ..measures.metrics import VECTOR
from ..verdict.digest import Digest
from ..verdict.formatting import input_name, listed, percent, plural, swept_value
from .blocks import Block, Cell, Field, Section, Table, Text, frame_table

_READING = (
    "Each share is a standard deviation over the displacement, area-weighted, at full load. {how} {variations} of "
    "each case were computed. The error of a model is its displacement error against the reference. An error below "
    "what is not known of the inputs cannot be told from another tissue."
)
_HOW = {
    "sensitivities": "It is from the answers with one input at a time higher and lower, so of first order.",
    "sampling": "It is the spread of the answers to random values of all inputs.",
}


def inputs(digest: Digest) -> Section | None:
    """The first case that tells how well its inputs are known, a key case if there is one; None where none does."""
    cases = [*(case for _, case in digest.key_cases), *digest.cases]
    case = next((case for case in cases if case.inputs is not None), None)
    if case is None or (first := case.inputs) is None:
        return None
    caption = digest.case_name(case) if len(digest.cases) > 1 else ""
    blocks: list[Block] = [_table(digest, case, first, "inputs", caption)]
    notes = [_READING.format(how=_HOW[first.method], variations=plural(first.variations, "variation"))]
    if any(model.bend > STRAIGHT for model in first.models.values()):
        notes.append(
            'An answer bends with an input, so this is rough: inputs.method = "sampling" does better.'
        )
    if still := _moves_nothing(first):
        notes.append(
            f"A region takes whole nodes, and {listed(still)} moves none of this mesh: "
            "a smaller mesh_size resolves it."
        )
    return Section(
        "inputs", "What is not known of the inputs", [*blocks, *(Text(note, kind="note") for note in notes)]
    )


def _moves_nothing(spread: InputSpread) -> list[str]:
    """The places of regions that change no answer at all."""
    return [
        key
        for k, key in enumerate(spread.keys)
        if key.startswith("regions.") and all(found.parts[k] == 0.0 for found in spread.models.values())
    ]


def _table(digest: Digest, case: CaseResult, spread: InputSpread, name: str, caption: str) -> Table:
    def part(k: int) -> Any:
        return lambda model: float(spread.models[model].parts[k])

    def error(model: str) -> Cell:
        value = digest.at(case, model, VECTOR)
        lost = math.isfinite(value) and value < spread.models[model].displacement
        return Cell(percent(value), "below what is not known" if lost else "", value)

    fields = [Field("Model", lambda model: model)]
    for k, (key, unit) in enumerate(zip(spread.keys, spread.units, strict=True)):
        value, deviation = float(spread.values[k]), float(f"{spread.deviations[k]:.3g}")
        known = f"{swept_value(value, unit)} ± {swept_value(deviation, unit)}"
        fields.append(Field(input_name(key), part(k), "1", known))
    fields += [
        Field("All inputs", lambda model: spread.models[model].displacement, "1", "of the displacement"),
        Field("All inputs", lambda model: spread.models[model].deformation, "1", "of the change of shape"),
        Field("Its error", error, "1", "against the reference"),
    ]
    return frame_table(list(spread.models), fields, name, caption=caption, mark=digest.mark)
