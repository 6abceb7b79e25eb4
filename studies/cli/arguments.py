"""The command line: a verb is a file `verb_NAME.py` with its summary, its arguments and what it does."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import NoReturn

from ..machine.streams import harmless

VERBS = (  # in the order in which they are told
    "new",
    "list",
    "check",
    "show",
    "plan",
    "run",
    "calibrate",
    "report",
    "compare",
    "export",
    "gate",
    "accept",
    "bench",
    "schema",
)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The arguments, by default those of the process; `verb` is what to call with them. Exits on a mistake."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    named = [word for word in words[:1] if word in VERBS]  # the other verbs take their time to load
    return _parser(named or VERBS).parse_args(words)


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


def _parser(names: Sequence[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        prog="vdmbench",
        description="Compare the Volume Distribution Method with finite elements on the same mesh.",
        epilog="exit codes: 0 ok, 1 accuracy regressed or bars too narrow, 2 usage or study file wrong, "
        "3 some cases failed, 4 machine lacks something, 5 stored results damaged, "
        "6 not all was compared, 70 a bug of the program, 130 interrupted",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    verbs = parser.add_subparsers(title="verbs", required=True, metavar="VERB")
    for name in names:
        verb = import_module(f".verb_{name}", __package__)
        told = getattr(verb, "MORE", verb.SUMMARY)
        sub = verbs.add_parser(name, help=verb.SUMMARY, description=told)
        sub.add_argument("--json", action="store_true", help="print JSON")
        sub.set_defaults(verb=verb.run, goes_on=False, solves=True)
        verb.arguments(sub)
    return parser
