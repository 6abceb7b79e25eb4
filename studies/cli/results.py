"""The verbs that take results, and doctor: status, report, gate, accept."""

from __future__ import annotations

import argparse
from pathlib import Path

from .output import (
    DAMAGED,
    FAILED,
    MACHINE,
    NOTHING_COMPARED,
    OK,
    REGRESSED,
    UsageError,
    complain,
    count,
    print_json,
    print_run,
    print_table,
    results_directory,
    taken,
    tell,
)


def status_verb(options: argparse.Namespace) -> int:
    """Print what is done, failed, damaged and missing."""
    from ..store.cases import run_state
    from ..store.run_directory import read_plan

    state = run_state(options.directory)
    if options.json:
        print_json(state)
    else:
        kinds = ("done", *(["stale"] if state["stale"] else []), "failed", "damaged", "missing")
        print(", ".join(f"{len(state[kind])} {kind}" for kind in kinds))
        if told := taken(read_plan(options.directory)):
            print(told)
        for entry in state["failed"]:
            print(
                f"failed: {entry['label']}: {entry['message']}"
                + (f"; {entry['remedy']}" if entry["remedy"] else "")
            )
        for kind in ("stale", "damaged", "missing"):
            for label in state[kind]:
                print(f"{kind}: {label}")
    return DAMAGED if state["damaged"] else FAILED if state["failed"] else OK


def report_verb(options: argparse.Namespace) -> int:
    """Rebuild the report of one directory, or the claims' page of several."""
    from ..report.rebuild import rebuild

    if options.claims:
        return _claims(options)
    if len(options.directories) > 1 or options.out:
        raise UsageError("several directories, and --out, go with --claims only")
    (directory,) = options.directories
    run, report = rebuild(directory, tell)
    if options.picture:
        from ..report.page import write_picture

        write_picture(run, options.picture)
    return print_run(run, directory, report, options.json)


def _claims(options: argparse.Namespace) -> int:
    from ..evidence.claims_page import verdict_rows, write_claims
    from ..store.cases import read_run

    page = options.out or results_directory() / "claims.html"
    rows = verdict_rows(write_claims([read_run(directory) for directory in options.directories], page))
    if options.json:
        return print_json({"report": str(page), "claims": rows})
    print_table(rows)
    print(f"report: {page}")
    return OK


def gate_verb(options: argparse.Namespace) -> int:
    """Compare a run with its baseline."""
    from ..guard import gate
    from ..guard.gate_report import describe, junit, markdown, summary
    from ..machine.files import write_atomically
    from ..store.cases import read_run

    run = read_run(options.directory)
    study = str(run.study["name"])
    path = _baseline(options, study)
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


def accept_verb(options: argparse.Namespace) -> int:
    """Write a run as the baseline."""
    from ..guard.gate import accept
    from ..store.cases import read_run

    run = read_run(options.directory)
    path = _baseline(options, str(run.study["name"]))
    baseline = accept(run, path, options.reason)
    if options.json:
        return print_json({"baseline": str(path), "cases": len(baseline.cases), "reason": baseline.reason})
    print(f"accepted {count(len(baseline.cases), 'case')}: {path}")
    return OK


def _baseline(options: argparse.Namespace, study: str) -> Path:
    from ..guard.gate import baseline_path

    return options.baseline or baseline_path(results_directory(), study)


def doctor_verb(options: argparse.Namespace) -> int:
    """Print what the machine has and lacks."""
    from .doctor import examine

    findings = examine()
    if options.json:
        print_json([finding._asdict() for finding in findings])
    else:
        for finding in findings:
            print(f"{'ok  ' if finding.ok else 'LACKS'} {finding.what}: {finding.detail}")
            if not finding.ok and finding.remedy:
                print(f"      {finding.remedy}")
    return OK if all(finding.ok or not finding.needed for finding in findings) else MACHINE
