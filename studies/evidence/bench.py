"""Run time against error: every model on the same meshes, measured in turns inside one process.

In a round every model is set up anew and answers the same two loads: pressure on the study's contact region, and
one over the whole free surface. Rounds are repeated, so that what else the machine does weighs on all models, and
ratios are taken inside a round. What takes no longer than 20 ms is repeated: see
`vdmbench.evidence.timing`.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_info

from solver_common.arrays import Array

from .. import models
from ..body.mesh_cache import mesh_from_cache
from ..body.refine import refined
from ..body.surface_measures import Surface
from ..machine.processors import usable_processors
from ..measures.metrics import DEFORMATION, VECTOR, History, evaluate
from ..measures.reference import (
    FailedReferenceError,
    level_scene,
    own_error,
    require_converged,
    restricted,
)
from ..scene.result import ModelResult
from ..scene.scene import Scene, build_scene
from ..study.config import expand, geometry_of, with_mesh_size
from ..study.errors import InputError
from ..study.schema import Study
from ..work.provenance import provenance
from .bench_data import LEAST_SIZES, TIMES, YARDSTICK, Bench, Entry, Growth
from .contact import Problem, contact_frame
from .growth import growths
from .timing import LONG, SAMPLES, calls_of_a_sample, median_of_samples, median_seconds

SIZES = (2.6, 2.0, 1.6, 1.3)  # mesh sizes over that of the study: four, for the exponents of growth
FINER = (1.3, 1.0, 0.7, 0.5)  # the same for the growth of the models below: some 300 to 1,900 nodes
GROWN = (
    "bem",
    "fem-coarse",
    "fem-linear",
    "fem",
)  # whose growth no sphere of the sparse forms shows
QUANTITIES = {"set-up": "s", "frame": "s", "memory": "B"}
LOADS = 20  # for which elements are set up there
ROUNDS = 5
BUDGET = 10.0  # seconds after which a model is measured no further on one mesh
FRAMES = np.array([0.5, 1.0])
MOST_CONDENSED = 150  # nodes up to which columns for the whole surface are worth their making
# what a result's parameters tell that does not depend on the machine
COUNTS = ("dofs", "tetrahedra", "columns", "matrix_bytes", "coarse_tetrahedra")


@dataclass
class _Tally:
    """What one model has been measured to take so far."""

    times: list[dict[str, float]] = field(default_factory=list)  # of each round, by the names of `TIMES`
    peak: list[float] = field(default_factory=list)
    spent: float = 0.0
    result: ModelResult | None = None

    def series(self) -> dict[str, Array]:
        """The times as (R,) arrays."""
        return {name: np.array([times.get(name, np.nan) for times in self.times]) for name in TIMES}


def measure(
    bodies: Mapping[str, Study],
    cache: Path,
    *,
    names: Sequence[str] | None = None,
    sizes: Sequence[float] = SIZES,
    rounds: int = ROUNDS,
    large: bool = False,
    watch: Callable[[str], object],
) -> Bench:
    """Measure every model on the first case of each study, at several mesh sizes.

    Parameters
    ----------
    bodies : the studies by what their bodies are called
    names : the models; None for those of each study itself
    sizes : mesh sizes over that of the study, the coarsest first; one that the body, a region or the reference
        does not stand is left out, and where none is left the study's own is measured
    large : growth on surfaces of up to 163,842 nodes, and of elements and the boundary form on up to some 2,000
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
        mesh = mesh_from_cache(geometry_of(study), cache)
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
    watch("measuring growth")
    machine = _machine(about, rounds)
    if left_out:
        machine["left out"] = "; ".join(left_out)
    known = {entry.model for entry in entries}
    grown = growths(rounds, known, large=large)
    if large:
        grown += _finer_growths(next(iter(bodies.values())), known.intersection(GROWN), cache, rounds, watch)
    return Bench(machine, entries, grown)


def _finer_growths(
    given: Study, names: Collection[str], cache: Path, rounds: int, watch: Callable[[str], object]
) -> list[Growth]:
    """Set-up, one load over all nodes and memory of models on meshes too fine for a reference of their own."""
    case = expand(given)[0].study
    nodes: list[int] = []
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in sorted(names)}
    for study in filter(None, (with_mesh_size(case, size) for size in FINER)):
        try:
            scene = build_scene(study, mesh_from_cache(geometry_of(study), cache))
        except InputError as error:  # finer than its author wrote
            watch(f"no growth on finer meshes: {error}")
            return []
        one = dataclasses.replace(scene, load_factors=np.ones(1), condition=False)
        everywhere = dataclasses.replace(one, facet_pressure=_pressure_everywhere(one))
        nodes.append(len(scene.fixed))
        for name, costs in found.items():
            costs.append(_costs(everywhere, name, rounds))
    out = []
    for name, costs in found.items():
        for (what, unit), values in zip(QUANTITIES.items(), np.array(costs).reshape(-1, 3).T, strict=True):
            if len(nodes) >= LEAST_SIZES and (values > 0.0).all():  # NaN of a model that could not be set up
                out.append(Growth(f"{name} {what}", unit, np.array(nodes, dtype=float), values))
    return out


def _costs(scene: Scene, name: str, rounds: int) -> tuple[float, float, float]:
    """Medians of set-up [s], frame [s] and memory [B] over rounds, as many of them as half of `BUDGET` allows."""
    loads = [scene.load(1.0)]
    if models.superposes(name) and models.find(name)[0].volumetric:
        # for one load alone they may iterate; frames are answered by a factor
        amounts = np.random.default_rng(0).random((LOADS, *scene.facet_pressure.shape))
        loads += [
            dataclasses.replace(scene, facet_pressure=scene.facet_pressure * part).load(1.0)
            for part in amounts
        ]
    measured: list[tuple[float, float, float]] = []
    start = time.perf_counter()
    for _ in range(rounds):
        if measured and time.perf_counter() - start > 0.5 * BUDGET:
            break
        gc.collect()
        prepared = models.Prepared(scene, name, len(loads))
        result = prepared.answer(loads)
        frame = float(result.seconds_per_step[0]) if loads[1:] else _frame(scene, prepared, result)
        measured.append((result.seconds_setup, frame, float(result.peak_bytes)))
    setup, frame, peak = np.median(measured, axis=0).tolist()
    return setup, frame, peak


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
    contact = dataclasses.replace(scene, load_factors=FRAMES, condition=False)
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles, scene.contact)
    own = models.run_model(contact, YARDSTICK)
    require_converged(YARDSTICK, own)
    finer = refined(scene.mesh, 1)
    finest = restricted(models.run_model(level_scene(_with_history(study), finer), YARDSTICK), finer)
    require_converged(f"{YARDSTICK} on the refined mesh", finest)
    bars = own_error(surface, [finest, own], FRAMES)
    reference = History(finest.displacement, finest.reaction_force, FRAMES)
    everywhere = dataclasses.replace(contact, facet_pressure=_pressure_everywhere(scene))
    tallies = {name: _Tally() for name in names}
    for _ in range(rounds):
        for name, tally in tallies.items():
            if tally.spent < BUDGET:
                start = time.perf_counter()
                _once(contact, everywhere, name, tally)
                tally.spent += time.perf_counter() - start
            else:
                tally.times.append({})
    yard = tallies.get(YARDSTICK)
    return [
        _entry(name, tally, yard, scene, body, surface, reference, bars["gci:relative_l2_displacement_error"])
        for name, tally in tallies.items()
    ]


def _with_history(study: Study) -> Study:
    """The study with the benchmark's two loads: what a scene on a refined mesh is built from."""
    load = study.load.model_copy(update={"factors": tuple(FRAMES.tolist()), "steps": None})
    return study.model_copy(update={"load": load})


def _pressure_everywhere(scene: Scene) -> Array:
    """(F, Q) pressure on every facet without a held node, growing with height: uniform, it would move nothing."""
    triangles, z = scene.mesh.triangles, scene.mesh.surface_points[:, 2]
    height = (z - z.min()) / max(float(np.ptp(z)), np.finfo(float).tiny)
    free = ~scene.held[triangles].any(axis=1)
    largest = float(scene.facet_pressure.max()) or 1.0
    facet: Array = 0.1 * largest * np.where(free, height[triangles].mean(axis=1), 0.0)
    return np.repeat(facet[:, None], scene.facet_pressure.shape[1], axis=1)


def _once(contact: Scene, everywhere: Scene, name: str, tally: _Tally) -> None:
    """One round of one model: a new set-up, both loads, and the short way for a contact where there is one."""
    gc.collect()
    prepared = models.Prepared(contact, name, len(contact.load_factors))
    result = prepared.answer(contact.loads)
    tally.peak.append(float(result.peak_bytes))
    direct, everything = _frame(contact, prepared, result), np.nan
    if name != "fem-condensed":
        everything = _frame(everywhere, prepared, prepared.answer(everywhere.loads))
    elif len(contact.fixed) <= MOST_CONDENSED:  # to another contact it is condensed anew
        other = models.Prepared(everywhere, name, len(everywhere.load_factors))
        everything = _frame(everywhere, other, other.answer(everywhere.loads))
    columns, product = np.nan, np.inf
    problem = prepared.set_up.problem if prepared.set_up is not None else None
    if problem is not None and result.status[0].ok and models.superposes(name):
        columns, product = _by_columns(problem, contact)
    tally.times.append(
        {
            "setup": result.seconds_setup,
            "frame_all": everything,
            "frame_local": min(direct, product),
            "columns": columns if product < direct else np.nan,
            "recut": result.seconds_setup + direct,
        }
    )
    tally.result = result


def _by_columns(problem: Problem, contact: Scene) -> tuple[float, float]:
    """Seconds that the columns of the contact nodes take, and of a frame by them."""
    pressure = contact.contact_pressure[contact.contact]
    start = time.perf_counter()
    frame = partial(contact_frame(problem, contact), pressure)
    frame()
    frame()  # shortens the columns
    return time.perf_counter() - start, median_seconds(frame)


def _frame(scene: Scene, prepared: models.Prepared, result: ModelResult) -> float:
    """Median seconds of a load step, solved again and again where one is short."""
    once = float(result.seconds_per_step.min())  # the least: one that had to wait tells nothing of the others
    if not once < LONG:  # NaN of a model that could not be set up, too
        return float(np.median(result.seconds_per_step))
    loads = scene.loads
    calls = math.ceil(SAMPLES * calls_of_a_sample(once) / len(loads))
    steps = [prepared.answer(loads).seconds_per_step for _ in range(calls)]
    return median_of_samples(np.concatenate(steps))


def _entry(
    name: str,
    tally: _Tally,
    yard: _Tally | None,
    scene: Scene,
    body: str,
    surface: Surface,
    reference: History,
    bar: float,
) -> Entry:
    result = tally.result
    if result is None:
        raise ValueError("a benchmark needs one round or more")
    failed = [status for status in result.status if not status.ok]
    errors = {}
    if not failed:
        found = evaluate(surface, History(result.displacement, result.reaction_force, FRAMES), reference)
        errors = {metric: float(values[-1]) for metric, values in found.items()}
    times, yardstick = tally.series(), (yard or _Tally([{}] * len(tally.times))).series()
    counts = {key: float(result.parameters[key]) for key in COUNTS if key in result.parameters}
    return Entry(
        body=body,
        model=name,
        nodes=len(scene.fixed),
        tetrahedra=len(scene.mesh.tetrahedra),
        **times,
        ratio_setup=times["setup"] / yardstick["setup"],
        ratio_frame=times["frame_local"] / yardstick["frame_local"],
        peak_bytes=float(np.median(tally.peak)),
        error=errors.get(VECTOR, np.nan),
        deformation_error=errors.get(DEFORMATION, np.nan),
        bar=bar,
        iterations=float(result.iterations[-1]),
        counts=counts,
        status=failed[0].message if failed else "converged",
    )
