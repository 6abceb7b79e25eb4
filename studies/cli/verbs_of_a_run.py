"""What is made of the stored results of a run: `report gate accept`."""

from __future__ import annotations

import argparse

from ..study.errors import plural
from .arguments import BASELINE, RUN, flag, option, place, run_directory, verb
from .output import NOTHING_COMPARED, OK, REGRESSED, complain, print_json, print_run
from .studies import baseline_of


@verb(
    "report",
    "rebuild the report from the stored results",
    option("directory", type=run_directory, metavar="DIR", help="run directory"),
    option(
        "--picture",
        type=place,
        metavar="FILE",
        help="write a PNG of reference, model and difference too",
    ),
)
def report_run(options: argparse.Namespace) -> int:
    """Rebuild the report of a directory."""
    from ..report.rebuild import rebuild

    run, report = rebuild(options.directory)
    if options.picture:
        from ..report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, options.directory, report, options.json)


@verb(
    "gate",
    "hold a run's accuracy against its baseline",
    RUN,
    BASELINE,
    flag("--allow-missing", "compare what is there; by default what is missing or not comparable is 6"),
    option("--junit", type=place, metavar="FILE", help="write JUnit XML too"),
    option("--markdown", type=place, metavar="FILE", help="write a summary in Markdown too"),
)
def gate_run(options: argparse.Namespace) -> int:
    """Compare a run with its baseline."""
    from .. import gate
    from ..machine import write_atomically
    from ..store.cases import read_run

    run = read_run(options.directory)
    study = run.study.study.name
    path = baseline_of(options, study)
    # where nobody has accepted anything, that is no mistake of the command, and whoever collects files finds them
    missing = gate.no_baseline(path) if options.baseline is None and not path.exists() else ""
    baseline = None if missing else gate.read_baseline(path)
    none = gate.Finding(gate.NOT_COMPARABLE, "baseline", "", "", why=missing)
    findings = gate.compare(run, baseline) if baseline else [none]
    about = f"Baseline of {baseline.date}: {baseline.reason}" if baseline else "There is no baseline."
    if options.junit:
        write_atomically(options.junit, gate.junit(study, findings, allow_missing=options.allow_missing))
    if options.markdown:
        write_atomically(options.markdown, gate.markdown(study, about, findings).encode("utf-8", "replace"))
    if options.json:
        print_json({"study": study, "counts": gate.counts(findings), "findings": [vars(f) for f in findings]})
    elif baseline:
        for finding in findings:
            if finding.outcome != gate.SAME:
                print(gate.describe(finding))
        for told in dict.fromkeys(
            f"{f.model}: {f.why}" for f in findings if f.outcome == gate.SAME and f.why
        ):
            print(f"unchanged: {told}")
        print(f"{study}: {gate.summary(findings)} (baseline of {baseline.date}: {baseline.reason})")
    if gate.regressed(findings):
        return REGRESSED
    why = f"nothing was compared: {missing}" if missing else ""
    why = why or gate.why_not_passed(findings, allow_missing=options.allow_missing)
    return complain(why, NOTHING_COMPARED) if why else OK


@verb(
    "accept",
    "make a run's accuracy the baseline",
    RUN,
    BASELINE,
    option("--reason", required=True, metavar="TEXT", help="why these numbers are right"),
)
def accept_run(options: argparse.Namespace) -> int:
    """Write a run as the baseline."""
    from ..gate import accept
    from ..store.cases import read_run

    run = read_run(options.directory)
    path = baseline_of(options, run.study.study.name)
    baseline = accept(run, path, options.reason)
    if options.json:
        return print_json({"baseline": str(path), "cases": len(baseline.cases), "reason": baseline.reason})
    print(f"accepted {plural(len(baseline.cases), 'case')}: {path}")
    return OK
