"""What a run says in a terminal and as JSON, kept beside the report for a run that has nothing to do."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..measures.case import Run
from ..verdict.digest import digest_of
from ..verdict.verdict import verdicts
from ..verdict.words import told
from .headline import headline_metrics, terminal_rows
from .section_cases import stopped_models


def summary(run: Run) -> dict[str, Any]:
    """What is done, the numbers of every model, the verdicts; numbers, texts, lists and tables alone."""
    digest = digest_of(run)
    found = verdicts(digest)
    return {
        "done": len(run.cases),
        "failed": list(run.failed),
        "missing": list(run.missing),
        "stopped": [
            dict(zip(("model", "where", "message", "remedy"), row, strict=True))
            for row in stopped_models(digest)
        ],
        "metrics": headline_metrics(run),
        "answers": dataclasses.asdict(told(found)),
        "table": terminal_rows(digest),  # of the terminal, which JSON does not show
    } | found.as_data()
