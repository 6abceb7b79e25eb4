"""`vdmbench calibrate`: VDM parameters fitted on half of a study's loads."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from .arguments import RUNS, STUDY_READS, flag, option, study_argument, verb
from .output import FAILED, OK, UsageError, complain_of_failures, print_json, print_table, tell
from .studies import command_of, load, make_plan, only_case, require_own, run_missing

if TYPE_CHECKING:
    from ..measures.case import Run
    from ..work.plan import Plan


@verb(
    "calibrate",
    "fit VDM parameters on half of a study's loads, try them on the rest",
    study_argument(),
    *STUDY_READS,
    *RUNS,
    option(
        "--transfer",
        action="append",
        default=[],
        metavar="STUDY",
        help="try the fit on the held-out loads of this study too (can be repeated)",
    ),
    flag("--measured", "fit Young's modulus to the study's [[measured]] tables instead"),
)
def calibrate_study(options: argparse.Namespace) -> int:
    """Fit VDM parameters on half of a study's loads, try them on the rest.

    With --measured: fit Young's modulus of each model on the first load that was measured, and try it on the
    others.
    """
    from ..calibrate import as_json, as_toml, body, calibrate, check, check_fit, finer_study, table
    from ..machine import json_text, write_atomically
    from ..study.errors import StudyError

    plan = make_plan(load(options), options)
    if options.measured:
        return _fit_measured(plan, options)
    require_own(plan, options)
    check_fit(plan)
    elsewhere = []  # read, and found to be of use, before anything is run
    for name in options.transfer:
        there = argparse.Namespace(**vars(options) | {"study": name, "surface": None, "out": None})
        elsewhere.append(make_plan(load(there), there))
        check(elsewhere[-1])
    out = plan.directory
    run, refined = _run_for_fit(plan, options), None
    finer = finer_study(plan)
    if finer is not None:
        again = command_of("calibrate", options)
        try:
            planned = make_plan(finer, options, directory=out / "finer", command=again)
        except StudyError as error:  # such as too many nodes
            tell(f"no finer mesh: {error.problems[0].message}")
        else:
            refined = _run_for_fit(planned, options)
    own = body(*run, refined)
    others = [body(*_run_for_fit(other, options)) for other in elsewhere]
    entries = calibrate(own, others)
    data = {own.name: as_json(entries)}
    write_atomically(out / "calibration.json", json_text(data, indent=1).encode())
    write_atomically(out / "calibration.toml", as_toml(entries).encode())
    if options.json:
        print_json(data)
    else:
        print_table(table(entries))
        print(f"\n{as_toml(entries)}\nwritten: {out / 'calibration.toml'}")
    return FAILED if own.lost or any(other.lost for other in others) else OK


def _fit_measured(plan: Plan, options: argparse.Namespace) -> int:
    """Print the modulus of each model, fitted on the first measured load, and what it says of the others."""
    from dataclasses import asdict
    from math import isnan

    from ..body.mesh_cache import mesh_from_cache
    from ..calibrate import NothingMeasuredError, fit_modulus
    from ..verdict.formatting import percent, quantity

    case = only_case(plan, "--measured fits")
    if not case.study.measured:
        raise UsageError("the study has no [[measured]] table to fit")
    mesh = mesh_from_cache(plan.meshes[case.mesh].geometry, plan.cache)
    try:
        fits = [fit_modulus(case.study, mesh, name) for name in case.study.study.models]
    except NothingMeasuredError as error:
        raise UsageError(str(error)) from error
    if options.json:
        return print_json([asdict(fit) for fit in fits])
    print_table(
        [
            {
                "model": fit.model,
                "E fitted": quantity(fit.modulus, "Pa"),
                "± by u_D": quantity(fit.uncertainty, "Pa", 2),
                "rms E, fitted": quantity(fit.trained, fit.unit),
                "rms E, held out": quantity(fit.held_out, fit.unit),
                "of rms D": percent(fit.held_out / fit.size) if fit.size > 0.0 else "–",
                "with E as given": quantity(fit.as_given, fit.unit),
            }
            for fit in fits
        ]
    )
    if all(isnan(fit.size) for fit in fits):
        print(
            "One load was measured, so that nothing is held out: a fit hides a wrong model. Measure another."
        )
    print("Only Young's modulus is fitted. All other inputs, the body and its supports are taken as given.")
    return OK


def _run_for_fit(plan: Plan, options: argparse.Namespace) -> tuple[Plan, Run]:
    """Run what is missing of a study that parameters are fitted on, and say what failed."""
    run, _ = run_missing(plan, options)
    complain_of_failures(run)
    return plan, run
