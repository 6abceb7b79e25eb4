"""`vdmbench audit`: whether the bars of a study hold, tried by one more mesh level."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from ..machine.streams import harmless
from .argument_kinds import run_arguments, study_arguments
from .output import (
    DAMAGED,
    FAILED,
    OK,
    REGRESSED,
    WIDTH,
    complain_of_failures,
    count,
    print_json,
    print_table,
)
from .studies import command_of, load, make_plan, require_own, run_missing

if TYPE_CHECKING:
    from ..evidence.audit import Audited
    from ..graph.plan import Plan

SUMMARY = "say whether a study's bars hold, by one more mesh level"
MORE = (
    "Run the study, and again with one more mesh level in DIR-audit: whether each bar holds the distance of its "
    "number from the best estimate. The finest level costs 10 to 20 times the one before."
)
_MISSES = 10  # told; all by --json
_MODEL, _CASE = 28, 38  # letters of a name


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    study_arguments(parser)
    run_arguments(parser)
    parser.set_defaults(goes_on=True)


def run(options: argparse.Namespace) -> int:
    """Run both, and hold the bars of the first against the second."""
    from ..evidence.audit import audited, hold, one_more_level
    from ..study.config import load_study
    from ..study.overrides import overridden

    study, path = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    levels = one_more_level(plan)
    text = path.read_text(encoding="utf-8-sig")
    finer_text = overridden(text, {"uncertainty": {"levels": levels}})
    finer_study = load_study(
        path, allow_outside=options.allow_outside, surface=options.surface, text=finer_text
    )
    directory = Path(f"{plan.directory}-audit")
    finer = make_plan(finer_study, options, directory=directory, command=command_of("audit", options))
    runs = [run_missing(each, words, options)[0] for each, words in ((plan, text), (finer, finer_text))]
    done, tried = ({case.hash: case for case in one.cases} for one in runs)
    cases = [
        audited(plan, case, done[case.hash], tried[other.hash])
        for case, other in zip(plan.cases, finer.cases, strict=True)
        if case.hash in done and other.hash in tried
    ]
    if options.json:
        print_json(_data(cases, plan, finer, levels))
    else:
        _tell(cases, levels)
    for one in runs:
        complain_of_failures(one)
    if any(one.failed for one in runs):
        return DAMAGED if any(one.damaged for one in runs) else FAILED
    return OK if hold(cases) else REGRESSED


def _data(cases: Sequence[Audited], plan: Plan, finer: Plan, levels: int) -> dict[str, Any]:
    from ..evidence.audit import HEADLINE, held, hold

    return {
        "study": plan.study.study.name,
        "directories": [str(plan.directory), str(finer.directory)],
        "levels": [levels - 1, levels],
        "hold": hold(cases),
        "errors": dict(zip(("held", "of"), held(cases, HEADLINE), strict=True)),
        "all": dict(zip(("held", "of"), held(cases), strict=True)),
        "cases": [
            {
                "case": case.label,
                "order": case.order if math.isfinite(case.order) else None,
                "bars": [
                    vars(bar) | {"used": _finite(bar.used), "holds": bar.used <= 1} for bar in case.bars
                ],
            }
            for case in cases
        ],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _tell(cases: Sequence[Audited], levels: int) -> None:
    """Both tables, what does not hold, and the answer."""
    from ..evidence.audit import COVERED, HEADLINE, held, hold
    from ..guard.side_by_side import HEADLINE as WORDS
    from ..measures.metrics import METRICS
    from ..verdict.formatting import of_unit, plain, short_percent

    def most(case: Audited, metric: str) -> str:
        shares = [bar.used for bar in case.bars if bar.metric == metric]
        return plain(max(shares), 2) if shares else "–"

    print(
        f"The bars of {levels - 1} mesh levels, tried by {levels}. Used: distance of a number from its best"
    )
    print("estimate, over its bar; a bar holds where it is at most 1.\n")
    print_table(
        [
            {
                "case": harmless(case.label or "the only case")[:_CASE],
                "order": f"{case.order:.2f}",
                "displ.": most(case, HEADLINE[0]),
                "deform.": most(case, HEADLINE[1]),
                "hold": "{} of {}".format(*held([case])),
            }
            for case in cases
        ]
    )
    print()
    rows = []
    for metric in METRICS:
        shares = [bar.used for case in cases for bar in case.bars if bar.metric == metric]
        if shares:
            told = "{} of {}".format(*held(cases, [metric]))
            row = {"measure": metric, "hold": told, "used, median": plain(median(shares), 2)}
            rows.append(row | {"used at most": plain(max(shares), 2)})
    print_table(rows)
    print()
    missed = [(case, bar) for case in cases for bar in case.bars if bar.used > 1 and bar.metric in HEADLINE]
    for case, bar in missed[:_MISSES]:
        unit = METRICS[bar.metric].unit
        value, width, best = (of_unit(number, unit) for number in (bar.value, bar.bar, bar.best))
        print(f"does not hold: {harmless(bar.model)[:_MODEL]} {harmless(case.label)}"[:WIDTH].rstrip())
        print(f"  {WORDS[bar.metric]} {value} ± {width}, best estimate {best}")
    if len(missed) > _MISSES:
        print(f"and {count(len(missed) - _MISSES, 'other')}; all by --json")
    (errors, of_errors), (every, of_all) = held(cases, HEADLINE), held(cases)
    word = "Yes" if hold(cases) else "No"
    print(f"Do the bars hold? {word}: {errors} of {of_errors} of the two errors ({short_percent(COVERED)} is")
    print(f"asked for), {every} of {of_all} of all measures.")
