"""Shared by the verbs: tables, progress, error messages, exit codes, the results directory."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import sys
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..machine import json_text

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from ..measures.case import Run

WIDTH = 80  # columns of a terminal
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=[^\W\d]|%)|(?<=±) ")
OK, REGRESSED, USAGE, FAILED, MACHINE, DAMAGED, NOTHING_COMPARED = range(7)
BUG, INTERRUPTED = 70, 130


def print_run(run: Run, directory: Path, report: Path, as_json: bool) -> int:
    """The headline table, the verdict, the failures and the report's path."""
    if run.told is None:
        from ..report.headline import summary  # plotting is slow to load

        run = dataclasses.replace(run, told=summary(run))
    found = dict(run.told or {})
    table = found.pop("table")
    if as_json:
        print_json({"directory": str(directory), "report": str(report)} | found)
    else:
        from ..verdict.words import WHY

        print_table(table)
        print_answers(found["answers"])
        complain_of_failures(run)
        why = found["answers"]["further"].get(WHY, [])
        for one in found["stopped"]:
            if any(text.startswith(f"{one['model']}: ") and one["message"] in text for text in why):
                continue
            told = f"stopped: {one['model']} ({one['where']}): {one['message']}"
            print(folded(told + (f"; {one['remedy']}" if one["remedy"] else "")))
        lost = f", {run.damaged} damaged" if run.damaged else ""
        print(
            f"{found['done']} done, {len(run.failed) - run.damaged} failed{lost}, {len(run.missing)} missing"
        )
        print(f"report: {report}")
    if run.failed and not found["done"] and all(failure["code"] == "input" for failure in run.failed):
        return USAGE  # the input could not be used
    ended = found["judgement"].get("unreached") or found["unanswered"]
    return DAMAGED if run.damaged else FAILED if run.failed or ended else OK


def print_answers(told: Mapping[str, Any]) -> None:
    """A line for each family, then the recommended model and the reason, folded to `WIDTH` columns."""
    from ..verdict.words import ON_TERMINAL

    print()
    for row in told["rows"]:
        print(folded(f"{row['title']}: {row['word']}. {row['text']}"))
    for note in told["notes"]:
        print(folded(note))
    instead = [("What to take instead?", told["instead"])] if told["instead"] else []
    further = [(question, told["further"].get(question)) for question in ON_TERMINAL]
    for question, sentences in [*instead, *filter(lambda answer: answer[1], further)]:
        print(f"\n{question}")
        for sentence in sentences:
            print(folded(sentence, "  "))
    print()


def folded(text: str, indent: str = "") -> str:
    """A text in lines of `WIDTH` columns, indented from the second on; a number stays with its unit."""
    whole = _BEFORE_UNIT.sub("\u00a0", text).replace(" = ", "\u00a0=\u00a0")
    lines = textwrap.fill(
        whole,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=f"{indent}  ",
        break_on_hyphens=False,
        break_long_words=False,
    )
    return lines.replace("\u00a0", " ")


def print_table(rows: Sequence[dict[str, str]]) -> None:
    """A line for each row; if wider than `WIDTH`, the first column on a line and the others below it."""
    if not rows:
        return
    columns = list(rows[0])
    widths = [max(len(column), *(len(row[column]) for row in rows)) for column in columns]
    if sum(widths) + 2 * (len(widths) - 1) > WIDTH:
        for row in rows:
            first, *others = columns
            print(row[first])
            print(folded("; ".join(f"{column}: {row[column]}" for column in others if row[column]), "  "))
        return
    for row in ({column: column for column in columns}, *rows):
        cells = (row[column].ljust(width) for column, width in zip(columns, widths, strict=True))
        print("  ".join(cells).rstrip())


def tell(text: str) -> None:
    """A line of progress, on standard error."""
    with contextlib.suppress(OSError):  # a full disk or a closed terminal does not end a run
        print(text, file=sys.stderr, flush=True)


def print_json(value: Any) -> int:
    print(json_text(value, indent=1))
    return OK


def answer(options: argparse.Namespace, value: Any, *lines: str) -> int:
    """Print a verb's result, as JSON if requested, else as lines."""
    if options.json:
        return print_json(value)
    for line in lines:
        print(line)
    return OK


def complain(text: str, code: int) -> int:
    """Print errors, one a line; returns the exit code."""
    for line in text.split("\n"):
        tell(f"vdmbench: {line}")
    return code


def complain_of_failures(run: Run) -> None:
    for failure in run.failed:
        remedy = f"; {failure['remedy']}" if failure["remedy"] else ""
        complain(f"failed: {failure['label']}: {failure['message']}{remedy}", FAILED)
