"""`vdmbench run`: what is missing of a study, and its report."""

from __future__ import annotations

import argparse

from ..study.errors import plural
from .arguments import PLANS, flag, option, positive_seconds, shard, size_in_bytes
from .output import FAILED, complain, print_run
from .studies import load, make_plan, require_own, run_missing

SUMMARY = "run what is missing and write the report"
GOES_ON = True
ARGUMENTS = (
    *PLANS,
    option(
        "--shard", type=shard, default=(1, 1), metavar="I/N", help="run only the I-th of N parts of the cases"
    ),
    option(
        "--scheduler",
        metavar="ADDRESS",
        help="run the cases on this Dask cluster, such as tls://HOST:8786; meshes are made here; without TLS it "
        "trusts all who reach it, on loopback every user of the machine",
    ),
    flag(
        "--insecure-scheduler",
        "allow a scheduler on another machine without TLS: whoever reaches its network can run programs",
    ),
    flag("--fail-fast", "stop at the first failure"),
    option("--timeout", type=positive_seconds, metavar="S", help="seconds that one case may take"),
    option(
        "--memory",
        type=size_in_bytes,
        metavar="SIZE",
        help="memory that one worker may take, such as 4GB (default: the machine's, divided by the jobs)",
    ),
)


def run(options: argparse.Namespace) -> int:
    """Run what is missing, write the report, print the headline table."""
    from ..work.run import lost_cases

    study = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    names = ("shard", "timeout", "memory", "fail_fast", "scheduler", "insecure_scheduler")
    how = {name: getattr(options, name) for name in names}
    run, report = run_missing(plan, options, **how)
    code = print_run(run, plan.directory, report, options.json)
    stopped = options.fail_fast and run.failed  # before it came to all
    if lost := [] if stopped else lost_cases(plan, options.shard, run):
        told = f"no longer in {plan.directory}: {plural(len(lost), 'case')} of this run, first {lost[0]}"
        complain(f"{told}; run the same again", FAILED)
        return code or FAILED
    return code
