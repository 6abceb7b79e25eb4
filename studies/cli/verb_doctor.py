"""`vdmbench doctor`: what the machine has and lacks."""

from __future__ import annotations

import argparse

from .output import MACHINE, OK, print_json

SUMMARY = "say what the machine has and lacks"


def arguments(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.set_defaults(solves=False)


def run(options: argparse.Namespace) -> int:
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
