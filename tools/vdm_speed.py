"""What `vdm` costs on this machine, as one Markdown table. Nothing here is asserted.

All times are processor time of the one thread that works, which other work on the machine makes longer by what it
takes of caches and memory only.

The bound of a set-up and of a step is the time that two readings of the factor take: of an array of the
factor's size, 8 bytes a non-zero, indices not counted, so that a factor that fits into a cache is held against
the cache. cholespy does not tell its non-zeros; they are those of SuperLU's symmetric minimum degree ordering,
an upper bound as long as cholespy's ordering is no worse. The paper, the consistent and the vector form of one
body have the same scalar factor, and its two readings are the bound of iterations and nonlinear steps too,
which need many. That of a local contact is one reading of its columns, that of the boundary form one of half
its dense inverse, above 1,000 nodes two of half its factor, of the sparse form one of half the coarse inverse.
Memory is set against what one factor more takes of the process, its indices and all; the last column is what its
library takes while it makes that factor. Of the boundary and the sparse form it is the most that the set-up takes.

A set-up goes from points, triangles and a tissue to the factor: checks, the rule for the parameters, assembly.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse import linalg
from threadpoolctl import threadpool_info

from solver_common.arrays import Array, Index, Mask
from tests.unit.vdm_shapes import icosphere, torus
from tools import marked
from vdm import FORMULATIONS, Load, Model, Parameters, SurfaceMesh
from vdm.formulations.boundary import INVERTED, BoundaryFormulation
from vdm.formulations.vector import VectorFormulation
from vdm.problem import Problem, Step
from vdm.solvers.cholesky import Cholesky
from vdm.solvers.compliance import ContactCompliance
from vdm.solvers.krylov import KrylovSolver, Method
from vdm.solvers.linear import LinearSolver
from vdmbench.machine.memory import peak_bytes_since, reset_peak

RADIUS = 0.05
BYTES_PER_NONZERO = 8
MEMORY_BYTES = 256_000_000  # far beyond any cache
HEAD = (
    "what",
    "nodes",
    "median",
    "10 % to 90 %",
    "over the bound",
    "SuperLU over it",
    "resident over factor",
    "peak over factor",
    "of it the factor's own making",
)


README_HEAD = ("what", "nodes", "median", "over the bound")
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


@dataclass(frozen=True)
class Row:
    """One line of the table: seconds of each repeat, and the ratios that make sense for it."""

    what: str
    nodes: int
    seconds: Array
    over_bound: float | None = None
    superlu: float | None = None
    resident: float | None = None
    peak: float | None = None
    library: float | None = None

    def cells(self) -> list[str]:
        """As text."""
        low, median, high = np.quantile(self.seconds, [0.1, 0.5, 0.9])
        numbers = (self.over_bound, self.superlu, self.resident, self.peak, self.library)
        ratios = ("" if number is None else f"{number:.3g}" for number in numbers)
        return [self.what, f"{self.nodes:,}", shown(median), f"{shown(low)} to {shown(high)}", *ratios]


def shown(seconds: float) -> str:
    """Seconds in a readable unit."""
    return f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"


def timed(function: Callable[[], object], repeats: int) -> Array:
    """Seconds of each of `repeats` calls, after one that warms up."""
    function()
    return np.array([timed_once(function) for _ in range(repeats)])


def timed_in_turns(
    first: Callable[[], object], second: Callable[[], object], repeats: int
) -> tuple[Array, Array]:
    """Seconds of two functions called in turns, so that what else the machine does weighs on both."""
    pairs = [(timed_once(first), timed_once(second)) for _ in range(repeats + 1)]
    seconds = np.array(pairs[1:]).T
    return seconds[0], seconds[1]


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


def set_up_seconds(formulation: str, levels: int, repeats: int) -> Array:
    """Seconds of each of `repeats` set-ups on the same arrays."""
    points, triangles = icosphere(levels, (RADIUS, RADIUS, RADIUS))
    return np.array([timed_once(lambda: set_up_on(points, triangles, formulation)) for _ in range(repeats)])


def linear_rows(sizes: Sizes, levels: int, repeats: int) -> Iterator[Row]:
    """Every node loaded, and the triangular solves in it, beside SuperLU's; set-up with its memory."""
    for formulation in ("paper", "consistent", "vector"):
        # a call of its own, so that nothing of one form is alive when the memory of the next is measured
        yield from rows_of_one(formulation, sizes, levels, repeats)


def rows_of_one(formulation: str, sizes: Sizes, levels: int, repeats: int) -> Iterator[Row]:
    """The rows of one formulation."""
    ball(formulation, 2)  # what is loaded on first use is not the model's
    before = reset_peak()
    model = ball(formulation, levels)
    peak = peak_bytes_since(before)
    resident = reset_peak() - before
    assert isinstance(model.solver, LinearSolver)
    n_nodes = model.surface.n_nodes
    free, form = model.problem.free, model.formulation
    # the vector form's three components share one scalar factor
    block = scalar_block(model)
    before = reset_peak()
    again = Cholesky(sparse.csr_array(block))
    library = peak_bytes_since(before)
    factor_resident = reset_peak() - before
    del again
    superlu = linalg.splu(
        block, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    bound = 2.0 * reading_seconds(BYTES_PER_NONZERO * superlu.L.nnz, repeats)
    memory = (amount / max(factor_resident, 1) for amount in (resident, peak, library))

    def row(what: str, seconds: Array) -> Row:
        return Row(f"{what}, {formulation}", n_nodes, seconds, float(np.median(seconds)) / bound)

    set_up = row("set-up", set_up_seconds(formulation, levels, sizes.slow_repeats))
    yield replace(set_up, **dict(zip(("resident", "peak", "library"), memory, strict=True)))
    yield row("of it one factor", timed(partial(Cholesky, sparse.csr_array(block)), sizes.slow_repeats))
    yield row(
        "of it the rule for the parameters",
        timed(partial(tissue, model.surface, formulation, ~free), sizes.slow_repeats),
    )
    load = Load(100.0 * np.random.default_rng(0).random(n_nodes))
    yield row("linear step, every node loaded", timed(partial(model.solver.step, load), repeats))
    yield row("the same with reactions and energy", timed(partial(asked, model, load), repeats))
    yield row("audit of the step", timed_audit(model, load, repeats))
    right = np.random.default_rng(1).standard_normal((int(free.sum()) * form.components,))
    others = partial(superlu.solve, right.reshape(block.shape[0], -1))
    solve, other = timed_in_turns(partial(model.solver.factor.block.solve, right), others, repeats)
    typical = float(np.median(solve))
    ratios = typical / bound, float(np.median(other)) / typical
    yield Row(f"its triangular solves, {formulation}", n_nodes, solve, *ratios)


def asked(model: Model, load: Load) -> tuple[Array, float]:
    """A step, and what is computed only when it is asked for."""
    step = model.solver.step(load)
    return step.reaction_force, step.energy


def timed_audit(model: Model, load: Load, repeats: int) -> Array:
    """Seconds of each audit of a new step; a frame alone has none, a history one for every step."""
    seconds = []
    for _ in range(repeats):
        step = model.solver.step(load)
        seconds.append(timed_once(partial(model.solver.audited, load, step)))
    return np.array(seconds)


def two_readings(model: Model, repeats: int) -> float:
    """Seconds of two readings of the model's scalar factor."""
    superlu = linalg.splu(
        scalar_block(model),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return 2.0 * reading_seconds(BYTES_PER_NONZERO * superlu.L.nnz, repeats)


def scalar_block(model: Model) -> sparse.csc_array:
    """The matrix that the model's solver factors."""
    free = model.problem.free
    form = model.formulation
    matrix = form.tension if isinstance(form, VectorFormulation) else form.stiffness()
    return sparse.csc_array(matrix[free][:, free])


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
        yield Row(what, model.surface.n_nodes, seconds, float(np.median(seconds)) / bound)


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
                yield Row(what, surface.n_nodes, seconds, float(np.median(seconds)) / bound)


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
        taken = np.array(seconds[3:])
        share = float(np.median(taken)) / bound
        yield Row(f"{what}{counted}, {formulation}", model.surface.n_nodes, taken, share)


def boundary_rows(sizes: Sizes) -> Iterator[Row]:
    """The dense form on tori, the sparse form on a ball."""
    for n, m in sizes.tori:
        yield from rows_of_integrals("boundary", sizes, *torus(n=n, m=m))
    yield from rows_of_integrals("sparse", sizes, *icosphere(sizes.levels, (RADIUS, RADIUS, RADIUS)))


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
    readings = 1 if formulation == "sparse" or size <= INVERTED else 2
    bound = readings * reading_seconds(BYTES_PER_NONZERO * size * size // 2, sizes.repeats)
    load = Load(100.0 * np.random.default_rng(3).random(len(points)))
    frame = timed(partial(model.solver.step, load), sizes.repeats)
    what = f"set-up, {peak:.2f} GB at its peak"
    for name, taken in ((what, seconds), ("linear step, every node loaded", frame)):
        yield Row(f"{name}, {formulation}", len(points), taken, float(np.median(taken)) / bound)
    yield from contact_rows(model, sizes)


def rows_of(sizes: Sizes) -> Iterator[Row]:
    """All lines of the table."""
    yield from linear_rows(sizes, sizes.levels, sizes.repeats)
    for formulation in ("consistent", "vector"):
        yield from contact_rows(ball(formulation, sizes.levels), sizes)
    yield from krylov_rows(sizes)
    yield from history_rows(sizes)
    yield from boundary_rows(sizes)
    yield from linear_rows(sizes, sizes.fine_levels, 3 * sizes.slow_repeats)


def machine() -> Iterator[str]:
    """What it was measured on."""
    threads = {f"{info['internal_api']}: {info['num_threads']}" for info in threadpool_info()}
    yield f"{processor()}; threads: {', '.join(sorted(threads))}; {platform.platform()}."
    load = f"{os.getloadavg()[1]:.1f} of {os.cpu_count()} processors busy in the five minutes before"
    yield f"Copying memory: {copy_bandwidth() / 1e9:.1f} GB/s read and written; {load}."


def table(head: Sequence[str], lines: Iterable[Sequence[str]]) -> Iterator[str]:
    """As Markdown."""
    yield f"| {' | '.join(head)} |"
    yield f"| {' | '.join(['---'] * len(head))} |"
    for cells in lines:
        yield f"| {' | '.join(cells)} |"


def report(sizes: Sizes) -> Iterator[str]:
    """The lines of the table, headed by the machine."""
    yield from machine()
    yield ""
    yield from table(HEAD, (row.cells() for row in rows_of(sizes)))


def readme_section(sizes: Sizes) -> Iterator[str]:
    """What the README shows of it: medians and how far they are from the bound."""
    yield from machine()
    yield ""
    chosen = [HEAD.index(name) for name in README_HEAD]
    yield from table(README_HEAD, ([row.cells()[k] for k in chosen] for row in rows_of(sizes)))


def processor() -> str:
    """Its name, where the system tells it."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def main() -> None:
    """Print the table line by line; with --readme what the README shows of it, and write it there."""
    if "--readme" not in sys.argv[1:]:
        for line in report(Sizes()):
            print(line, flush=True)
        return
    lines = []
    for line in readme_section(Sizes()):
        print(line, flush=True)
        lines.append(line + "\n")
    marked.show(README, PART, "".join(lines))


if __name__ == "__main__":
    main()
