"""The time of a frame: the one measurement behind the times of a run, of its verdict, and of a benchmark.

A frame is one load step of a model whose set-up is done and whose factors are kept. There are two kinds:

contact      a load on the fixed contact region, by the cheapest way that the model has. A model that is linear in
             the pressure multiplies by one column per contact node; this is the same for all such models
everywhere   a load over the whole free surface, by the model's own solve

All models take turns in rounds, so that other work on the machine slows all of them alike. Each round sets every
model up anew. Frames up to 20 ms are repeated, so that the clock's resolution and one interruption do not matter.
Beside the time of a frame is what the processor spent on it: by the share that it spent on the answers around it.
"""

from __future__ import annotations

import dataclasses
import gc
import math
import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from fem_reference.condensed import CondensedProblem
from fem_reference.linear import LinearProblem
from fem_reference.loads import Load
from solver_common.arrays import Array, Index
from solver_common.quadrature import facet_quadrature
from vdm.solvers.columns import ContactColumns, contact_columns
from vdm.solvers.linear import LinearSolver

from ..machine import processor_share
from ..scene.result import FrameTimes, ModelResult
from ..scene.scene import Scene, SurfaceLoad
from . import Prepared, superposes

SAMPLE = 1e-3  # least length of a sample [s]: far above the clock's resolution and the overhead of a call
SAMPLES = 5
LONG = 2e-2  # a step this long [s] needs no second sample in a round: interruptions are a small part of it
MOST = 0.5  # longest time of repeats [s]: an answer may take far longer than the steps that it times
FACTORS = np.array([0.5, 1.0])  # load factors of the steps that are measured
MANY = 1000  # loads that a set-up expects: with so many, elements keep factors instead of iterating

Problem = LinearSolver | LinearProblem | CondensedProblem
Frame = Callable[[Array], tuple[Array, float]]


def frame_times(
    scene: Scene,
    names: Sequence[str],
    rounds: int,
    budget: float,
    least: int = 1,
    limit: float = math.inf,
    begun: Callable[[str], None] = lambda _: None,
) -> dict[str, FrameTimes]:
    """Times of frames of several models on one scene, measured in turns.

    Parameters
    ----------
    rounds : most rounds of each model
    budget : seconds after which a model is measured no further, once it has `least` rounds. Rounds after that time
        leave out the frame everywhere
    limit : of a frame [s]; a model that one round shows to be clearly beyond it has no further one
    begun : called before each round with what it is
    """
    contact = dataclasses.replace(scene, load_factors=FACTORS, condition=False)
    taken: dict[str, list[tuple[float, ...]]] = {name: [] for name in names}
    found: dict[str, FrameTimes] = {}
    spent = dict.fromkeys(names, 0.0)
    gc.collect()
    gc.freeze()  # the collections of each round skip all objects that exist by now
    for number in range(rounds):
        for name in names:
            if name in found and found[name].is_clear(limit):
                continue
            start = time.perf_counter()
            is_over = spent[name] >= budget
            if not is_over or len(taken[name]) < least:
                begun(f"{name}, round {number + 1} of at most {rounds}")
                taken[name].append(one_round(contact, name, everywhere=not is_over))
                set_up, touch, everything, worked = np.array(taken[name]).T
                found[name] = FrameTimes(set_up, touch, everything, contact_worked=worked)
            spent[name] += time.perf_counter() - start
    return found


def one_round(contact: Scene, name: str, *, everywhere: bool = True) -> tuple[float, float, float, float]:
    """Seconds of a new set-up, of a frame of the contact by the cheapest way, of a frame everywhere, and of the
    processor for that of the contact.

    NaN for a frame that the model does not have, and for that everywhere if not asked for.
    """
    gc.collect()
    prepared = Prepared(contact, name, MANY)
    result, share = _answer(prepared, contact.loads)
    touch, everything = _frame(contact, prepared, result, share), math.nan
    if everywhere and not prepared.model.contact_in_setup:  # such a model needs a new set-up for other nodes
        loaded = dataclasses.replace(contact, facet_pressure=pressure_everywhere(contact))
        everything, _ = _frame(loaded, prepared, *_answer(prepared, loaded.loads))
    problem = prepared.set_up.problem if prepared.set_up is not None else None
    if problem is not None and result.status[0].ok and superposes(name) and _pressed_alone(contact):
        touch = min(touch, _by_columns(problem, contact))
    return result.seconds_setup, touch[0], everything, touch[1]


def pressure_everywhere(scene: Scene) -> Array:
    """(F, Q) pressure [Pa] on facets without held nodes; it grows with height, as a uniform one moves nothing."""
    triangles, z = scene.mesh.triangles, scene.mesh.surface_points[:, 2]
    height = (z - z.min()) / max(float(np.ptp(z)), np.finfo(float).tiny)
    free = ~scene.held[triangles].any(axis=1)
    largest = float(scene.facet_pressure.max()) or 1.0
    facet: Array = 0.1 * largest * np.where(free, height[triangles].mean(axis=1), 0.0)
    return np.repeat(facet[:, None], scene.facet_pressure.shape[1], axis=1)


def _pressed_alone(scene: Scene) -> bool:
    """Whether contact pressure is the only load, so that the answer is a sum of columns."""
    pressed = scene.contact_pressure[scene.contact]
    return (
        bool(pressed.size)
        and bool((pressed > 0.0).all())
        and not scene.gravity.any()
        and not scene.prescribed.any()
        and scene.indenter is None
    )


def _by_columns(problem: Problem, contact: Scene) -> tuple[float, float]:
    """`_frame` by the columns of the contact nodes; the time to make the columns is not counted."""
    frame = partial(contact_frame(problem, contact), contact.contact_pressure[contact.contact])
    frame()
    frame()  # the second call shortens the columns
    seconds = median_seconds(frame)
    return seconds, min(seconds, median_seconds(frame, time.process_time))


def _answer(prepared: Prepared, loads: Sequence[SurfaceLoad]) -> tuple[ModelResult, float]:
    """The result of some load steps, and the share of its time that the processor worked."""
    share = processor_share()
    return prepared.answer(loads), share()


def _frame(scene: Scene, prepared: Prepared, result: ModelResult, share: float) -> tuple[float, float]:
    """Median seconds of a load step, and of the processor for it; short steps are solved again and again.

    `result` and `share` are of a first answer.
    """
    once = float(result.seconds_per_step.min())  # the minimum: a step that was interrupted is not typical
    if not once > 0.0:  # also NaN, of a model that could not be set up
        return math.nan, math.nan
    if once >= LONG:
        seconds = float(np.median(result.seconds_per_step))
        return seconds, seconds * share
    loads, found, end = scene.loads, [], time.perf_counter() + MOST
    for _ in range(math.ceil(SAMPLES * calls_of_a_sample(once) / len(loads))):
        again, share = _answer(prepared, loads)
        found.append(np.outer((1.0, share), again.seconds_per_step))
        if time.perf_counter() > end:
            break
    every = np.concatenate(found, axis=1)  # enough for `SAMPLES` samples, each the mean of consecutive steps
    samples = [part.mean(axis=1) for part in np.array_split(every, min(SAMPLES, every.shape[1]), axis=1)]
    seconds, worked = np.median(samples, axis=0).tolist()
    return seconds, worked


# --- one frame of a resting contact ---


def contact_frame(problem: Problem, scene: Scene) -> Frame:
    """Frames on the scene's contact nodes: pressures (k,) [Pa] -> displacement (N, 3) [m], fluid pressure [Pa].

    There is one column per contact node, in single precision: the answer to the node's share of the contact, at
    unit nodal pressure. The shares are those of the contact's nodal forces. So under the scene's own nodal
    pressures, a frame is the model's answer to the scene's contact. Nothing else may load the body: no weight, and
    no held node that moves.
    """
    nodes = np.flatnonzero(scene.contact)
    if not isinstance(problem, LinearSolver):
        columns = _element_columns(problem, scene, nodes)
        return ContactColumns(columns, scene.mesh.surface_points, nodes).frame
    push = scene.contact_force / np.where(scene.contact, scene.contact_pressure, 1.0)[:, None]
    prepared = contact_columns(problem, nodes, push)

    def frame(pressure: Array) -> tuple[Array, float]:
        unknown, fluid_pressure = prepared.frame(pressure)
        return problem.problem.formulation.displacement(unknown), fluid_pressure

    return frame


def _element_columns(problem: LinearProblem | CondensedProblem, scene: Scene, nodes: Index) -> Array:
    """(3 N + 1, k) columns: surface displacement [m], all x, then all y, then all z; mean pressure [Pa]."""
    corners, _ = facet_quadrature()
    still, weightless = np.zeros_like(scene.prescribed), np.zeros(3)
    loads = [
        Load(
            scene.facet_pressure * ((scene.mesh.triangles == node) @ corners.T) / pressure, still, weightless
        )
        for node, pressure in zip(nodes, scene.contact_pressure[nodes], strict=True)
    ]
    solution = problem.solve(loads)
    displacement = solution.displacement.transpose(2, 1, 0).reshape(-1, len(nodes))
    return np.concatenate([displacement, solution.fluid_pressure[None]])


# --- calls too short for one reading of the clock ---


def median_seconds(call: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Median seconds by a clock: of `SAMPLES` samples, each the mean of enough calls to take `SAMPLE` or longer."""
    timer = timeit.Timer(call, timer=clock)
    number = calls_of_a_sample(min(timer.repeat(SAMPLES, 1)))
    return float(np.median(timer.repeat(SAMPLES, number))) / number


def calls_of_a_sample(seconds: float) -> int:
    """How many calls take `SAMPLE` or longer in all; `seconds` is the minimum of several calls."""
    return max(1, math.ceil(SAMPLE / max(seconds, 1e-9)))


def growth_exponent(nodes: Array, seconds: Array) -> float:
    """Exponent of a cost: slope of the least-squares line through log seconds (k,) over log node counts (k,)."""
    return float(np.polyfit(np.log(nodes), np.log(seconds), 1)[0])
