"""The page on which the paper's claims stand with their verdicts, from the stored results of several studies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..machine.files import write_atomically
from ..measures.case import Run
from ..report.blocks import Block, Cell, Code, Column, Figures, Section, Table, Text
from ..report.document import encoded, html_document
from ..report.judgement import FAILS, HOLDS, OPEN, WITHIN_LIMITS, Claim, Judgement
from ..verdict.digest import Digest
from ..verdict.formatting import listed, plural
from .claims import CLAIMS, on_trial

PAPER = "Sundaraj and Laugier (2006)"


@dataclass(frozen=True)
class Verdict:
    """A claim with its judgement and the studies that show it."""

    claim: Claim
    judgement: Judgement
    digests: Sequence[Digest]

    @property
    def studies(self) -> list[str]:
        """Names of the studies that put the claim on trial."""
        return [digest.run.study.study.name for digest in self.digests]


def verdicts(runs: Sequence[Run]) -> list[Verdict]:
    """All nine claims judged by the runs that put them on trial."""
    digests = [Digest(run) for run in runs]
    found = []
    with np.errstate(all="ignore"):
        for number, claim in sorted(CLAIMS.items()):
            mine = on_trial(digests, number)
            judgement = claim.judge(mine) if mine else None
            nothing = Judgement(OPEN, "", "No finished study among those given puts this claim on trial.")
            found.append(Verdict(claim, judgement or nothing, mine))
    return found


def verdict_rows(found: Sequence[Verdict]) -> list[dict[str, str]]:
    """One row per claim for a terminal or a document: column title -> text."""
    return [
        {
            "claim": f"{v.claim.number}. {v.claim.text}",
            "verdict": v.judgement.verdict,
            "number": v.judgement.number,
            "study": ", ".join(v.studies),
        }
        for v in found
    ]


def write_claims(runs: Sequence[Run], path: Path) -> list[Verdict]:
    """Write the page; the same runs give the same bytes.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    found = verdicts(runs)
    write_atomically(path, encoded(claims_html(found)))
    return found


def claims_html(found: Sequence[Verdict]) -> str:
    """The page as text."""
    names = sorted({name for v in found for name in v.studies})
    counts = {
        word: sum(v.judgement.verdict == word for v in found) for word in (HOLDS, WITHIN_LIMITS, FAILS, OPEN)
    }
    told = listed(f"{count} {_in_words(word, count)}" for word, count in counts.items() if count)
    lead = f"Of the nine claims that {PAPER} make of the Volume Distribution Method: {told}."
    sections = [_table(found), *map(_section, found), _reproduce(names)]
    return html_document(
        title="The paper's claims on trial",
        name="claims",
        notes=[lead],
        counts=[(plural(len(names), "study") if len(names) == 1 else f"{len(names)} studies", "")],
        models=[],
        sections=sections,
    )


def _in_words(verdict: str, count: int) -> str:
    """A verdict as the predicate of so many claims."""
    if verdict == OPEN:
        return "is not decided" if count == 1 else "are not decided"
    return verdict if count == 1 else verdict.replace("holds", "hold").replace("fails", "fail")


def _table(found: Sequence[Verdict]) -> Section:
    columns = [
        Column("Claim", numeric=False),
        Column("Verdict", numeric=False),
        Column("Number", numeric=False),
    ]
    columns.append(Column("Study", numeric=False))
    tones = {FAILS: "bad", OPEN: "muted"}
    rows = [
        [
            Cell(row["claim"]),
            Cell(row["verdict"], tone=tones.get(row["verdict"], "")),
            Cell(row["number"]),
            Cell(row["study"]),
        ]
        for row in verdict_rows(found)
    ]
    return Section("verdicts", "Verdicts", [Table("claims", "", columns, rows)])


def _section(verdict: Verdict) -> Section:
    claim, judgement = verdict.claim, verdict.judgement
    blocks: list[Block] = [
        Text(f"{judgement.verdict[:1].upper()}{judgement.verdict[1:]}. {judgement.reason}"),
        Text(f"In the paper: {claim.about.place}"),
        Text(f"Tried: {claim.about.trial}"),
        Text(f"Rule: {claim.rule}", kind="note"),
        Text(f"What would change the verdict: {claim.about.change}", kind="note"),
    ]
    if judgement.figures:
        blocks.append(Figures(judgement.figures, verdict.digests[0].legend))
    return Section(f"claim-{claim.number}", f"{claim.number}. {claim.text}", blocks)


def _reproduce(names: Sequence[str]) -> Section:
    lines = [f"vdmbench run {name}" for name in names]
    lines.append(f"vdmbench report --claims {' '.join(f'results/runs/{name}' for name in names)}")
    return Section("reproduce", "How to reproduce", [Code("\n".join(lines))])
