"""Volume drift against load."""

from __future__ import annotations

from ..verdict.digest import Digest
from ..verdict.formatting import listed, short_percent
from .blocks import Block, Figure, Figures, Section, Text
from .plots import Plot, draw, log_axis, percent_ticks
from .section_errors import over_load

_DRIFT_FLOOR = 1e-16  # below what double precision can tell from zero


def volume_drift(digest: Digest) -> Section | None:
    """Change of the exact enclosed volume, as a share of the volume and of the displaced volume."""
    if not digest.has_steps:
        return None  # one point per model: the headline has it
    quantities = (
        ("volume_drift", "|V − V0| / V0", "Drift as a share of the volume"),
        (
            "volume_drift_of_displaced",
            "|V − V0| / displaced volume",
            "Drift as a share of the displaced volume",
        ),
    )
    figures = [
        figure
        for k, (metric, label, title) in enumerate(quantities)
        if (figure := _drift(digest, metric, label, title, f"v{k}")) is not None
    ]
    if not figures:
        return None
    blocks: list[Block] = []
    if len(digest.cases) > 1:
        blocks.append(Text("The largest drift of all cases at each load, without its sign.", kind="note"))
    blocks.append(Figures(figures, digest.legend))
    return Section("volume", "Volume drift against load", blocks)


def _drift(digest: Digest, metric: str, label: str, title: str, salt: str) -> Figure | None:
    curves = over_load(digest, digest.models, metric)
    if not any(len(curve) > 1 for curve in curves.values()):
        return None  # one load is no curve
    described = []
    plot = Plot("load factor", label, salt)
    with plot as axes:
        for model, curve in curves.items():
            factors = sorted(curve)
            drifts = [max(_DRIFT_FLOOR, *map(abs, curve[factor])) for factor in factors]
            draw(axes, digest.colour(model), model, factors, drifts)
            described.append(f"{model} up to {short_percent(max(drifts))}")
        log_axis(axes, "y")
        percent_ticks(axes)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    return Figure(plot.drawn(f"{title}: {listed(described)}."), title)
