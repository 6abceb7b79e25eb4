"""The page of a benchmark: run time against error, where the time goes, how costs grow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from ..machine.files import write_atomically
from ..report.blocks import (
    Block,
    Cell,
    Column,
    Facts,
    Figure,
    Figures,
    Section,
    Table,
    Text,
)
from ..report.document import encoded, html_document
from ..report.plots import Plot, colour, draw, marker, percent_axis, time_ticks
from ..verdict import palette
from ..verdict.formatting import NOTHING, listed, short_percent
from .bench_data import (
    Bench,
    Entry,
    Growth,
    ModelGrowth,
    amount,
    answers,
    median,
    model_growths,
    pareto,
    rows,
    seconds,
    spread,
)

ERROR_NOTE = (
    "Every model answers the same contact load on the same mesh. Its error is the relative L2 difference from "
    "linear elements on the refined mesh, ± that reference's own; ~ where this is more than a tenth."
)
NOTE = (
    f"{ERROR_NOTE} "
    "Times are medians [first, third quartile] over rounds in which all models take turns; in each, a frame below "
    "20 ms is a median of five samples. Ratios are to fem-linear in the same round. Frame, contact: displacement "
    "and fluid pressure in single precision by the columns of the contact nodes, one each, where the model is "
    "linear in the load; the product is the same for all of them. Columns: what these take once per contact. "
    "Re-cut: from a changed mesh to its first answer, without columns and without meshing."
)


def write_bench_page(bench: Bench, path: Path) -> None:
    """Write the page; the same benchmark gives the same bytes.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    write_atomically(path, encoded(bench_html(bench)))


def bench_html(bench: Bench) -> str:
    """The page as text."""
    numbers = palette.places(e.model for e in bench.entries)
    legend = [(numbers[name], name, False) for name in dict.fromkeys(e.model for e in bench.entries)]
    figures = [
        Figure(pareto_plot(bench.on(mesh), numbers, f"p{k}"), f"{mesh[0]}, {mesh[1]:,} nodes")
        for k, mesh in enumerate(bench.meshes())
    ]
    told = answers(bench)
    question, lead = told[0]["question"], {mesh: a for mesh, a in told[0].items() if mesh != "question"}
    sections = [
        Section("answers", "Which model", [Text(ANSWERS_NOTE, kind="note"), _answers(told)]),
        Section(
            "pareto", "Run time against error", [Text(FIGURE_NOTE, kind="note"), Figures(figures, legend)]
        ),
        Section("table", "Costs", [Text(NOTE, kind="note"), _table(bench, numbers)]),
    ]
    if models := model_growths(bench):
        sections.append(_model_growth(models, numbers))
    if bench.growths:
        sections.append(_growth(bench.growths))
    sections.append(Section("machine", "Machine", [Facts(list(bench.machine.items()))]))
    return html_document(
        title="Run time against error",
        name="bench",
        notes=[question, *(f"{mesh}: {answer}." for mesh, answer in lead.items())],
        counts=[(f"{len(bench.entries)} measurements", "")],
        models=legend,
        sections=sections,
    )


ANSWERS_NOTE = (
    "On the finest mesh of each body. Undecided: the reference's own error, ±, leaves open whether an error is "
    "within the limit, or which of two is the smaller."
)
FIGURE_NOTE = (
    "Further left is faster, lower is closer. Filled: one frame of a contact. Hollow, at the end of the dotted "
    "line: a re-cut. The grey line joins what no other model beats in both error and frame."
)


def pareto_plot(entries: Sequence[Entry], numbers: dict[str, int], salt: str) -> Markup:
    """Frame and re-cut time against the error of the models on one mesh."""
    usable = [e for e in entries if math.isfinite(e.error) and median(e.frame_local) > 0.0]
    plot = Plot("time", "displacement error", salt)
    with plot as axes:
        front = pareto(usable)
        axes.plot(
            [median(e.frame_local) for e in front], [e.error for e in front], color="0.7", linewidth=1.0
        )
        for e in usable:
            k, frame, recut = numbers[e.model], median(e.frame_local), median(e.recut)
            axes.plot(list(spread(e.frame_local)), [e.error] * 2, color=colour(k), linewidth=1.0)
            axes.plot([frame, recut], [e.error] * 2, ":", color=colour(k), linewidth=1.0)
            axes.plot([recut], [e.error], marker=marker(k), color=colour(k), markerfacecolor="none")
            draw(axes, k, e.model, [frame], [e.error], markersize=6.5, linestyle="none")
        time_ticks(axes)
        percent_axis(axes, [e.error for e in usable])
    told = [f"{e.model} {seconds(median(e.frame_local))} at {short_percent(e.error)}" for e in usable]
    return plot.drawn(f"Run time against displacement error: {listed(told)}.")


def _answers(told: Sequence[dict[str, str]]) -> Table:
    columns = [Column("" if title == "question" else title, numeric=False) for title in told[0]]
    return Table("answers", "", columns, [[Cell(text) for text in row.values()] for row in told])


def _table(bench: Bench, numbers: dict[str, int]) -> Table:
    shown = rows(bench)
    columns = [Column(title, numeric=k > 2) for k, title in enumerate(shown[0])] if shown else []
    values = {"error": "error", "memory": "peak_bytes"}
    cells = [
        [
            Cell(text, value=getattr(e, values[title]) if title in values else None)
            for title, text in row.items()
        ]
        for e, row in zip(bench.entries, shown, strict=True)
    ]
    return Table("bench", "", columns, cells, [numbers[e.model] for e in bench.entries], open_rows=200)


def _model_growth(growths: Sequence[ModelGrowth], numbers: dict[str, int]) -> Section:
    columns = [Column("model", numeric=False), Column("body", numeric=False), Column("surface nodes")]
    columns += [Column(f"{what}, exponent") for what in ("set-up", "frame, all nodes", "memory")]
    cells = []
    for g in growths:
        known = [part for part in (g.setup, g.frame, g.memory) if part]
        least, most = (f(int(f(part.nodes)) for part in known) for f in (min, max))
        exponents = [
            Cell(f"{part.exponent:.2f}", value=part.exponent) if part else Cell(NOTHING)
            for part in (g.setup, g.frame, g.memory)
        ]
        cells.append([Cell(g.model), Cell(g.body), Cell(f"{least:,} to {most:,}"), *exponents])
    note = (
        "Least-squares slope of the logarithms over the meshes above. On small meshes what a call costs whatever "
        "its size hides the growth; of the surface model, larger spheres show it."
    )
    table = Table("growth-models", "", columns, cells, [numbers[g.model] for g in growths], open_rows=200)
    return Section("growth-models", "Growth of every model", [Text(note, kind="note"), table])


def _growth(growths: Sequence[Growth]) -> Section:
    columns = [
        Column("quantity", numeric=False),
        Column("exponent"),
        Column("sizes"),
        Column("at the largest"),
    ]
    cells = [
        [
            Cell(g.what),
            Cell(f"{g.exponent:.2f}", value=g.exponent),
            Cell(", ".join(f"{int(n):,}" for n in g.nodes)),
            Cell(amount(float(g.values[-1]), g.unit)),
        ]
        for g in growths
    ]
    note = (
        "Least-squares slope of the logarithms over surface nodes: of spheres for the sparse forms, of the first "
        "body for the others. Fill and flops: non-zeros of a factor in minimum degree order and the operations "
        "of making it, a stand-in for the factor in use, which does not tell its own."
    )
    blocks: list[Block] = [Text(note, kind="note"), Table("growth", "", columns, cells)]
    return Section("growth", "Growth", blocks)
