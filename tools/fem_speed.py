"""What `fem_reference` costs on this machine, beside named alternatives in the same run.

Assembly of the linear mixed system is set against NGSolve (extra `benchmark`; same mesh, one thread) and against
scikit-fem; then one load and fifty by all three. Then one load by size (`--large` adds 900,000 unknowns), the
smallest beside UMFPACK and SuperLU; one load by Poisson ratio; many loads on one factor; a
step of Newton's method beside one linear solve; and the condensed body. The body is a unit cube held below and
pressed above. Seconds are those of the clock and of the processor: on a shared machine the second is the one to
read. Nothing here is asserted.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector
from skfem.helpers import ddot, div, sym_grad

from fem_reference.condensed import CondensedProblem
from fem_reference.factorisation import SuperLUFactor, pivotable_triangle
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.linear import LinearProblem, Load
from fem_reference.mesh import TetMesh
from fem_reference.plain_linear import PlainLinearProblem
from fem_reference.solution import Solution
from fem_reference.system import build_system
from tests.unit.fem_shapes import Body, cube
from vdmbench.machine.memory import peak_bytes_since, reset_peak

T = TypeVar("T")


def _fastest(action: Callable[[], object], repeats: int) -> float:
    """Least seconds of several calls."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def _scikit_fem(mesh: TetMesh) -> None:
    vector = Basis(mesh.skfem_mesh, ElementVector(ElementTetP2()), intorder=2)
    scalar = vector.with_element(ElementTetP1())
    BilinearForm(lambda u, v, _: 2.0 * ddot(sym_grad(u), sym_grad(v))).assemble(vector)
    BilinearForm(lambda u, q, _: q * div(u)).assemble(vector, scalar)
    BilinearForm(lambda p, q, _: p * q).assemble(scalar)


def _ngsolve(b: Body) -> Callable[[], Any]:
    """The same blocks in NGSolve: spaces, sparsity pattern and assembly, its mesh made before."""
    import ngsolve as ngs

    from tests.verification.test_fem_independent_code import ngsolve_mesh

    mesh = ngsolve_mesh(b)

    def assemble() -> Any:
        space = ngs.VectorH1(mesh, order=2, dirichlet="base") * ngs.H1(mesh, order=1)
        (u, p), (v, q) = space.TnT()
        strain, virtual = ngs.Sym(ngs.Grad(u)), ngs.Sym(ngs.Grad(v))
        form = ngs.BilinearForm(space, symmetric=True)
        form += (
            2.0 * ngs.InnerProduct(strain, virtual) - p * ngs.div(v) - q * ngs.div(u) - 1e-4 * p * q
        ) * ngs.dx
        return form.Assemble()

    return assemble


@dataclass(frozen=True)
class Cost:
    """What an action took."""

    clock: float  # seconds
    processor: float  # seconds
    megabytes: float  # at the peak, above what was in use before

    def __str__(self) -> str:
        return f"{self.clock:.2f} | {self.processor:.2f} | {self.megabytes:.0f}"


COST = "seconds | processor seconds | peak MB"


def _measured(action: Callable[[], T]) -> tuple[T, Cost]:
    gc.collect()
    resident, clock, processor = reset_peak(), time.perf_counter(), time.process_time()
    result = action()
    cost = Cost(
        time.perf_counter() - clock, time.process_time() - processor, peak_bytes_since(resident) / 1e6
    )
    return result, cost


def _base(b: Body) -> NDArray[np.bool_]:
    return np.abs(b.surface[:, 2]) < 1e-12


def _press(b: Body, pressure: float) -> Load:
    return b.load(np.where(b.facets_where(lambda x: x[:, 2] > 1.0 - 1e-12), pressure, 0.0))


def _solved(b: Body, **options: object) -> tuple[LinearProblem, Solution]:
    problem = b.problem(_base(b), **{"poisson_ratio": 0.4999, **options})
    return problem, problem.solve([_press(b, 0.05)])


def _table(title: str, *columns: str) -> None:
    print(f"\n| {' | '.join([title, *columns])} |")
    print("| --- " * (title.count("|") + 1 + sum(c.count("|") + 1 for c in columns)) + "|")


def _ngsolve_direct(b: Body, count: int = 1) -> None:
    """Assembly, factor and so many solves by NGSolve's own UMFPACK."""
    form = _ngsolve(b)()
    inverse = form.mat.Inverse(form.space.FreeDofs(), inverse="umfpack")
    rhs, result = form.mat.CreateColVector(), form.mat.CreateColVector()
    for _ in range(count):
        rhs.SetRandom()
        result.data = inverse * rhs


def one_and_fifty(b: Body) -> None:
    """Assembly and solve of one load, and of fifty that are independent, by each code on the same mesh."""
    rng = np.random.default_rng(0)
    loads = [b.load(rng.uniform(0.0, 0.05, len(b.triangles))) for _ in range(50)]
    settings = {"youngs_modulus": 1.0, "poisson_ratio": 0.4999, "held": _base(b)}
    _table(f"{len(b.tetrahedra)} tetrahedra, by", "loads", COST)
    for count in (1, len(loads)):

        def fast(loads: list[Load] = loads[:count]) -> Solution:
            return LinearProblem(*b.arrays, **settings, expected_loads=len(loads)).solve(loads)

        def plain(loads: list[Load] = loads[:count]) -> Solution:
            return PlainLinearProblem(*b.arrays, **settings).solve(loads)

        codes: dict[str, Callable[[], object]] = {"fem_reference": fast, "scikit-fem, the plain path": plain}
        if find_spec("ngsolve"):
            codes["NGSolve, UMFPACK"] = partial(_ngsolve_direct, b, count)
        for name, action in codes.items():
            print(f"| {name} | {count} | {_measured(action)[1]} |", flush=True)


def by_size(cells: Sequence[int]) -> None:
    """One load, set-up to answer, with rivals at the smallest size."""
    _table("one load, tetrahedra", "unknowns", "by", COST, "iterations", "residual")
    for n in cells:
        b = cube(n, distort=0.2)
        for solver in ("iterative", "direct") if n == cells[0] else ("iterative",):
            (problem, solution), cost = _measured(partial(_solved, b, solver=solver))
            residual = float(solution.parameters["relative_residual"])
            by = f"{solver}, {solution.parameters['factorisation']}" if solver == "direct" else solver
            head = f"| {len(b.tetrahedra)} | {problem.system.size} | {by} | {cost}"
            print(f"{head} | {solution.iterations[0]} | {residual:.0e} |", flush=True)
        if n == cells[0]:
            lower = pivotable_triangle(problem.system)
            _, cost = _measured(lambda m=lower: SuperLUFactor(m, "float64").solve(np.ones(m.shape[0])))
            print(f"| {len(b.tetrahedra)} | {problem.system.size} | SuperLU, solve only | {cost} | 0 | |")
            if find_spec("ngsolve"):
                _, cost = _measured(partial(_ngsolve_direct, b))
                print(f"| {len(b.tetrahedra)} | | NGSolve, UMFPACK | {cost} | 0 | |", flush=True)


def by_poisson_ratio(b: Body) -> None:
    """One load on the iterative path from compressible to incompressible."""
    _table("one load, iterative, nu", COST, "iterations")
    for nu in (0.45, 0.49, 0.499, 0.4999, 0.5):
        (_, solution), cost = _measured(partial(_solved, b, poisson_ratio=nu, solver="iterative"))
        print(f"| {nu} | {cost} | {solution.iterations[0]} |", flush=True)


def many_loads(b: Body) -> None:
    """Independent loads on one factor."""
    problem, cost = _measured(partial(b.problem, _base(b), poisson_ratio=0.4999, solver="direct"))
    _table(f"loads on one factor of {problem.system.size} unknowns", COST, "processor seconds a load")
    print(f"| set-up | {cost} | |")
    rng = np.random.default_rng(0)
    for count in (1, 10, 100):
        loads = [b.load(rng.uniform(0.0, 0.05, len(b.triangles))) for _ in range(count)]
        _, cost = _measured(lambda chosen=loads: problem.solve(chosen))
        print(f"| {count} | {cost} | {cost.processor / count:.4f} |", flush=True)


def newton(b: Body) -> None:
    """An iteration of Newton's method beside a linear solve of the same size, both with their factor or set-up."""
    _table("one load step by Newton's method", "unknowns", COST, "per iteration over one linear solve")
    for solver in ("iterative", "direct"):
        (problem, _), linear = _measured(partial(_solved, b, solver=solver))

        def finite(path: str = solver) -> Solution:
            whole = FiniteStrainProblem(
                *b.arrays, youngs_modulus=1.0, poisson_ratio=0.4999, held=_base(b), solver=path
            )
            return whole.solve([_press(b, 0.05)])

        solution, cost = _measured(finite)
        ratio = cost.processor / max(1, int(solution.iterations[0])) / linear.processor
        head = f"| {solver}, {solution.iterations[0]} iterations | {problem.system.size} | {cost}"
        print(f"{head} | {ratio:.2f} |", flush=True)


def condensed(b: Body) -> None:
    """Set-up, matrix and frame of the body condensed to the middle of a face, held nodes still and moving."""
    _table(f"condensed, {len(b.tetrahedra)} tetrahedra", COST, "matrix MB", "frame, microseconds")
    top = (b.surface[:, 2] > 1.0 - 1e-12) & (np.abs(b.surface[:, :2] - 0.5) < 0.26).all(axis=1)
    pressed = b.load(np.where(top[b.triangles].all(axis=1), 0.05, 0.0))
    lifted = np.zeros((1, len(b.surface), 3))
    lifted[0, _base(b), 2] = 1.0
    for name, motions in (("held nodes still", None), ("one motion of held nodes", lifted)):

        def set_up(given: NDArray[np.float64] | None = motions) -> CondensedProblem:
            linear = b.problem(_base(b), poisson_ratio=0.4999, expected_loads=12 * int(top.sum()))
            return CondensedProblem(linear, top, motions=given)

        model, cost = _measured(set_up)
        frame = float(np.median(model.solve([pressed] * 20).seconds_per_step))
        print(f"| {name} | {cost} | {model.bytes / 1e6:.0f} | {1e6 * frame:.0f} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=15, help="of the cube along a side; six tetrahedra each")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--large", action="store_true", help="one load of 900,000 unknowns too")
    options = parser.parse_args()
    b = cube(options.cells, distort=0.2)
    mesh = TetMesh(*b.arrays, order=2)
    held = np.repeat(mesh.node_points[:, 2:] < 1e-12, 3, axis=1)
    ours = _fastest(lambda: build_system(mesh, held, mixed=True, poisson_ratio=0.4999), options.repeats)
    print(f"{len(b.tetrahedra)} tetrahedra\n\n| assembly | seconds | ours over it |\n| --- | --- | --- |")
    print(f"| fem_reference | {ours:.2f} | 1 |")
    rivals: dict[str, Callable[[], object]] = {"scikit-fem, its rule of degree 2": lambda: _scikit_fem(mesh)}
    if find_spec("ngsolve"):
        rivals["NGSolve"] = _ngsolve(b)
    else:
        print("| NGSolve | not installed: pip install '.[benchmark]' | |")
    for name, action in rivals.items():
        seconds = _fastest(action, options.repeats)
        print(f"| {name} | {seconds:.2f} | {ours / seconds:.2f} |", flush=True)
    small = options.cells // 2 + 1
    one_and_fifty(cube(small, distort=0.2))
    by_size([small, options.cells, *([24, 33] if options.large else [24])])
    by_poisson_ratio(b)
    many_loads(cube(small, distort=0.2))
    newton(cube(small, distort=0.2))
    condensed(b)


if __name__ == "__main__":
    main()
