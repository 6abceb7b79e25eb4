"""Run time against error: every model on the same meshes, measured in turns inside one process.

In: studies. Out: what every model takes and how far it is off on several mesh sizes, as JSON and as a table.

In a round every model is set up anew and answers the same two loads: pressure on the study's contact region, and
one over the whole free surface. Rounds are repeated, so that what else the machine does weighs on all models, and
ratios are taken inside a round: see `vdmbench.models.frames`, which a run's times come from too.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from solver_common.arrays import Array

from . import models
from .body.mesh_cache import mesh_from_cache
from .body.refine import refined
from .body.surface_measures import Surface
from .machine import json_text, usable_processors, write_atomically
from .measures.metrics import DEFORMATION, VECTOR, History, evaluate
from .measures.reference import FailedReferenceError, level_scene, own_error, require_converged, restricted
from .measures.uncertainty import is_resolved
from .models.frames import FACTORS, Round, in_turns
from .scene.scene import Scene, build_scene
from .store.plain import typed
from .study.config import expand, with_mesh_size
from .study.errors import InputError
from .study.schema import Study
from .verdict.digest import median_known
from .verdict.formatting import NOTHING, quantity, scale_of
from .work.provenance import provenance

# --- what was measured ---

TIMES = ("setup", "frame_all", "frame_local", "columns", "recut")  # (R,) of an entry [s]
YARDSTICK = "fem-linear"  # ratios are over its time in the same round


@dataclass(frozen=True)
class Entry:
    """One model on one mesh. Times are (R,) seconds, one per round; NaN where the model has no such thing.

    Attributes
    ----------
    body : name of the study
    nodes, tetrahedra : of the mesh that all models share
    setup : operators and factors of a new body, mesh given
    frame_all : one load over the whole free surface
    frame_local : one load on the study's contact region, by the cheapest way that the model has: where it is linear
        in the pressure, the product with one column per contact node, the same for all such models
    columns : what `frame_local` needs once per contact region, beyond the set-up
    recut : from a changed mesh to the first answer: set-up and a solve, without columns; no meshing
    ratio_setup, ratio_frame : of set-up and `frame_local` over those of `YARDSTICK` in the same round
    peak_bytes : resident memory that set-up and solve added at their peak
    error, deformation_error : relative L2 against the finest reference, of the contact load
    bar : that reference's own error (GCI)
    iterations : of the contact load
    counts : figures that do not depend on the machine, by name
    """

    body: str
    model: str
    nodes: int
    tetrahedra: int
    setup: Array
    frame_all: Array
    frame_local: Array
    columns: Array
    recut: Array
    ratio_setup: Array
    ratio_frame: Array
    peak_bytes: float
    error: float
    deformation_error: float
    bar: float
    iterations: float
    counts: Mapping[str, float] = field(default_factory=dict)
    status: str = "converged"


@dataclass(frozen=True)
class Bench:
    """A whole benchmark: the machine, every model on every mesh."""

    machine: Mapping[str, str]
    entries: Sequence[Entry]

    def meshes(self) -> list[tuple[str, int]]:
        """(body, nodes) of each mesh, in the order measured."""
        return list(dict.fromkeys((entry.body, entry.nodes) for entry in self.entries))

    def on(self, mesh: tuple[str, int]) -> list[Entry]:
        """The entries of one mesh."""
        return [entry for entry in self.entries if (entry.body, entry.nodes) == mesh]


def spread(values: Array) -> tuple[float, float]:
    """First and third quartile of what was measured."""
    known = values[np.isfinite(values)]
    first, third = np.quantile(known, (0.25, 0.75)).tolist() if known.size else (math.nan, math.nan)
    return first, third


def seconds(value: float) -> str:
    """A time with the unit that suits it."""
    if math.isnan(value):
        return NOTHING
    factor, unit = scale_of("s", [value])
    return f"{value / factor:.3g} {unit}"


def amount(value: float, unit: str) -> str:
    """A time, a size in memory or a number of non-zeros or operations."""
    if unit == "s":
        return seconds(value)
    return quantity(value, unit) if unit == "B" else f"{value / 1e6:.3g} million"


def error_text(e: Entry) -> str:
    """Error ± the reference's own, after a ~ where that is more than a tenth; the status of what has no answer."""
    if not math.isfinite(e.error):
        return e.status
    unresolved = "" if is_resolved(e.error, e.bar) else "~"
    return f"{unresolved}{100 * e.error:.3g} % ± {100 * e.bar:.2g} %"


def rows(bench: Bench) -> list[dict[str, str]]:
    """The printed table: column title -> text."""

    def timed(values: Array) -> str:
        low, high = spread(values)
        return f"{seconds(median_known(values))} [{seconds(low)}, {seconds(high)}]" if low == low else "–"

    return [
        {
            "model": e.model,
            "body": e.body,
            "nodes": f"{e.nodes:,}",
            "set-up": timed(e.setup),
            "frame, all nodes": timed(e.frame_all),
            "frame, contact": timed(e.frame_local),
            "columns": timed(e.columns),
            "re-cut": timed(e.recut),
            "set-up ratio": _ratio(e.ratio_setup),
            "frame ratio": _ratio(e.ratio_frame),
            "memory": amount(e.peak_bytes, "B"),
            "error": error_text(e),
        }
        for e in bench.entries
    ]


def _ratio(values: Array) -> str:
    """The median of the ratios of all rounds, and between which two they lie."""
    ratio, (low, high) = median_known(values), spread(values)
    return "–" if math.isnan(ratio) else f"{ratio:.2g} [{low:.2g}, {high:.2g}]"


def machine_independent(bench: Bench) -> dict[str, float]:
    """Every figure that another machine must find too, by name."""
    out: dict[str, float] = {}
    for e in bench.entries:
        at = f"{e.body}/{e.nodes}/{e.model}"
        if math.isfinite(e.error):
            out |= {f"{at}/error": e.error, f"{at}/deformation_error": e.deformation_error}
        out[f"{at}/iterations"] = e.iterations
        out |= {f"{at}/{name}": value for name, value in e.counts.items()}
    return out


# --- measuring ---

SIZES = (2.6, 2.0, 1.6, 1.3)  # mesh sizes over that of the study
ROUNDS = 5
BUDGET = 10.0  # seconds after which a model is measured no further on one mesh
# what a result's parameters tell that does not depend on the machine
COUNTS = ("dofs", "tetrahedra", "columns", "matrix_bytes", "coarse_tetrahedra")


def measure(
    bodies: Mapping[str, Study],
    cache: Path,
    *,
    names: Sequence[str] | None = None,
    sizes: Sequence[float] = SIZES,
    rounds: int = ROUNDS,
    watch: Callable[[str], object],
) -> Bench:
    """Measure every model on the first case of each study, at several mesh sizes.

    Parameters
    ----------
    bodies : the studies by what their bodies are called
    names : the models; None for those of each study itself
    sizes : mesh sizes over that of the study, the coarsest first; one that the body, a region or the reference
        does not stand is left out, and where none is left the study's own is measured
    watch : told what is measured, and what is left out and why

    Raises
    ------
    ValueError
        InputError or FailedReferenceError of a study whose mesh or reference cannot be made.
    """
    entries: list[Entry] = []
    about: dict[str, str] = {}
    left_out: list[str] = []

    def measured(body: str, study: Study, place: str = "") -> list[Entry]:
        mesh = mesh_from_cache(study.geometry, cache)
        if not about:
            about.update(provenance(mesh))
        watch(f"measuring {body}, {len(mesh.surface_nodes)} nodes{place}")
        scene = build_scene(study, mesh)
        return _on_mesh(body, study, scene, names or study.study.models, rounds)

    for number, (body, given) in enumerate(bodies.items()):
        case = expand(given)[0].study
        found: list[Entry] = []
        for k, size in enumerate(sizes, start=number * len(sizes) + 1):
            study = with_mesh_size(case, size)
            if study is None:  # a mesh of its own, of one size
                break
            try:
                found += measured(body, study, f", mesh {k} of {len(bodies) * len(sizes)}")
            except (
                InputError,
                FailedReferenceError,
            ) as error:  # of a size that the study's author never wrote
                left_out.append(f"{body} at {size:g} times its mesh_size: {error}")
                watch(f"left out {left_out[-1]}")
        entries += found or measured(body, case)
    machine = _machine(about, rounds)
    if left_out:
        machine["left out"] = "; ".join(left_out)
    return Bench(machine, entries)


def _machine(about: dict[str, str], rounds: int) -> dict[str, str]:
    threads = sorted({f"{info['internal_api']} {info['num_threads']}" for info in threadpool_info()})
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    kept = {name: text for name, text in about.items() if name not in ("mesh_hash", "platform")}
    return {
        "processor": kept.pop("processor"),
        "cores": str(usable_processors()),
        "memory": f"{memory / 1e9:.1f} GB",
        "threads": ", ".join(threads),
        "rounds": str(rounds),
        **kept,
    }


def _on_mesh(body: str, study: Study, scene: Scene, names: Sequence[str], rounds: int) -> list[Entry]:
    """Every model on one mesh, each against linear elements on its refinement."""
    contact = dataclasses.replace(scene, load_factors=FACTORS, condition=False)
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles, scene.contact)
    own = models.run_model(contact, YARDSTICK)
    require_converged(YARDSTICK, own)
    finer = refined(scene.mesh, 1)
    load = study.load.model_copy(update={"factors": tuple(FACTORS.tolist()), "steps": None})
    fine = level_scene(study.model_copy(update={"load": load}), finer)
    finest = restricted(models.run_model(fine, YARDSTICK), finer)
    require_converged(f"{YARDSTICK} on the refined mesh", finest)
    bars = own_error(surface, [finest, own], FACTORS)
    reference = History(finest.displacement, finest.reaction_force, FACTORS)
    taken = in_turns(scene, names, rounds, BUDGET)
    yard = _series(taken.get(YARDSTICK, []), rounds)
    bar = bars["gci:relative_l2_displacement_error"]
    return [
        _entry(name, of_one, _series(of_one, rounds), yard, scene, body, surface, reference, bar)
        for name, of_one in taken.items()
    ]


def _series(taken: Sequence[Round], rounds: int) -> dict[str, Array]:
    """The times by the names of `TIMES`, (R,) of all rounds: NaN where a model had no more."""
    times = {
        "setup": [one.setup for one in taken],
        "frame_all": [one.everywhere for one in taken],
        "frame_local": [one.contact for one in taken],
        "columns": [one.columns for one in taken],
        "recut": [one.setup + one.direct for one in taken],
    }
    return {name: np.array([*found, *[np.nan] * (rounds - len(found))]) for name, found in times.items()}


def _entry(
    name: str,
    taken: Sequence[Round],
    times: Mapping[str, Array],
    yardstick: Mapping[str, Array],
    scene: Scene,
    body: str,
    surface: Surface,
    reference: History,
    bar: float,
) -> Entry:
    if not taken:
        raise ValueError("a benchmark needs one round or more")
    result = taken[-1].result
    failed = [status for status in result.status if not status.ok]
    errors = {}
    if not failed:
        found = evaluate(surface, History(result.displacement, result.reaction_force, FACTORS), reference)
        errors = {metric: float(values[-1]) for metric, values in found.items()}
    counts = {key: float(result.parameters[key]) for key in COUNTS if key in result.parameters}
    return Entry(
        body=body,
        model=name,
        nodes=len(scene.fixed),
        tetrahedra=len(scene.mesh.tetrahedra),
        **times,
        ratio_setup=times["setup"] / yardstick["setup"],
        ratio_frame=times["frame_local"] / yardstick["frame_local"],
        peak_bytes=float(np.median([one.result.peak_bytes for one in taken])),
        error=errors.get(VECTOR, np.nan),
        deformation_error=errors.get(DEFORMATION, np.nan),
        bar=bar,
        iterations=float(result.iterations[-1]),
        counts=counts,
        status=failed[0].message if failed else "converged",
    )


# --- on disk ---


def write_bench(path: Path, bench: Bench) -> None:
    """Write one JSON file, null for what was not measured. Raises OSError."""
    write_atomically(path, json_text(bench, indent=1).encode())


def read_bench(path: Path) -> Bench:
    """Read it back. Raises OSError, and ValueError where it is no benchmark's file."""
    try:
        return typed(Bench, json.loads(path.read_bytes()))
    except ValueError as error:
        raise ValueError(f"{path}: not a benchmark's file ({error}); run vdmbench bench again") from error


# --- what stands below the table ---

ERROR_NOTE = (
    "Every model answers the same contact load on the same mesh. Its error is the relative L2 difference from "
    "linear elements on the refined mesh, ± that reference's own; ~ where this is more than a tenth."
)
