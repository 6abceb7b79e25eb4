"""`vdmbench run`: what is missing of a study, and its report."""

from __future__ import annotations

import argparse

from ..machine.processors import usable_processors
from .argument_kinds import (
    plan_arguments,
    positive_seconds,
    shard,
    size_in_bytes,
)
from .output import FAILED, complain, count, print_run
from .progress import Progress
from .studies import load, make_plan, require_own

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
    from ..graph.run import Options, lost_cases, run_plan
    from ..report.rebuild import rebuild

    study, path = load(options)
    plan = make_plan(study, options)
    require_own(plan, options)
    how = Options(
        jobs=options.jobs or usable_processors(),
        shard=options.shard,
        timeout=options.timeout,
        memory=options.memory,
        fail_fast=options.fail_fast,
        scheduler=options.scheduler,
        insecure_scheduler=options.insecure_scheduler,
    )
    with Progress(study.study.name, quiet=options.json) as progress:
        run, report = run_plan(plan, path.read_text(), how, progress.show, rebuild)
    code = print_run(run, plan.directory, report, options.json)
    stopped = options.fail_fast and run.failed  # before it came to all
    if lost := [] if stopped else lost_cases(plan, how.shard, run):
        told = f"no longer in {plan.directory}: {count(len(lost), 'case')} of this run, first {lost[0]}"
        complain(f"{told}; run the same again", FAILED)
        return code or FAILED
    return code
