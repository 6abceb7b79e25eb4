"""What is not known of the inputs: what each makes of the answers, beside the errors of the models."""

from __future__ import annotations

import math

from ..measures.bars import at_full_load
from ..measures.case import CaseResult
from ..measures.input_spread import INDICES, InputSpread
from ..measures.metrics import VECTOR
from ..verdict.digest import Digest
from ..verdict.formatting import NOTHING, listed, number, percent, plural, swept_value
from ..verdict.inputs_known import input_name, inputs_in_words, inputs_known
from .blocks import Block, Cell, Column, Section, Table, Text

_READING = (
    "Each share is a standard deviation over the displacement, area-weighted, at full load. {how} The error of a "
    "model is its displacement error against the reference. An error below what is not known of the inputs cannot "
    "be told from another tissue."
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
    found = inputs_known(digest, digest.focus if digest.focus in digest.compared else "")
    blocks: list[Block] = [Text(sentence) for sentence in [" ".join(inputs_in_words(found))] if sentence]
    roles = [case.hash for _, case in digest.key_cases]
    shown = [(case, spread) for case, spread in cases if case.hash in roles] or cases[:1]
    for k, (case, spread) in enumerate(shown):
        name = digest.case_name(case) if len(digest.cases) > 1 else ""
        blocks.append(_table(digest, case, spread, f"inputs-{k}", name))
        if any(model.indices for model in spread.models.values()):
            blocks.append(_indices(digest, spread, f"input-indices-{k}"))
    method, variations = cases[0][1].method, cases[0][1].variations
    how = f"{_HOW.get(method, '')} {plural(variations, 'variation')} of each case were computed."
    blocks.append(Text(_READING.format(how=how), kind="note"))
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
    columns = [
        Column("Model", numeric=False),
        *(
            Column(
                input_name(key),
                f"{swept_value(float(value), unit)} ± {swept_value(float(f'{deviation:.3g}'), unit)}",
                unit="1",
            )
            for key, unit, value, deviation in zip(
                spread.keys, spread.units, spread.values, spread.deviations, strict=True
            )
        ),
        Column("All inputs", "of the displacement", unit="1"),
        Column("All inputs", "of the change of shape", unit="1"),
        Column("Its error", "against the reference", unit="1"),
    ]
    rows = []
    for model, found in spread.models.items():
        error = at_full_load(case, model, VECTOR)
        lost = math.isfinite(error) and error < found.displacement
        rows.append(
            [
                Cell(model),
                *(_share(float(part)) for part in found.parts),
                _share(found.displacement),
                _share(found.deformation),
                Cell(percent(error), "below what is not known" if lost else "", error),
            ]
        )
    return Table(name, caption, columns, rows, marks=digest.marks(spread.models))


def _share(value: float) -> Cell:
    return Cell(percent(value) if math.isfinite(value) else NOTHING, value=value)


def _indices(digest: Digest, spread: InputSpread, name: str) -> Table:
    columns = [
        Column("Model", numeric=False),
        *(Column(input_name(key), word) for key in spread.keys for word in INDICES.values()),
    ]
    rows = [
        [
            Cell(model),
            *(
                Cell(number(float(found.indices[index][k])) if index in found.indices else NOTHING)
                for k in range(len(spread.keys))
                for index in INDICES
            ),
        ]
        for model, found in spread.models.items()
    ]
    return Table(name, "", columns, rows, marks=digest.marks(spread.models))


SECTIONS_FIRST = (inputs,)
