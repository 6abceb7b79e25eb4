"""NGSolve's mixed P2-P1 elements, run by `engine.py`: linear, or neo-Hookean by Newton's method.

In: `points` (n, 3), `tetrahedra` (m, 4), `facets` (F, 3), `edges` (E, 2), masks `held` (n,) and `held_edges` (E,),
`young` [Pa], `poisson`, `force` (S, n, 3) and `edge_force` (S, E, 3) of quadratic shape functions [N],
`displacement` (S, n, 3) of held points [m], `large`. Out: `displacement` (S, n, 3) [m], `reaction` (S, n, 3) [N],
an edge's half at each end, `pressure` (S,) mean of -tr(stress)/3 over the rest volume [Pa], `energy` [J],
`iterations`, 0 for no balance, `seconds`, `setup`, `version`. A load step that fails is halved.
"""

import time
from typing import Any

import netgen.meshing as netgen
import ngsolve as ngs
import numpy as np

TOLERANCE = 1e-9  # of the residual, over the forces of load and support
MOST_ITERATIONS, MOST_TRIALS = 12, 40
LEAST_STEP = 1.0 / 64.0  # of a load step


class Body:
    """Spaces, forms and held degrees of freedom; a field is hierarchical: points, and bumps of edges on top."""

    def __init__(self, given: dict[str, Any]) -> None:
        points, edges = given["points"], given["edges"]
        self.mesh = _mesh(points, given["tetrahedra"], given["facets"])
        self.space = ngs.VectorH1(self.mesh, order=2) * ngs.H1(self.mesh, order=1)
        scalar = ngs.H1(self.mesh, order=2)
        numbers = {tuple(sorted(pair)): k for k, pair in enumerate(edges.tolist())}
        self.edges, self.size, self.n = edges, scalar.ndof, len(points)
        self.bumps = np.empty(len(edges), dtype=np.int64)  # degree of freedom of each edge
        for edge in self.mesh.edges:
            number = numbers[tuple(sorted(vertex.nr for vertex in edge.vertices))]
            (self.bumps[number],) = scalar.GetDofNrs(ngs.NodeId(ngs.EDGE, edge.nr))
        one = ngs.GridFunction(scalar)
        one.vec[:] = 0.0
        one.vec[int(self.bumps[0])] = 1.0
        self.height = one(self.mesh(*points[edges[0]].mean(axis=0)))  # of a bump in the middle of its edge
        held = np.concatenate([np.flatnonzero(given["held"]), self.bumps[given["held_edges"]]])
        self.held = (held + self.size * np.arange(3)[:, None]).ravel()
        self.free = ngs.BitArray(self.space.ndof)
        self.free.Set()
        for dof in self.held.tolist():
            self.free.Clear(dof)
        self._law(float(given["young"]), float(given["poisson"]), large=bool(given["large"]))
        self.state = ngs.GridFunction(self.space)
        self.state.vec[:] = 0.0
        self.large = bool(given["large"])
        if not self.large:
            self._factorise()

    def _factorise(self) -> None:
        self.form.AssembleLinearization(self.state.vec)
        self.factor = self.form.mat.Inverse(self.free, inverse="sparsecholesky")

    def _law(self, young: float, nu: float, *, large: bool) -> None:
        mu = young / (2.0 * (1.0 + nu))
        compliance = (1.0 - 2.0 * nu) / (2.0 * mu * nu)

        def stored(gradient: Any) -> tuple[Any, Any, Any]:
            """Energy without volume, growth of the volume, and what the shape adds to the mean pressure."""
            if not large:
                strain = 0.5 * (gradient + gradient.trans)
                growth = ngs.Trace(gradient)
                return mu * ngs.InnerProduct(strain, strain), growth, -2.0 * mu / 3.0 * growth
            whole = ngs.Id(3) + gradient
            volume, squares = ngs.Det(whole), ngs.InnerProduct(whole, whole)
            shape = -mu * (squares - 3.0) / (3.0 * volume)
            return 0.5 * mu * (squares - 3.0 - 2.0 * ngs.log(volume)), volume - 1.0, shape

        u, p = self.space.TrialFunction()
        energy, growth, _ = stored(ngs.Grad(u))
        self.form = ngs.BilinearForm(self.space, symmetric=False)
        self.form += ngs.Variation((energy - p * growth - 0.5 * compliance * p * p) * ngs.dx)

        def measured(state: Any) -> tuple[float, float]:
            displacement, pressure = state.components
            energy, _, shape = stored(ngs.Grad(displacement))
            volume = ngs.Integrate(ngs.CF(1.0), self.mesh)
            mean = ngs.Integrate(pressure + shape, self.mesh) / volume
            return mean, ngs.Integrate(energy + 0.5 * compliance * pressure * pressure, self.mesh)

        self.measured = measured

    def dual(self, force: Any, edge_force: Any) -> Any:
        """(ndof,) of forces (n, 3) and (E, 3) that do work on values at points and in middles of edges."""
        out = np.zeros(self.space.ndof)
        for k in range(3):
            part = out[k * self.size : (k + 1) * self.size]
            part[: self.n] = force[:, k]
            for end in range(2):
                np.add.at(part, self.edges[:, end], 0.5 * edge_force[:, k])
            part[self.bumps] = self.height * edge_force[:, k]
        return out

    def at_points(self, vector: Any) -> Any:
        """(n, 3) part of a vector that belongs to the points."""
        return np.array([vector[k * self.size :][: self.n] for k in range(3)]).T

    def balance(self, force: Any, displacement: Any) -> tuple[int, Any]:
        """Newton's method from the present state. Gives iterations, 0 for none found, and what supports give."""
        vector, residual, step = self.state.vec, self.state.vec.CreateVector(), self.state.vec.CreateVector()
        for k in range(3):
            places = self.held[self.held // self.size == k]
            places = places[places % self.size < self.n]
            vector.FV().NumPy()[places] = displacement[places % self.size, k]
        free = np.ones(len(force), dtype=bool)
        free[self.held] = False
        for iteration in range(MOST_ITERATIONS + 1):
            self.form.Apply(vector, residual)
            internal = residual.FV().NumPy()
            internal -= force
            least = TOLERANCE * max(np.abs(force).max(), np.abs(internal[self.held]).max(initial=0.0), 1e-300)
            if not np.isfinite(internal).all():
                return 0, None
            if iteration and np.abs(internal[free]).max() <= least:
                return iteration, np.where(free, 0.0, internal)
            if self.large:
                self._factorise()
            step.data = self.factor * residual
            vector.data -= step
        return 0, None


def _mesh(points: Any, tetrahedra: Any, facets: Any) -> Any:
    """Vertex v is point v."""
    made = netgen.Mesh(dim=3)
    for point in points.tolist():
        made.Add(netgen.MeshPoint(netgen.Pnt(*point)))
    made.Add(netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
    made.SetMaterial(1, "tissue")
    for nodes in (tetrahedra + 1).tolist():
        made.Add(netgen.Element3D(1, nodes))
    for nodes in (facets + 1).tolist():
        made.Add(netgen.Element2D(1, nodes))
    return ngs.Mesh(made)


def follow(body: Body, old: tuple[Any, Any], new: tuple[Any, Any]) -> tuple[int, Any]:
    """From the balance of a load to that of the next. Gives iterations, 0 for none, and the supports' forces."""
    done, size, iterations = 0.0, 1.0, 0
    kept = np.array(body.state.vec.FV().NumPy())
    for _ in range(MOST_TRIALS):
        share = min(1.0, done + size)
        force, displacement = (a + share * (b - a) for a, b in zip(old, new, strict=True))
        taken, reaction = body.balance(force, displacement)
        if taken:
            done, iterations = share, iterations + taken
            kept = np.array(body.state.vec.FV().NumPy())
            if done == 1.0:
                return iterations, reaction
            continue
        body.state.vec.FV().NumPy()[:] = kept
        size *= 0.5
        if size < LEAST_STEP:
            break
    return 0, np.full(len(kept), np.nan)


def solve(given: dict[str, Any]) -> dict[str, Any]:
    """See above."""
    start = time.perf_counter()
    body = Body(given)
    setup = time.perf_counter() - start
    rows: dict[str, list[Any]] = {
        name: [] for name in ("displacement", "reaction", "pressure", "energy", "iterations", "seconds")
    }
    last = (np.zeros(body.space.ndof), np.zeros_like(given["points"]))
    steps = zip(given["force"], given["edge_force"], given["displacement"], strict=True)
    for force, edge_force, displacement in steps:
        start = time.perf_counter()
        new = (body.dual(force, edge_force), displacement)
        iterations, reaction = follow(body, last, new)
        rows["seconds"].append(time.perf_counter() - start)
        last = new if iterations else last
        mean, energy = body.measured(body.state)
        rows["displacement"].append(body.at_points(body.state.vec.FV().NumPy()))
        rows["reaction"].append(body.at_points(reaction))
        rows["pressure"].append(mean)
        rows["energy"].append(energy)
        rows["iterations"].append(iterations)
    return {
        **{name: np.array(values) for name, values in rows.items()},
        "setup": setup,
        "version": ngs.__version__,
    }
