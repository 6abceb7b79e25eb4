"""The command line: a verb is a file `verb_NAME.py` with its summary, its arguments and what it does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NoReturn

from ..machine.streams import harmless
from . import (
    verb_accept,
    verb_audit,
    verb_bench,
    verb_calibrate,
    verb_check,
    verb_compare,
    verb_doctor,
    verb_export,
    verb_gate,
    verb_list,
    verb_new,
    verb_plan,
    verb_report,
    verb_run,
    verb_schema,
    verb_show,
    verb_status,
)

VERBS = {  # in the order in which they are told
    "new": verb_new,
    "list": verb_list,
    "check": verb_check,
    "show": verb_show,
    "plan": verb_plan,
    "run": verb_run,
    "calibrate": verb_calibrate,
    "status": verb_status,
    "report": verb_report,
    "audit": verb_audit,
    "compare": verb_compare,
    "export": verb_export,
    "gate": verb_gate,
    "accept": verb_accept,
    "bench": verb_bench,
    "schema": verb_schema,
    "doctor": verb_doctor,
}


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, by default those of the process; `verb` is what to call with them. Exits on a mistake."""
    return _parser().parse_args(arguments)


class _Parser(argparse.ArgumentParser):
    """Says what is wrong as `output.complain` does: no argument steers the terminal."""

    def error(self, message: str) -> NoReturn:
        super().error(harmless(message))


class _Version(argparse.Action):
    """Prints the version of the installed package, which is looked up only then."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import version

        print(f"{parser.prog} {version('vdmbench')}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="vdmbench",
        description="Compare the Volume Distribution Method with finite elements on the same mesh.",
        epilog="exit codes: 0 ok, 1 accuracy regressed or bars too narrow, 2 usage or study file wrong, "
        "3 some cases failed, 4 machine lacks something, 5 stored results damaged, "
        "6 not all was compared, 70 a bug of the program, 130 interrupted",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for name, verb in VERBS.items():
        told = getattr(verb, "MORE", verb.SUMMARY)
        sub = verbs.add_parser(name, help=verb.SUMMARY, description=told)
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=verb.run, goes_on=False, solves=True)
        verb.arguments(sub)
    return parser
