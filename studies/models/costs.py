"""What set-ups and steps take, by the model: fits to bodies of 100 to 900 surface nodes, true within a factor."""

from __future__ import annotations

from dataclasses import replace

from ..study.registry import Cost, CostLaw, Size, mesh_seconds

_DENSE_NODES = 2000.0  # `vdm.peers.bem.MAX_NODES`, which would load the library; more are refused
_COARSE_NODES = 1000.0  # `vdm.material.COARSE_NODES`
# unknowns per tetrahedron, as these elements have them on meshes of some thousand
_UNKNOWNS = {"P1": 0.7, "P2": 4.7}
# seconds a tetrahedron that scikit-fem's own assembly of a finite-strain tangent takes
_PLAIN_TANGENT = 1.5e-3
# the paths' own estimates are for choosing one; of this one, a solve of 3,000 to 25,000 tetrahedra takes
_ITERATIVE_SHARE = 0.6
# iterative solves whose time a load step of finite strain takes, where no factors are made
_NEWTON_SOLVES = 3.2


def surface(size: Size, solver: str, _: int) -> Cost:
    """Of a surface model with a sparse matrix."""
    n = size.nodes
    step = 1e-6 * n if solver in ("linear", "lu", "quasi-linear") else 2e-3 + 1.2e-5 * n
    return Cost(1e-2 + (2e-4 if solver == "lu" else 2e-5) * n, step, (3e4 if solver == "lu" else 6e3) * n)


def mass_spring(size: Size, solver: str, _: int) -> Cost:
    """Struts from side to side make a dense factor."""
    n = size.nodes
    step = (1e-7 if solver == "nonlinear" else 3.5e-9) * n**2
    return Cost(1e-2 + 1.6e-9 * n**3, 7e-7 * n + step, 6e3 * n + 36.0 * n**2)


def boundary(size: Size, solver: str, _: int) -> Cost:
    """Of dense boundary elements."""
    n = size.nodes
    if n > _DENSE_NODES:
        return Cost(1e-2, 0.0, 6e3 * n)
    step = (3e-7 if solver == "nonlinear" else 3e-8) * n**2
    return Cost(0.1 + 1.3e-6 * n**2 + 1.3e-9 * n**3, step, 300.0 * n**2)


def sparse_boundary(size: Size, solver: str, _: int) -> Cost:
    """Of a dense coarse body and springs between neighbours."""
    n, coarse = size.nodes, min(size.nodes, _COARSE_NODES)
    step = (1e-7 if solver == "nonlinear" else 2e-9) * (coarse**2 + 600.0 * n)
    return Cost(0.1 + 1e-6 * coarse**2 + 1e-8 * coarse**3 + 2e-4 * n, step, 900.0 * coarse**2 + 1e4 * n)


def elements(kind: str) -> CostLaw:
    """Of small-strain elements, "P1" or "P2", on the path that is the quickest."""

    def law(size: Size, _: str, loads: int) -> Cost:
        unknowns, path, setup, step, _seconds = _paths(kind, size, loads)
        return Cost(setup, step, (1.8e4 if path == "direct" else 2.6e3) * unknowns)

    return law


def linear(size: Size, solver: str, loads: int) -> Cost:
    """Of quadratic small-strain elements; plain ones make an LU factor."""
    return _plain(size, finite=False) if solver == "plain" else elements("P2")(size, solver, loads)


def coarse(size: Size, solver: str, loads: int) -> Cost:
    """Of elements on a mesh twice as coarse, which is made first."""
    own = linear(size.refined(-1), solver, loads)
    return replace(own, setup=own.setup + mesh_seconds(size.refined(-1)))


def condensed(size: Size, _: str, loads: int) -> Cost:
    """Of elements that answer many loads in the set-up."""
    loads = max(loads, 600)
    unknowns, _path, setup, step, _seconds = _paths("P2", size, loads)
    return Cost(setup + loads * step, 1e-7 * unknowns, 2e4 * unknowns)


def finite_strain(size: Size, solver: str, loads: int) -> Cost:
    """Of Newton's method; plain elements make an LU factor each iteration."""
    from fem_reference.costs import estimate_newton_costs

    if solver == "plain":
        return _plain(size, finite=True)
    unknowns, _path, _setup, _step, (one, iterative, direct) = _paths("P2", size, loads)
    step = min(5.0 * direct, _NEWTON_SOLVES * iterative)
    newton = estimate_newton_costs(int(unknowns), int(0.22 * size.tetrahedra), loads)
    held = min(newton.values(), key=lambda cost: cost.seconds).bytes
    return Cost(1e-5 * unknowns + one, step, 5e7 + 6.3e3 * unknowns + held)


def _paths(kind: str, size: Size, loads: int) -> tuple[float, str, float, float, tuple[float, float, float]]:
    """Unknowns, the quickest path, its set-up and step [s]; an iterative set-up, such a solve, a factor [s]."""
    from fem_reference.costs import estimate_costs

    unknowns = _UNKNOWNS[kind] * size.tetrahedra
    one, many = (estimate_costs(int(unknowns), int(0.22 * size.tetrahedra), k) for k in (0, loads))
    path = min(many, key=lambda name: many[name].seconds)
    share = _ITERATIVE_SHARE if path == "iterative" else 1.0
    setup = share * one[path].seconds + 1e-5 * unknowns
    step = share * (many[path].seconds - one[path].seconds) / loads
    solve = (many["iterative"].seconds - one["iterative"].seconds) / loads
    return unknowns, path, setup, step, (one["iterative"].seconds, solve, one["direct"].seconds)


def _plain(size: Size, *, finite: bool) -> Cost:
    """Of the plain path: an LU factor, in finite strain one each iteration after scikit-fem's own assembly."""
    from fem_reference.costs import NEWTON_STEPS, lu_seconds, superlu_bytes

    unknowns = _UNKNOWNS["P2"] * size.tetrahedra
    factor, held = lu_seconds(unknowns), superlu_bytes(unknowns, "float64") + 6e4 * size.tetrahedra
    if finite:
        return Cost(1e-4 * size.tetrahedra, NEWTON_STEPS * (factor + _PLAIN_TANGENT * size.tetrahedra), held)
    return Cost(2e-4 * size.tetrahedra + factor, 1e-6 * unknowns, held)
