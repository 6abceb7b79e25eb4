"""`vdmbench claims`: the paper's claims on trial over a grid of bodies, meshes and materials."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..machine import cache_directory
from .arguments import option, place
from .output import OK, UsageError, folded, print_json, print_table, tell

SUMMARY = "put the paper's claims on trial over three bodies, two meshes and two materials, in some minutes"
ARGUMENTS = (
    option("numbers", type=int, nargs="*", metavar="N", help="these claims alone, row by row"),
    option(
        "--from",
        dest="points",
        type=Path,
        metavar="FILE",
        help="judge what was measured before, in place of measuring",
    ),
    option(
        "--out",
        type=place,
        metavar="FILE",
        help="write what was measured as CSV, a line a row and case",
    ),
    option("--cache", type=place, metavar="DIR", help="where meshes are kept"),
)


def run(options: argparse.Namespace) -> int:
    """Measure, or read, and print a line for each claim; of claims that are named every row."""
    from dataclasses import asdict

    from .. import claims

    numbers = sorted(set(options.numbers))
    if strange := [number for number in numbers if not 1 <= number <= len(claims.DATA["claims"])]:
        raise UsageError(f"there is no claim {strange[0]}; they are 1 to {len(claims.DATA['claims'])}")
    if options.points:
        points = claims.read_points(options.points)
    else:
        points = claims.measure(options.cache or cache_directory(), numbers, tell)
    if options.out:
        claims.write_points(points, options.out)
    rows = [row for row in claims.judge(points) if not numbers or row.claim in numbers]
    if options.json:
        return print_json({"claims": [asdict(row) for row in rows]})
    if not numbers:
        print_table(claims.table_of_claims(rows))
        return OK
    for number in numbers:
        print(f"\n{claims.title(number)}")
        for line in claims.told(number):
            print(folded(line, "  "))
        print_table(claims.table_of(number, rows))
    return OK
