"""Writes what `vdm` costs on this machine to `vdm/README.md`. Nothing here is asserted.

All times are processor time of the one thread that works, which other work on the machine makes longer by what it
takes of caches and memory only.

The bound of a set-up and of a step is the time that two readings of the factor take: of an array of the
factor's size, 8 bytes a non-zero, indices not counted, so that a factor that fits into a cache is held against
the cache. cholespy does not tell its non-zeros; they are those of SuperLU's symmetric minimum degree ordering,
an upper bound as long as cholespy's ordering is no worse. The paper, the consistent and the vector form of one
body have the same scalar factor, and its two readings are the bound of iterations and nonlinear steps too,
which need many. That of a local contact is one reading of its columns, that of the boundary form one of half
its dense inverse, above 1,000 nodes two of half its factor, of the sparse form one of half the coarse inverse.

A set-up goes from points, triangles and a tissue to the factor: checks, the rule for the parameters, assembly.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from threadpoolctl import threadpool_info

from solver_common.arrays import Array, Index, Mask
from tests.vdm.vdm_shapes import icosphere, torus
from tools import marked
from vdm import FORMULATIONS, Load, Model, Parameters, SurfaceMesh
from vdm.peers.bem import INVERTED, BoundaryFormulation
from vdm.problem import Problem, Step
from vdm.solvers.cholesky import Cholesky
from vdm.solvers.compliance import ContactCompliance
from vdm.solvers.krylov import KrylovSolver, Method
from vdm.solvers.linear import LinearSolver
from vdmbench.machine.memory import peak_bytes_since, reset_peak
from vdmbench.machine.processors import processor_name

RADIUS = 0.05
BYTES_PER_NONZERO = 8
MEMORY_BYTES = 256_000_000  # far beyond any cache
HEAD = ("what", "nodes", "median", "over the bound")
README = Path(__file__).parents[1] / "vdm" / "README.md"
PART = "speed"


@dataclass(frozen=True)
class Sizes:
    """What is measured, and how often: smaller sizes make a trial of the benchmark itself."""

    levels: int = 5  # of the icosphere: 10,242 nodes
    fine_levels: int = 7  # 163,842 nodes
    tori: tuple[tuple[int, int], ...] = ((40, 25), (50, 40))  # 1,000 and 2,000 nodes
    contact: int = 50
    repeats: int = 101
    slow_repeats: int = 3


Row = tuple[str, str, str, str]


def row(what: str, nodes: int, seconds: Array, bound: float) -> Row:
    """A line of the table, of the seconds of each repeat and of the bound."""
    median = float(np.median(seconds))
    shown = f"{median:.3g} s" if median >= 1.0 else f"{1e3 * median:.3g} ms"
    return what, f"{nodes:,}", shown, f"{median / bound:.3g}"


def timed(function: Callable[[], object], repeats: int) -> Array:
    """Seconds of each of `repeats` calls, after one that warms up."""
    function()
    return np.array([timed_once(function) for _ in range(repeats)])


def timed_once(function: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.thread_time()
    function()
    return time.thread_time() - start


def reading_seconds(n_bytes: int, repeats: int) -> float:
    """Median time of reading an array of this size once."""
    array = np.ones(max(n_bytes // 8, 1))
    return float(np.median(timed(lambda: array @ array, repeats)))


def copy_bandwidth() -> float:
    """Bytes read and written per second while memory far beyond the caches is copied."""
    source = np.ones(MEMORY_BYTES // 8)
    target = np.empty_like(source)
    return float(2 * MEMORY_BYTES / np.median(timed(lambda: np.copyto(target, source), 7)))


def ball(formulation: str, levels: int, solver: str = "linear") -> Model:
    """A ball of 10 * 4^levels + 2 nodes with its lowest cap held."""
    return set_up_on(*icosphere(levels, (RADIUS, RADIUS, RADIUS)), formulation, solver)


def set_up_on(points: Array, triangles: Index, formulation: str, solver: str = "linear") -> Model:
    """The model of a surface whose lowest part is held."""
    fixed = points[:, 2] < 0.9 * points[:, 2].min()
    parameters = partial(tissue, formulation=formulation, held=fixed)
    return Model(points, triangles, parameters, formulation=formulation, fixed=fixed, solver=solver)


def tissue(surface: SurfaceMesh, formulation: str, held: Mask) -> Parameters:
    """The rule for the parameters, as a study uses it."""
    return Parameters.from_tissue(5000.0, surface, formulation, held=held)


def two_readings(model: Model, repeats: int) -> float:
    """Seconds of two readings of the model's scalar factor."""
    return 2.0 * reading_seconds(BYTES_PER_NONZERO * non_zeros(model), repeats)


def linear_rows(formulation: str, sizes: Sizes, levels: int, repeats: int) -> Iterator[Row]:
    """Set-up with its memory, every node loaded, and the triangular solves in it."""
    points, triangles = icosphere(levels, (RADIUS, RADIUS, RADIUS))
    ball(formulation, 2)  # what is loaded on first use is not the model's
    before = reset_peak()
    model = set_up_on(points, triangles, formulation)
    peak = peak_bytes_since(before) / 1e9
    solver = model.solver
    assert isinstance(solver, LinearSolver)
    nodes, free = model.surface.n_nodes, model.problem.free
    block = sparse.csr_array(factored(model))  # the vector form's three components share one
    load = Load(100.0 * np.random.default_rng(0).random(nodes))
    right = np.random.default_rng(1).standard_normal((int(free.sum()) * model.formulation.components,))
    bound, slow = two_readings(model, repeats), sizes.slow_repeats

    def asked() -> object:
        step = solver.step(load)
        return step.reaction_force, step.energy

    steps = [solver.step(load) for _ in range(repeats)]  # an audit is of a new step
    for what, seconds in (
        (
            f"set-up, {peak:.3f} GB at its peak",
            timed(partial(set_up_on, points, triangles, formulation), slow),
        ),
        ("of it one factor", timed(partial(Cholesky, block), slow)),
        (
            "of it the rule for the parameters",
            timed(partial(tissue, model.surface, formulation, ~free), slow),
        ),
        ("linear step, every node loaded", timed(partial(solver.step, load), repeats)),
        ("the same with reactions and energy", timed(asked, repeats)),
        ("audit of the step", np.array([timed_once(partial(solver.audited, load, step)) for step in steps])),
        ("its triangular solves", timed(partial(solver.factor.block.solve, right), repeats)),
    ):
        yield row(f"{what}, {formulation}", nodes, seconds, bound)


def contact_rows(model: Model, sizes: Sizes) -> Iterator[Row]:
    """A local contact that stays where it is: all displacements, from the columns of its nodes."""
    nodes = np.argsort(-model.surface.points[:, 2])[: sizes.contact]
    pressure = 100.0 * np.random.default_rng(2).random(len(nodes))
    assert isinstance(model.solver, LinearSolver)
    for single in (False, True):
        contact = ContactCompliance(model.problem, model.solver, single_precision=single)
        frame = partial(contact.frame, nodes, pressure)
        frame()
        seconds = timed(frame, 5 * sizes.repeats)
        bound = reading_seconds(contact.prepare(nodes).nbytes, sizes.repeats)
        precision = "single" if single else "double"
        what = f"local contact of {len(nodes)} nodes, {model.formulation.name}, {precision} precision"
        yield row(what, model.surface.n_nodes, seconds, bound)


def krylov_rows(sizes: Sizes) -> Iterator[Row]:
    """One load by iteration from zero: fibres of contrast 3, with the diagonal and with the factor without them."""
    methods: tuple[Method, ...] = ("cg", "minres")
    bound = two_readings(ball("consistent", sizes.levels), sizes.repeats)
    for formulation in ("consistent", "vector"):
        plain = ball(formulation, sizes.levels)
        surface, free = plain.surface, plain.problem.free
        fibres = plain.formulation.parameters.anisotropic(surface, (0.0, 1.0, 0.0), 3.0)
        changed = Problem(FORMULATIONS[formulation](surface, fibres), plain.problem.support)
        load = Load(np.where(surface.points[:, 2] > 0.9 * RADIUS, 100.0, 0.0))
        for method in methods:
            for name, factor in (("diagonal", None), ("factor at rest", plain.formulation.factor(free))):
                solver = KrylovSolver(changed, method, factor=factor)
                seconds = timed(partial(solver.step, load), sizes.slow_repeats)
                count = solver.step(load).iterations
                what = f"{method} by the {name}, {count} iterations, fibres added, {formulation}"
                yield row(what, surface.n_nodes, seconds, bound)


def history_rows(sizes: Sizes) -> Iterator[Row]:
    """Steps of a load that grows by a twentieth each, once the history has begun, and their mean iterations."""
    bound = two_readings(ball("consistent", sizes.levels), sizes.repeats)
    for formulation, solver, what in (
        ("paper", "bicg", "BiCG as printed, warm"),
        ("paper", "bicg-cold", "BiCG as printed, cold"),
        ("paper", "quasi-linear", "quasi-linear step"),
        ("consistent", "quasi-linear", "quasi-linear step"),
        ("vector", "quasi-linear", "quasi-linear step"),
        ("consistent", "nonlinear", "warm nonlinear step"),
        ("vector", "nonlinear", "warm nonlinear step"),
    ):
        model = ball(formulation, sizes.levels, solver)
        load = Load(np.where(model.surface.points[:, 2] > 0.9 * RADIUS, 100.0, 0.0))
        step: Step | None = None
        seconds, iterations = [], []
        for k in range(3 + sizes.slow_repeats * 4):
            start = time.thread_time()
            step = model.solver.step(load.scaled(1.0 + 0.05 * k), step)
            seconds.append(time.thread_time() - start)
            iterations.append(step.iterations)
        mean = np.mean(iterations[3:])
        counted = f", {mean:.3g} iterations" if mean else ""
        yield row(f"{what}{counted}, {formulation}", model.surface.n_nodes, np.array(seconds[3:]), bound)


def boundary_rows(sizes: Sizes) -> Iterator[Row]:
    """The dense form on tori, the sparse form on a ball."""
    for n, m in sizes.tori:
        yield from rows_of_integrals("bem", sizes, *torus(n=n, m=m))
    yield from rows_of_integrals("bem-sparse", sizes, *icosphere(sizes.levels, (RADIUS, RADIUS, RADIUS)))


def rows_of_integrals(formulation: str, sizes: Sizes, points: Array, triangles: Index) -> Iterator[Row]:
    """Set-up with its memory and frames of a form of boundary integrals."""
    ball(formulation, 2)  # compiles what is compiled at its first call
    before = reset_peak()
    model = set_up_on(points, triangles, formulation)
    peak = peak_bytes_since(before) / 1e9
    again = partial(set_up_on, points, triangles, formulation)
    seconds = np.array([timed_once(again) for _ in range(sizes.slow_repeats)])
    form = model.formulation
    assert isinstance(form, BoundaryFormulation)
    # of a matrix one half is read: of an inverse once, of a factor twice
    size = 3 * form.n_coarse
    readings = 1 if formulation == "bem-sparse" or size <= INVERTED else 2
    bound = readings * reading_seconds(BYTES_PER_NONZERO * size * size // 2, sizes.repeats)
    load = Load(100.0 * np.random.default_rng(3).random(len(points)))
    frame = timed(partial(model.solver.step, load), sizes.repeats)
    what = f"set-up, {peak:.2f} GB at its peak"
    for name, taken in ((what, seconds), ("linear step, every node loaded", frame)):
        yield row(f"{name}, {formulation}", len(points), taken, bound)
    yield from contact_rows(model, sizes)


def rows_of(sizes: Sizes) -> Iterator[Row]:
    """All lines of the table."""
    scalar = ("paper", "consistent", "vector")
    for formulation in scalar:
        yield from linear_rows(formulation, sizes, sizes.levels, sizes.repeats)
    for formulation in ("consistent", "vector"):
        yield from contact_rows(ball(formulation, sizes.levels), sizes)
    yield from krylov_rows(sizes)
    yield from history_rows(sizes)
    yield from boundary_rows(sizes)
    for formulation in scalar:
        yield from linear_rows(formulation, sizes, sizes.fine_levels, 3 * sizes.slow_repeats)


def machine() -> str:
    """What it is measured on, in two lines."""
    threads = {f"{info['internal_api']}: {info['num_threads']}" for info in threadpool_info()}
    load = f"{os.getloadavg()[1]:.1f} of {os.cpu_count()} processors busy in the five minutes before"
    return (
        f"{processor_name()}; threads: {', '.join(sorted(threads))}; {platform.platform()}.\n"
        f"Copying memory: {copy_bandwidth() / 1e9:.1f} GB/s read and written; {load}.\n\n"
    )


def non_zeros(model: Model) -> int:
    """Of one triangular factor of the matrix that a sparse model's solver factors, in minimum degree order."""
    options = {"SymmetricMode": True}
    block = factored(model)
    return linalg.splu(block, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).L.nnz


def factored(model: Model) -> sparse.csc_array:
    """That matrix: the vector form's three components share one."""
    form, free = model.formulation, model.problem.free
    matrix = form.tension if hasattr(form, "tension") else form.stiffness()
    return sparse.csc_array(matrix[free][:, free])


def main() -> None:
    """Print the table line by line, and write it to the README."""
    text, rows = machine(), []
    for found in rows_of(Sizes()):
        print(*found, sep=" | ", flush=True)
        rows.append(found)
    marked.show(README, PART, text + marked.table(HEAD, rows))


if __name__ == "__main__":
    main()
