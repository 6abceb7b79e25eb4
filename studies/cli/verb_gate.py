"""`vdmbench gate`: a run's accuracy held against what was accepted."""

from __future__ import annotations

import argparse

from .argument_kinds import baseline_arguments, baseline_of, output_file
from .output import NOTHING_COMPARED, OK, REGRESSED, complain, print_json

SUMMARY = "hold a run's accuracy against its baseline"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    baseline_arguments(parser)
    parser.add_argument(
        "--allow-missing", action="store_true", help="compare what is there; by default what is missing is 6"
    )
    parser.add_argument("--junit", type=output_file, metavar="FILE", help="write JUnit XML too")
    parser.add_argument(
        "--markdown", type=output_file, metavar="FILE", help="write a summary in Markdown too"
    )


def run(options: argparse.Namespace) -> int:
    """Compare a run with its baseline."""
    from ..guard import gate
    from ..guard.gate_report import describe, junit, markdown, summary
    from ..machine.files import write_atomically
    from ..store.cases import read_run

    run = read_run(options.directory)
    study = run.study.study.name
    path = baseline_of(options, study)
    # where nobody has accepted anything, that is no mistake of the command, and whoever collects files finds them
    missing = gate.no_baseline(path) if options.baseline is None and not path.exists() else ""
    baseline = None if missing else gate.read_baseline(path)
    findings = gate.compare(run, baseline) if baseline else [gate.not_comparable(missing)]
    told = f"Baseline of {baseline.date}: {baseline.reason}" if baseline else "There is no baseline."
    if options.junit:
        write_atomically(options.junit, junit(study, findings, allow_missing=options.allow_missing))
    if options.markdown:
        write_atomically(options.markdown, markdown(study, told, findings).encode("utf-8", "replace"))
    if options.json:
        print_json({"study": study, "counts": gate.counts(findings), "findings": [vars(f) for f in findings]})
    elif baseline:
        for finding in findings:
            if finding.outcome != gate.SAME:
                print(describe(finding))
        print(f"{study}: {summary(findings)} (baseline of {baseline.date}: {baseline.reason})")
    if missing:
        return complain(f"nothing was compared: {missing}", NOTHING_COMPARED)
    if gate.regressed(findings):
        return REGRESSED
    if gate.is_incomplete(findings) and not options.allow_missing:
        return complain(
            "parts of the study are missing: finish the run, or let them be missing by --allow-missing",
            NOTHING_COMPARED,
        )
    return NOTHING_COMPARED if gate.nothing_compared(findings) else OK
