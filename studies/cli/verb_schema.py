"""`vdmbench schema`: what an editor needs to complete and check a study file."""

from __future__ import annotations

import argparse

from .output import OK, print_json

SUMMARY = "print the JSON schema of study files, for editors"
MORE = (
    "Print the JSON schema of study files. Save it, and name it in the first line of a study, #:schema study.json, "
    "for an editor that knows TOML schemas."
)
ARGUMENTS = ()


def run(_: argparse.Namespace) -> int:
    """Print it; it is JSON with and without --json."""
    from ..study.fields import study_schema

    print_json(study_schema())
    return OK
