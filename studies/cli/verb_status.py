"""`vdmbench status`: what is done, failed and missing of a run."""

from __future__ import annotations

import argparse

from .argument_kinds import run_directory
from .output import DAMAGED, FAILED, OK, print_json, taken

SUMMARY = "say what is done, failed and missing"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument("directory", type=run_directory, metavar="DIR", help="run directory")


def run(options: argparse.Namespace) -> int:
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
