"""The page of performance, from `vdmbench bench`.

SURFACE=liver.obj measures a third body. What is measured is kept in results/bench/bench.json:
BENCH=results/bench/bench.json makes the section from it again, without measuring. The whole table, of every
model on every mesh with the spread of its rounds, goes to docs/gallery/bench.html.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tools import marked
from tools.gallery import GALLERY, panels
from tools.runs import ROOT, finished
from vdmbench.bench import (
    FAR_OFF,
    YARDSTICK,
    Bench,
    Entry,
    amount,
    answers,
    deviation,
    error_text,
    median,
    pareto_plot,
    read_bench,
    seconds,
    write_bench_page,
)
from vdmbench.verdict import palette

DOCUMENT = ROOT / "docs" / "evidence" / "performance.md"
MEASURED = ROOT / "results" / "bench" / "bench.json"
PART = "performance"
# models that stand for their kind; the others differ from them by their solver, and are in the whole table
SHOWN = (
    "mass-spring",
    "vdm-paper",
    "vdm-consistent",
    "vdm-vector",
    "vdm-vector:nonlinear",
    "bem",
    "fem-coarse",
    "fem-p1",
    "fem-condensed",
    "fem-linear",
    "fem",
)
DRAWN = (
    "mass-spring",
    "vdm-paper",
    "vdm-vector",
    "bem",
    "fem-coarse",
    "fem-condensed",
    "fem-linear",
)
COMPARED = (
    "vdm-vector",
    "bem",
    "fem-coarse",
    "fem-condensed",
)  # with linear elements, in one line each


def finest(bench: Bench) -> list[list[Entry]]:
    """The entries of the finest mesh of each body."""
    return [bench.on(mesh) for mesh in {mesh[0]: mesh for mesh in bench.meshes()}.values()]


def section(bench: Bench) -> str:
    """The machine, the tables and the answers as Markdown."""
    machine = bench.machine
    bodies = finest(bench)
    sizes = ", ".join(f"{body[0].body} ({body[0].nodes:,} surface nodes)" for body in bodies)
    typical, largest = deviation(bench)
    text = (
        f"{machine['processor']}, {machine['cores']} cores, {machine['memory']}, one thread; medians of "
        f"{machine['rounds']} rounds, in each a frame below 20 ms is the median of five samples of 1 ms or more; "
        f"the interquartile range over the rounds is {100 * typical:.0f} % of the median for the typical time and "
        f"{100 * largest:.0f} % at most; {sizes}. Errors are in the displacement, ± the reference's own, ~ where "
        f"that is more than a tenth; what it leaves open is undecided. What is {100 * FAR_OFF:g} % off or more "
        "answers no question. "
        "[Every model on every mesh](../gallery/bench.html).\n\n"
    )
    told = answers(bench)
    text += marked.table(list(told[0]), [list(row.values()) for row in told]) + "\n"
    lines = []
    for e in [e for body in bodies for e in body if e.model in SHOWN]:
        times = [
            seconds(median(values)) for values in (e.setup, e.frame_all, e.columns, e.frame_local, e.recut)
        ]
        lines.append([e.body, e.model, *times, amount(e.peak_bytes, "B"), error_text(e)])
    text += marked.table(
        [
            "body",
            "model",
            "set-up",
            "frame, all nodes",
            "columns",
            "frame, contact",
            "re-cut",
            "memory",
            "error",
        ],
        lines,
    )
    return f"{text}\n{relative(bodies)}"


def relative(bodies: list[list[Entry]]) -> str:
    """What models cost over linear elements, from the body where that is least to the one where it is most."""
    lines = []
    for model in COMPARED:
        pairs = [
            (next(e for e in body if e.model == model), next(e for e in body if e.model == YARDSTICK))
            for body in bodies
            if {model, YARDSTICK} <= {e.model for e in body}
        ]
        if not pairs:
            continue
        ratios = [
            [median(getattr(e, cost)) / median(getattr(yard, cost)) for e, yard in pairs]
            for cost in ("setup", "columns", "frame_local", "frame_all", "recut")
        ]
        cells = [
            f"{_multiple(min(found))} to {_multiple(max(found))}" if np.isfinite(found).all() else "–"
            for found in ratios
        ]
        least, most = (error_text(f((e for e, _ in pairs), key=lambda e: e.error)) for f in (min, max))
        lines.append([model, *cells, f"{least} to {most}"])
    head = ["model", "set-up", "columns", "frame, contact", "frame, all nodes", "re-cut", "error"]
    return (
        f"The same as multiples of what {YARDSTICK} takes, over these bodies:\n\n{marked.table(head, lines)}"
    )


def _multiple(value: float) -> str:
    return f"{value:,.0f}" if value >= 100.0 else f"{value:.2g}"


def picture(bench: Bench) -> str:
    """Time against error on the finest mesh of each body, side by side, for light and dark."""
    bodies = finest(bench)
    models = [model for model in DRAWN if any(e.model == model for e in bench.entries)]
    places = palette.places(models)
    numbers = {model: places[model] for model in models}
    drawn = [
        (
            f"{body[0].body}, {body[0].nodes:,} nodes",
            pareto_plot([e for e in body if e.model in DRAWN], numbers, f"t{k}"),
        )
        for k, body in enumerate(bodies)
    ]
    return panels(drawn, numbers, f"Run time against error on {len(bodies)} bodies")


def main() -> None:
    """Write the section, the figure and the whole table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--bench", type=Path, help="a benchmark's file, in place of measuring")
    options.add_argument("--surface", type=Path, help="a third body")
    given = options.parse_args()
    if not given.bench:
        third = ["--surface", given.surface.absolute()] if given.surface else []
        command = ["bench", *third, "--out", MEASURED.parent]
        finished(*command, OPENBLAS_NUM_THREADS="1")
    bench = read_bench(given.bench or MEASURED)
    (GALLERY / "performance.svg").write_text(picture(bench), encoding="utf-8")
    write_bench_page(bench, GALLERY / "bench.html")
    marked.show(DOCUMENT, PART, section(bench))


if __name__ == "__main__":
    main()
