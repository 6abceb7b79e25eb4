"""What both libraries cost on this machine: `vdm_speed` writes a table to vdm/README.md, `fem_speed` prints one.

Processor seconds, which other work on the machine makes longer by what it takes of caches alone.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

from fem_reference.linear import LinearProblem, Load
from fem_reference.plain_linear import PlainLinearProblem
from solver_common.arrays import Array, Index
from tests.fem.shapes import Body, cube
from tests.vdm.vdm_shapes import icosphere, torus
from tools.documents import ROOT, show, table
from vdm import Load as SurfaceLoad
from vdm import Model, Parameters
from vdm.problem import Step
from vdm.solvers.compliance import ContactCompliance
from vdm.solvers.linear import LinearSolver
from vdmbench.machine import peak_bytes_since, processor_name, reset_peak

README, PART = ROOT / "vdm" / "README.md", "speed"
HEAD = ("what", "nodes", "median")
Row = tuple[str, str, str]


@dataclass(frozen=True)
class Sizes:
    """What is measured, and how often: smaller sizes make a trial of the benchmark itself."""

    levels: int = 5  # of the icosphere: 10,242 nodes
    fine_levels: int = 7  # 163,842 nodes
    tori: tuple[tuple[int, int], ...] = ((40, 25), (50, 40))  # 1,000 and 2,000 nodes
    contact: int = 50
    repeats: int = 101
    slow_repeats: int = 3


def timed(function: Callable[[], object], repeats: int) -> list[float]:
    """Seconds of each of `repeats` calls, after one that warms up."""
    function()
    return [timed_once(function) for _ in range(repeats)]


def timed_once(function: Callable[[], object]) -> float:
    """Processor seconds of one call."""
    start = time.thread_time()
    function()
    return time.thread_time() - start


def row(what: str, nodes: int, seconds: Sequence[float]) -> Row:
    """A line of the table, of the seconds of each repeat."""
    middle = float(np.median(seconds))
    return what, f"{nodes:,}", f"{middle:.3g} s" if middle >= 1.0 else f"{1e3 * middle:.3g} ms"


def ball(levels: int) -> tuple[Array, Index]:
    """A ball of 50 mm with 10 * 4^levels + 2 nodes."""
    return icosphere(levels, (0.05, 0.05, 0.05))


def set_up(body: tuple[Array, Index], formulation: str, solver: str = "linear") -> Model:
    """The model of a surface whose lowest part is held, from points and triangles to the factor."""
    points, triangles = body
    fixed = points[:, 2] < 0.9 * points[:, 2].min()
    rule = partial(Parameters.from_tissue, 5000.0, formulation=formulation, held=fixed)
    return Model(points, triangles, rule, formulation=formulation, fixed=fixed, solver=solver)


def one_body(formulation: str, body: tuple[Array, Index], sizes: Sizes, repeats: int) -> Iterator[Row]:
    """Set-up with its memory, a step of a load on every node, and a local contact that stays where it is."""
    set_up(ball(2), formulation)  # what is loaded or compiled on first use is not the model's
    before = reset_peak()
    model = set_up(body, formulation)
    peak, nodes = peak_bytes_since(before) / 1e9, model.surface.n_nodes
    again = [timed_once(partial(set_up, body, formulation)) for _ in range(sizes.slow_repeats)]
    yield row(f"set-up, {peak:.2g} GB at its peak, {formulation}", nodes, again)
    load = SurfaceLoad(100.0 * np.random.default_rng(0).random(nodes))
    step = timed(partial(model.solver.step, load), repeats)
    yield row(f"linear step, every node loaded, {formulation}", nodes, step)
    if formulation == "paper":
        return
    touched = np.argsort(-model.surface.points[:, 2])[: sizes.contact]
    assert isinstance(model.solver, LinearSolver)
    contact = ContactCompliance(model.problem, model.solver, single_precision=True)
    frame = partial(contact.frame, touched, 100.0 * np.random.default_rng(2).random(len(touched)))
    yield row(
        f"local contact of {len(touched)} nodes, single precision, {formulation}",
        nodes,
        timed(frame, repeats),
    )


def histories(sizes: Sizes) -> Iterator[Row]:
    """Steps of a load that grows by a twentieth each, once the history has begun, and their mean iterations."""
    for formulation, solver, what in (
        ("paper", "bicg", "BiCG as printed, warm"),
        ("paper", "bicg-cold", "BiCG as printed, cold"),
        ("paper", "quasi-linear", "quasi-linear step"),
        ("vector", "quasi-linear", "quasi-linear step"),
        ("vector", "nonlinear", "warm nonlinear step"),
    ):
        model = set_up(ball(sizes.levels), formulation, solver)
        load = SurfaceLoad(np.where(model.surface.points[:, 2] > 0.045, 100.0, 0.0))
        step: Step | None = None
        seconds, iterations = [], []
        for k in range(3 + sizes.slow_repeats * 4):
            start = time.thread_time()
            step = model.solver.step(load.scaled(1.0 + 0.05 * k), step)
            seconds.append(time.thread_time() - start)
            iterations.append(step.iterations)
        counted = f", {np.mean(iterations[3:]):.3g} iterations" if any(iterations[3:]) else ""
        yield row(f"{what}{counted}, {formulation}", model.surface.n_nodes, seconds[3:])


def rows_of(sizes: Sizes) -> Iterator[Row]:
    """All lines of the table."""
    for formulation in ("paper", "vector"):
        yield from one_body(formulation, ball(sizes.levels), sizes, sizes.repeats)
    yield from histories(sizes)
    for n, m in sizes.tori:
        yield from one_body("bem", torus(n=n, m=m), sizes, sizes.repeats)
    yield from one_body("bem-sparse", ball(sizes.levels), sizes, sizes.repeats)
    yield from one_body("vector", ball(sizes.fine_levels), sizes, 3 * sizes.slow_repeats)


# --- fem_reference: a unit cube, held below and pressed above, Poisson's ratio 0.4999 ---


def measured(action: Callable[[], Any]) -> tuple[Any, str]:
    """What an action gives, and its seconds, processor seconds and peak memory as cells."""
    gc.collect()
    resident, clock, processor = reset_peak(), time.perf_counter(), time.process_time()
    result = action()
    seconds = time.perf_counter() - clock, time.process_time() - processor
    return result, f"{seconds[0]:.2f} | {seconds[1]:.2f} | {peak_bytes_since(resident) / 1e6:.0f}"


def problem_of(b: Body, kind: Any = LinearProblem, **options: Any) -> Any:
    """The cube, held below."""
    held = np.abs(b.surface[:, 2]) < 1e-12
    return kind(*b.arrays, youngs_modulus=1.0, poisson_ratio=0.4999, held=held, **options)


def ngsolve_direct(b: Body, count: int) -> None:
    """Assembly, factor and so many solves by NGSolve and UMFPACK on the same mesh."""
    import ngsolve as ngs

    from tests.fem.test_independent_code import ngsolve_mesh

    mesh = ngsolve_mesh(b)
    space = ngs.VectorH1(mesh, order=2, dirichlet="base") * ngs.H1(mesh, order=1)
    (u, p), (v, q) = space.TnT()
    strain, virtual = ngs.Sym(ngs.Grad(u)), ngs.Sym(ngs.Grad(v))
    form = ngs.BilinearForm(space, symmetric=True)
    form += (
        2.0 * ngs.InnerProduct(strain, virtual) - p * ngs.div(v) - q * ngs.div(u) - 1e-4 * p * q
    ) * ngs.dx
    form.Assemble()
    inverse = form.mat.Inverse(space.FreeDofs(), inverse="umfpack")
    rhs, result = form.mat.CreateColVector(), form.mat.CreateColVector()
    for _ in range(count):
        rhs.SetRandom()
        result.data = inverse * rhs


def fem_lines(cells: Sequence[int]) -> Iterator[str]:
    """One load and fifty on the smallest cube by each code, then one load by size on the iterative path."""
    b, rng = cube(cells[0], distort=0.2), np.random.default_rng(0)
    loads = [b.load(rng.uniform(0.0, 0.05, len(b.triangles))) for _ in range(50)]
    codes: dict[str, Callable[[list[Load]], object]] = {
        "fem_reference": lambda some: problem_of(b, expected_loads=len(some)).solve(some),
        "scikit-fem, the plain path": lambda some: problem_of(b, PlainLinearProblem).solve(some),
    }
    if find_spec("ngsolve"):
        codes["NGSolve, UMFPACK"] = lambda some: ngsolve_direct(b, len(some))
    for count in (1, len(loads)):
        for name, solve in codes.items():
            yield f"| {name} | {len(b.tetrahedra)} | {count} | {measured(partial(solve, loads[:count]))[1]} | |"
    for n in cells:
        b = cube(n, distort=0.2)
        press = b.load(np.where(b.facets_where(lambda x: x[:, 2] > 1.0 - 1e-12), 0.05, 0.0))

        def solve_one(body: Body = b, load: Load = press) -> Any:
            return problem_of(body, solver="iterative").solve([load])

        solution, cost = measured(solve_one)
        yield f"| iterative | {len(b.tetrahedra)} | 1 | {cost} | {solution.iterations[0]} |"


def main(name: str, arguments: Sequence[str]) -> None:
    """Print the table line by line; of `vdm_speed` it goes to its README."""
    if name == "fem_speed":  # further arguments: cells along the cube's side
        print("| by | tetrahedra | loads | seconds | processor seconds | peak MB | iterations |")
        print("| --- | --- | --- | --- | --- | --- | --- |")
        for line in fem_lines([*map(int, arguments)] or [8, 15, 24]):
            print(line, flush=True)
        return
    rows = []
    for found in rows_of(Sizes()):
        print(*found, sep=" | ", flush=True)
        rows.append(found)
    show(README, PART, f"{processor_name()}, one thread.\n\n{table(HEAD, rows)}")
