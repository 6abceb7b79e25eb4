"""The league table: surface models, elements and engines of others on the same bodies under the same loads.

Each body is touched lightly and firmly, and bent by its own weight, at two Poisson ratios. The reference is `fem`
on a mesh refined once. Runs in `results/runs/league-*`, where what is there already is kept. Engines that are
not installed (docs/examples) are left out, and named. About ten minutes of an idle core.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from tools import marked
from tools.gallery import GALLERY, panels
from tools.runs import ROOT, RUNS, finished
from vdmbench.machine.processors import processor_name, usable_processors
from vdmbench.measures.bars import value_bar
from vdmbench.measures.case import Run
from vdmbench.measures.metrics import VECTOR
from vdmbench.report.plots import Plot, colour, line, log_axis, marker, percent_axis, time_ticks
from vdmbench.report.told import tell
from vdmbench.store.cases import read_run
from vdmbench.study.registry import all_models, split
from vdmbench.verdict import palette
from vdmbench.verdict.formatting import NOTHING, percent, quantity, short_percent

DOCUMENT = ROOT / "docs" / "evidence" / "league.md"
PART = "league"
MODELS = (
    "vdm-paper",
    "vdm-vector",
    "bem",
    "bem:nonlinear",
    "mass-spring",
    "fem-p1",
    "fem-coarse",
    "fem-linear",
    "mujoco-flex",
    "ngsolve-p2p1",
)
LIMITS = (0.05, 0.10, 0.20)
ALLOWED = 0.10  # error up to which a model takes part in the profile of times
SWEEP = '"tissue.poisson_ratio" = [0.45, 0.499]\n'
BODIES = {
    "ball": ('shape = "sphere"\nradius = "50 mm"\nmesh_size = "14 mm"', "5 kPa", "z", 0.2),
    "block": ('shape = "box"\nsize = ["100 mm", "80 mm", "50 mm"]\nmesh_size = "14 mm"', "5 kPa", "z", 0.01),
    "bar": ('shape = "box"\nsize = ["100 mm", "30 mm", "30 mm"]\nmesh_size = "10 mm"', "100 kPa", "x", 0.01),
    "organ": ('shape = "organ"\nsize = "190 mm"\nmesh_size = "16 mm"', "20 kPa", "z", 0.15),
}
LOADS = {
    "touch": (
        '[regions.finger]\ncap = { direction = [0.3, 0.2, 1], angle = "25 deg" }\n'
        '[[constraints]]\nname = "finger"\nkind = "contact"\nregion = "finger"\nforce = "0.1 N"\n'
        'profile = "gaussian"\n',
        SWEEP + '"constraints.finger.force" = ["0.05 N", "0.3 N"]\n',
    ),
    "weight": ("[gravity]\nacceleration = [0, 0, -9.81]\n", SWEEP),
}


@dataclass(frozen=True)
class Entry:
    """A model on a case: its error and bar, the time of a frame and of a set-up [s]; NaN where it failed."""

    case: str
    model: str
    error: float
    bar: float
    frame: float
    setup: float

    @property
    def failed(self) -> bool:
        """Whether it gave no answer."""
        return not np.isfinite(self.error)


def study_text(body: str, load: str, models: Iterable[str]) -> str:
    """A body under a load as a study file."""
    geometry, modulus, axis, fraction = BODIES[body]
    acting, sweep = LOADS[load]
    names = ", ".join(f'"{name}"' for name in models)
    return (
        f'[study]\nname = "league-{body}-{load}"\nmodels = [{names}, "fem"]\nreference = "fem"\n'
        f'[geometry]\n{geometry}\n[tissue]\nyoungs_modulus = "{modulus}"\npoisson_ratio = 0.45\n'
        f"[regions.base]\nbelow = {{ axis = {axis!r}, fraction = {fraction} }}\n"
        f'[[constraints]]\nkind = "fixed"\nregion = "base"\n{acting}'
        f"[uncertainty]\nlevels = 2\n[sweep]\n{sweep}"
    )


def entries(run: Run, models: Iterable[str]) -> list[Entry]:
    """What the models of a run answer at full load."""
    found = []
    for case in run.cases:
        for name in (model for model in models if model in case.models):
            result, series = case.models[name], case.metrics.get(name, {}).get(VECTOR)
            error = float(series.values[case.full_load]) if series is not None else np.nan
            found.append(
                Entry(
                    f"{run.study.study.name}: {case.label}",
                    name,
                    error,
                    value_bar(case, name, VECTOR),
                    float(result.seconds_per_step[case.full_load]),
                    result.seconds_setup,
                )
            )
    return found


def of(found: Sequence[Entry], model: str) -> list[Entry]:
    """The entries of a model."""
    return [entry for entry in found if entry.model == model]


def middle_of(own: Sequence[Entry]) -> Entry | None:
    """Of the cases that have an answer the one with the median error, of two the better; None where all failed."""
    answered = sorted((entry for entry in own if not entry.failed), key=lambda entry: entry.error)
    return answered[(len(answered) - 1) // 2] if answered else None


def within(own: Sequence[Entry], limit: float) -> tuple[float, float]:
    """Shares of all cases within a limit surely, with the bar, and as measured; failures are in neither."""
    sure = [not entry.failed and entry.error + entry.bar <= limit for entry in own]
    measured = [not entry.failed and entry.error <= limit for entry in own]
    return float(np.mean(sure)), float(np.mean(measured))


def ranked(found: Sequence[Entry]) -> list[str]:
    """Models by the share of cases within 10 %, then by their median error."""
    names = list(dict.fromkeys(entry.model for entry in found))

    def key(model: str) -> tuple[float, float]:
        own = of(found, model)
        middle = middle_of(own)
        return -within(own, ALLOWED)[1], middle.error if middle else np.inf

    return sorted(names, key=key)


def table(found: Sequence[Entry]) -> str:
    """A line for each model, the best first."""
    head = [
        "model",
        "cases",
        "failed",
        "median error",
        "worst",
        *(f"within {short_percent(x)}" for x in LIMITS),
    ]
    rows = []
    for model in ranked(found):
        own = of(found, model)
        answered, middle = [entry for entry in own if not entry.failed], middle_of(own)
        shares = []
        for limit in LIMITS:
            sure, measured = within(own, limit)
            shares.append(f"{100 * measured:.0f} % ({100 * sure:.0f} % surely)")
        rows.append(
            [
                model,
                str(len(own)),
                str(sum(entry.failed for entry in own)),
                f"{percent(middle.error)} ± {100 * middle.bar:.2g} %" if middle else NOTHING,
                percent(max(entry.error for entry in answered)) if answered else NOTHING,
                *shares,
                *(
                    quantity(_median([getattr(entry, cost) for entry in answered]), "s")
                    if answered
                    else NOTHING
                    for cost in ("frame", "setup")
                ),
            ]
        )
    return marked.table([*head, "frame", "set-up"], rows)


def accuracy_profile(own: Sequence[Entry], limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of all cases with an error of at most each limit."""
    errors = np.array([np.inf if entry.failed else entry.error for entry in own])
    return (errors[:, None] <= limits).mean(axis=0)


def time_profile(found: Sequence[Entry], model: str, factors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Dolan and More's performance profile of the time of a frame, of models within `ALLOWED`: share of the cases
    that some model solves in which this one takes at most so many times as long as the quickest."""
    best: dict[str, float] = {}
    for entry in found:
        if entry.error <= ALLOWED:
            best[entry.case] = min(best.get(entry.case, np.inf), entry.frame)
    ratios = [
        entry.frame / best[entry.case] if entry.error <= ALLOWED else np.inf
        for entry in of(found, model)
        if entry.case in best
    ]
    return (np.array(ratios)[:, None] <= factors).mean(axis=0)


def picture(found: Sequence[Entry]) -> str:
    """Error against the time of a frame, and the two profiles, for light and dark."""
    models = ranked(found)
    numbers = palette.places(models)
    drawn = []
    plot = Plot("time of a frame", "displacement error", "league-0")
    with plot as axes:
        for model in models:
            own, k = [entry for entry in of(found, model) if not entry.failed], numbers[model]
            middle = middle_of(own)
            if middle is None:
                continue
            times, errors = ([getattr(entry, what) for entry in own] for what in ("frame", "error"))
            x, y = _median(times), middle.error
            axes.plot(np.percentile(times, [25, 75]), [y, y], color=colour(k), linewidth=1.0)
            axes.plot([x, x], np.percentile(errors, [25, 75]), color=colour(k), linewidth=1.0)
            (point,) = axes.plot(
                [x], [y], marker=marker(k), color=colour(k), linestyle="none", markersize=6.5
            )
            tell(point, model)
        time_ticks(axes)
        percent_axis(axes, [entry.error for entry in found])
    drawn.append(("median and middle half of the cases", plot.drawn("Time of a frame against error.")))
    limits, factors = np.geomspace(0.005, 1.0, 200), np.geomspace(1.0, 1e4, 200)
    for k, (title, label, x, curve) in enumerate(
        (
            ("share of cases within an error", "displacement error", limits, None),
            (
                f"at most so many times the quickest, within {short_percent(ALLOWED)}",
                "factor",
                factors,
                found,
            ),
        )
    ):
        plot = Plot(label, "share of cases", f"league-{k + 1}")
        with plot as axes:
            for model in models:
                y = accuracy_profile(of(found, model), x) if curve is None else time_profile(found, model, x)
                (drawn_line,) = axes.plot(x, y, line(numbers[model]), color=colour(numbers[model]))
                tell(drawn_line, model)
            log_axis(axes, "x")
            percent_axis(axes, [1.0])
            axes.set_ylim(0.0, 1.02)
        drawn.append((title, plot.drawn(f"Profiles: {title}.")))
    return panels(drawn, {model: numbers[model] for model in models}, "League table of models and engines")


def _median(values: Sequence[float]) -> float:
    kept = [value for value in values if np.isfinite(value)]
    return float(np.median(kept)) if kept else np.inf


def section(found: Sequence[Entry], left_out: Sequence[str]) -> str:
    """The machine, the settings and the table as Markdown."""
    engines = [f"{wheel} {version(wheel)}" for wheel in ("mujoco", "ngsolve") if find_spec(wheel)]
    lines = [
        f"{processor_name()}, {usable_processors()} cores, one thread, one case at a time, "
        f"load average {os.getloadavg()[0]:.1f}; Python "
        f"{platform.python_version()}{''.join(f', {engine}' for engine in engines)}. "
        f"{len({entry.case for entry in found})} cases.",
        *(f"Not here: {name}, which is not installed: pip install ./docs/examples." for name in left_out),
    ]
    return "\n".join(
        [
            " ".join(lines),
            "",
            table(found),
            "![Share of cases within an error, and within a multiple of the quickest time](../gallery/league.svg)",
            "",
        ]
    )


def main() -> None:
    """Run what is missing, and write the page and its figure."""
    left_out = [name for name in MODELS if split(name)[0] not in all_models()]
    models = [name for name in MODELS if name not in left_out]
    found: list[Entry] = []
    studies = ROOT / "build" / "league"
    studies.mkdir(parents=True, exist_ok=True)
    for body in BODIES:
        for load in LOADS:
            path = studies / f"{body}-{load}.toml"
            path.write_text(study_text(body, load, models), encoding="utf-8")
            out = RUNS / f"league-{body}-{load}"
            finished("run", path, "--out", out, "--jobs", "1")
            found += entries(read_run(out), models)
    (GALLERY / "league.svg").write_text(picture(found), encoding="utf-8")
    marked.show(DOCUMENT, PART, section(found, left_out))


if __name__ == "__main__":
    main()
