"""What `fem_reference` costs on this machine, beside named alternatives in the same run: `make bench-fem`.

Assembly of the linear mixed system is set against NGSolve's (extra `benchmark`; same mesh, one thread) and against
scikit-fem's own loop. Then one load on the iterative path for several Poisson ratios, with its iterations. The body
is a unit cube held below and pressed above. Nothing here is asserted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector
from skfem.helpers import ddot, div, sym_grad

from fem_reference.mesh import TetMesh
from fem_reference.system import build_system
from studies.memory import peak_bytes_since, reset_peak
from tests.unit.fem_shapes import Body, cube


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


def _ngsolve(b: Body) -> Callable[[], object]:
    """The same blocks in NGSolve: spaces, sparsity pattern and assembly, its mesh made before."""
    import ngsolve as ngs

    from tests.verification.test_fem_independent_code import ngsolve_mesh

    mesh = ngsolve_mesh(b)

    def assemble() -> object:
        space = ngs.VectorH1(mesh, order=2, dirichlet="base") * ngs.H1(mesh, order=1)
        (u, p), (v, q) = space.TnT()
        strain, virtual = ngs.Sym(ngs.Grad(u)), ngs.Sym(ngs.Grad(v))
        form = ngs.BilinearForm(space, symmetric=True)
        form += (
            2.0 * ngs.InnerProduct(strain, virtual) - p * ngs.div(v) - q * ngs.div(u) - 1e-4 * p * q
        ) * ngs.dx
        return form.Assemble()

    return assemble


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=15, help="of the cube along a side; six tetrahedra each")
    parser.add_argument("--repeats", type=int, default=3)
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
        print(f"| {name} | {seconds:.2f} | {ours / seconds:.2f} |")
    load = b.load(np.where(b.facets_where(lambda x: x[:, 2] > 1.0 - 1e-12), 0.05, 0.0))
    print("\n| one load, iterative, nu | unknowns | seconds | peak MB | iterations | residual |")
    print("| --- | --- | --- | --- | --- | --- |")
    for nu in (0.45, 0.49, 0.499, 0.4999, 0.5):
        baseline = reset_peak()
        began = time.perf_counter()
        problem = b.problem(np.abs(b.surface[:, 2]) < 1e-12, poisson_ratio=nu, solver="iterative")
        solution = problem.solve([load])
        seconds = time.perf_counter() - began
        peak = peak_bytes_since(baseline) / 1e6
        residual = float(solution.parameters["relative_residual"])
        cost = f"{problem.system.size} | {seconds:.1f} | {peak:.0f}"
        print(f"| {nu} | {cost} | {solution.iterations[0]} | {residual:.0e} |")


if __name__ == "__main__":
    main()
