"""`vdmbench run`: what is missing of a study, and its report."""

from __future__ import annotations

import argparse

from .argument_kinds import (
    plan_arguments,
    positive_seconds,
    shard,
    size_in_bytes,
)
from .output import FAILED, complain, count, print_run
from .studies import load, make_plan, require_own, run_missing, study_text

SUMMARY = "run what is missing and write the report"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    plan_arguments(parser)
    parser.add_argument(
        "--shard", type=shard, default=(1, 1), metavar="I/N", help="run only the I-th of N parts of the cases"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run the cases on this Dask cluster, such as tls://HOST:8786; meshes are made here; without TLS it "
        "trusts all who reach it, on loopback every user of the machine",
    )
    parser.add_argument(
        "--insecure-scheduler",
        action="store_true",
        help="allow a scheduler on another machine without TLS: whoever reaches its network can run programs",
    )
    parser.set_defaults(goes_on=True)
    parser.add_argument("--fail-fast", action="store_true", help="stop at the first failure")
    parser.add_argument(
        "--timeout", type=positive_seconds, metavar="S", help="seconds that one case may take"
    )
    parser.add_argument(
        "--memory",
        type=size_in_bytes,
        metavar="SIZE",
        help="memory that one worker may take, such as 4GB (default: the machine's, divided by the jobs)",
    )


def run(options: argparse.Namespace) -> int:
    """Run what is missing, write the report, print the headline table."""
    from ..work.run import lost_cases

    study, _ = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    names = ("shard", "timeout", "memory", "fail_fast", "scheduler", "insecure_scheduler")
    how = {name: getattr(options, name) for name in names}
    run, report = run_missing(plan, study_text(options), options, **how)
    code = print_run(run, plan.directory, report, options.json)
    stopped = options.fail_fast and run.failed  # before it came to all
    if lost := [] if stopped else lost_cases(plan, options.shard, run):
        told = f"no longer in {plan.directory}: {count(len(lost), 'case')} of this run, first {lost[0]}"
        complain(f"{told}; run the same again", FAILED)
        return code or FAILED
    return code
