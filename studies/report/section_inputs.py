"""What is not known of the inputs: what each makes of the answers, beside the errors of the models."""

from __future__ import annotations

import math
from typing import Any

from ..measures.case import CaseResult
from ..measures.input_spread import INDICES, STRAIGHT, InputSpread
from ..measures.metrics import VECTOR
from ..verdict.digest import Digest
from ..verdict.formatting import listed, percent, plural, swept_value
from ..verdict.inputs_known import input_name, inputs_known
from ..verdict.words import said
from .blocks import Block, Cell, Field, Section, Table, Text, frame_table

_READING = (
    "Each share is a standard deviation over the displacement, area-weighted, at full load. {how} {variations} of "
    "each case were computed. The error of a model is its displacement error against the reference. An error below "
    "what is not known of the inputs cannot be told from another tissue."
)
_HOW = {
    "sensitivities": "It is from the answers with one input at a time higher and lower, so of first order.",
    "sampling": "It is the spread of the answers to random values of all inputs.",
    "sobol": "It is the spread of the answers to Saltelli's samples; the indices are of the displacement's norm.",
}


def inputs(digest: Digest) -> Section | None:
    """Every case that tells how well its inputs are known; None where none does."""
    cases = [(case, case.inputs) for case in digest.cases if case.inputs is not None]
    if not cases:
        return None
    found = inputs_known(digest, str(digest.focus) if digest.focus in digest.compared else "")
    blocks: list[Block] = [
        Text(sentence) for sentence in [" ".join(said("inputs", found, STRAIGHT))] if sentence
    ]
    roles = [case.hash for _, case in digest.key_cases]
    shown = [(case, spread) for case, spread in cases if case.hash in roles] or cases[:1]
    for k, (case, spread) in enumerate(shown):
        name = digest.case_name(case) if len(digest.cases) > 1 else ""
        blocks.append(_table(digest, case, spread, f"inputs-{k}", name))
        if any(model.indices for model in spread.models.values()):
            blocks.append(_indices(digest, spread, f"input-indices-{k}"))
    method, variations = cases[0][1].method, cases[0][1].variations
    told = _READING.format(how=_HOW.get(method, ""), variations=plural(variations, "variation"))
    blocks.append(Text(told, kind="note"))
    if still := _moves_nothing(shown[0][1]):
        text = "A region takes whole nodes, and {} moves none of this mesh: a smaller mesh_size resolves it."
        blocks.append(Text(text.format(listed(still)), kind="note"))
    return Section("inputs", "What is not known of the inputs", blocks)


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

    known = zip(spread.keys, spread.units, spread.values, spread.deviations, strict=True)
    fields = [
        Field("Model", lambda model: model),
        *(
            Field(
                input_name(key),
                part(k),
                "1",
                f"{swept_value(float(value), unit)} ± {swept_value(float(f'{deviation:.3g}'), unit)}",
            )
            for k, (key, unit, value, deviation) in enumerate(known)
        ),
        Field("All inputs", lambda model: spread.models[model].displacement, "1", "of the displacement"),
        Field("All inputs", lambda model: spread.models[model].deformation, "1", "of the change of shape"),
        Field("Its error", error, "1", "against the reference"),
    ]
    return frame_table(_told(digest, spread), fields, name, caption=caption, mark=digest.mark)


def _told(digest: Digest, spread: InputSpread) -> list[str]:
    return [name for name in spread.models if name not in digest.twins]


def _indices(digest: Digest, spread: InputSpread, name: str) -> Table:
    def index(which: str, k: int) -> Any:
        return lambda model: float(spread.models[model].indices.get(which, [math.nan] * (k + 1))[k])

    fields = [
        Field("Model", lambda model: model),
        *(
            Field(input_name(key), index(which, k), "#", word)
            for k, key in enumerate(spread.keys)
            for which, word in INDICES.items()
        ),
    ]
    return frame_table(_told(digest, spread), fields, name, mark=digest.mark)
