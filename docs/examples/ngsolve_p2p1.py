"""NGSolve's mixed P2-P1 elements as a model: linear, or neo-Hookean by Newton's method with dead pressure.

A field is hierarchical: values at points, and bumps of edges on top. Forces come from the quadratic shape functions
of `fem_reference`, so that both codes answer one problem.
"""

import time
from importlib.metadata import version

import numpy as np

from fem_reference.loads import held_nodes, nodal_forces
from fem_reference.mesh import TetMesh
from solver_common.solution import CONVERGED, Solution, Status
from vdmbench.models import Model, SetUp, register
from vdmbench.models.elements import fem_loads
from vdmbench.scene.export import Handout

TOLERANCE = 1e-9  # of the residual, over the forces of load and support
MOST_ITERATIONS, MOST_TRIALS = 12, 40
LEAST_STEP = 1.0 / 64.0  # of a load step, which is halved where it fails
FAILED = Status("no-balance", "NGSolve's Newton iteration finds no balance", "take smaller loads")


def prepare(scene, solver, name, n_loads):  # noqa: ARG001
    """NGSolve's spaces and forms on the scene's mesh; see `vdmbench.models.Model`."""
    start = time.perf_counter()
    if scene.tissue.poisson_ratio == 0.0:
        raise ValueError(f"{name}: its pressure field needs a poisson_ratio above 0")
    mesh = TetMesh(scene.mesh.points, scene.mesh.tetrahedra, scene.mesh.surface_nodes, scene.mesh.triangles)
    body = Body(scene, mesh, large=solver == "nonlinear")
    seconds, surface, tissue = time.perf_counter() - start, scene.mesh.surface_nodes, scene.tissue

    def solve(loads):
        body.state.vec[:] = 0.0
        last, found = body.load(np.zeros((mesh.n_nodes, 3)), np.zeros_like(scene.mesh.points)), []
        forces = nodal_forces(mesh, fem_loads(loads, mesh), tissue.density)
        for force, load in zip(forces, loads, strict=True):
            start = time.perf_counter()
            new = body.load(force, Handout(scene, load).displacement)
            iterations, reaction = body.follow(last, new)
            last = new if iterations else last
            u, reaction = (body.at_points(part)[surface] for part in (body.values(), reaction))
            found.append((u, reaction, *body.measured(), iterations, time.perf_counter() - start))
        u, reactions, pressures, energies, iterations, times = map(np.array, zip(*found, strict=True))
        return Solution(
            displacement=u,
            fluid_pressure=pressures,
            reaction_force=reactions,
            energy=energies,
            iterations=iterations,
            status=tuple(CONVERGED if taken else FAILED for taken in iterations),
            seconds_setup=seconds,
            seconds_per_step=times,
            parameters={"youngs_modulus": tissue.youngs_modulus, "poisson_ratio": tissue.poisson_ratio},
        )

    return SetUp(solve)


class Body:
    """Spaces, forms, held degrees of freedom and the present state of a scene's body."""

    def __init__(self, scene, mesh, *, large):
        import ngsolve as ngs  # takes a while, and who only plans solves nothing

        self.ngs, self.large, self.n = ngs, large, len(mesh.points)
        self.mesh = _mesh(ngs, mesh)
        self.space = ngs.VectorH1(self.mesh, order=2) * ngs.H1(self.mesh, order=1)
        scalar = ngs.H1(self.mesh, order=2)
        self.edges, self.size = mesh.skfem_mesh.edges.T.astype(np.int64), scalar.ndof
        numbers = {tuple(sorted(pair)): k for k, pair in enumerate(self.edges.tolist())}
        self.bumps = np.empty(len(self.edges), dtype=np.int64)  # degree of freedom of each edge
        for edge in self.mesh.edges:
            number = numbers[tuple(sorted(vertex.nr for vertex in edge.vertices))]
            (self.bumps[number],) = scalar.GetDofNrs(ngs.NodeId(ngs.EDGE, edge.nr))
        one = ngs.GridFunction(scalar)
        one.vec[:] = 0.0
        one.vec[int(self.bumps[0])] = 1.0
        self.height = one(
            self.mesh(*mesh.points[self.edges[0]].mean(axis=0))
        )  # of a bump in its edge's middle
        held = held_nodes(mesh, scene.held)[:, 0]
        dofs = np.concatenate([np.flatnonzero(held[: self.n]), self.bumps[held[self.n :]]])
        self.held = (dofs + self.size * np.arange(3)[:, None]).ravel()
        self.free = ngs.BitArray(self.space.ndof)
        self.free.Set()
        for dof in self.held.tolist():
            self.free.Clear(dof)
        self.state = ngs.GridFunction(self.space)
        self.state.vec[:] = 0.0
        self._law(scene.tissue.youngs_modulus, scene.tissue.poisson_ratio)
        if not large:
            self._factorise()

    def _factorise(self):
        self.form.AssembleLinearization(self.state.vec)
        self.factor = self.form.mat.Inverse(self.free, inverse="sparsecholesky")

    def _law(self, young, nu):
        ngs, mu = self.ngs, young / (2.0 * (1.0 + nu))
        self.compliance = (1.0 - 2.0 * nu) / (2.0 * mu * nu)

        def stored(gradient):
            """Energy without volume, growth of the volume, and what the shape adds to the mean pressure."""
            if not self.large:
                strain = 0.5 * (gradient + gradient.trans)
                growth = ngs.Trace(gradient)
                return mu * ngs.InnerProduct(strain, strain), growth, -2.0 * mu / 3.0 * growth
            whole = ngs.Id(3) + gradient
            volume, squares = ngs.Det(whole), ngs.InnerProduct(whole, whole)
            shape = -mu * (squares - 3.0) / (3.0 * volume)
            return 0.5 * mu * (squares - 3.0 - 2.0 * ngs.log(volume)), volume - 1.0, shape

        self.stored = stored
        u, p = self.space.TrialFunction()
        energy, growth, _ = stored(ngs.Grad(u))
        self.form = ngs.BilinearForm(self.space, symmetric=False)
        self.form += ngs.Variation((energy - p * growth - 0.5 * self.compliance * p * p) * ngs.dx)

    def measured(self):
        """Mean of -tr(stress)/3 over the rest volume [Pa] and the energy [J] of the present state."""
        ngs, (displacement, pressure) = self.ngs, self.state.components
        energy, _, shape = self.stored(ngs.Grad(displacement))
        volume = ngs.Integrate(ngs.CF(1.0), self.mesh)
        mean = ngs.Integrate(pressure + shape, self.mesh) / volume
        return mean, ngs.Integrate(energy + 0.5 * self.compliance * pressure * pressure, self.mesh)

    def load(self, force, displacement):
        """Forces (n + E, 3) of quadratic shape functions as (ndof,), and displacements (n, 3) of held points."""
        out = np.zeros(self.space.ndof)
        points, middles = force[: self.n], force[self.n :]
        for k in range(3):
            part = out[k * self.size : (k + 1) * self.size]
            part[: self.n] = points[:, k]
            for end in range(2):
                np.add.at(part, self.edges[:, end], 0.5 * middles[:, k])
            part[self.bumps] = self.height * middles[:, k]
        return out, displacement

    def values(self):
        """(ndof,) a view of the present state."""
        return self.state.vec.FV().NumPy()

    def at_points(self, vector):
        """(n, 3) part of a vector that belongs to the points."""
        return np.array([vector[k * self.size :][: self.n] for k in range(3)]).T

    def follow(self, old, new):
        """From the balance of a load to that of the next. Gives iterations, 0 for none, and reactions."""
        done, size, iterations = 0.0, 1.0, 0
        kept = np.array(self.values())
        for _ in range(MOST_TRIALS):
            share = min(1.0, done + size)
            taken, reaction = self._balance(*(a + share * (b - a) for a, b in zip(old, new, strict=True)))
            if taken:
                done, iterations = share, iterations + taken
                kept = np.array(self.values())
                if done == 1.0:
                    return iterations, reaction
                continue
            self.values()[:] = kept
            size *= 0.5
            if size < LEAST_STEP:
                break
        return 0, np.full(len(kept), np.nan)

    def _balance(self, force, displacement):
        """Newton's method from the present state. Gives iterations, 0 for none found, and the supports' forces."""
        vector, residual, step = self.state.vec, self.state.vec.CreateVector(), self.state.vec.CreateVector()
        for k in range(3):
            places = self.held[self.held // self.size == k]
            places = places[places % self.size < self.n]
            self.values()[places] = displacement[places % self.size, k]
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


def _mesh(ngs, mesh):
    """Vertex v is point v."""
    import netgen.meshing as netgen

    made = netgen.Mesh(dim=3)
    for point in mesh.points.tolist():
        made.Add(netgen.MeshPoint(netgen.Pnt(*point)))
    made.Add(netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
    made.SetMaterial(1, "tissue")
    for nodes in (mesh.tetrahedra + 1).tolist():
        made.Add(netgen.Element3D(1, nodes))
    for nodes in (mesh.surface_nodes[mesh.triangles] + 1).tolist():
        made.Add(netgen.Element2D(1, nodes))
    return ngs.Mesh(made)


register(
    Model(
        name="ngsolve-p2p1",
        version=f"2, ngsolve {version('ngsolve')}",
        prepare=prepare,
        volumetric=True,
        solvers=("linear", "nonlinear"),
        superposes=("linear",),
        tissue=("youngs_modulus", "poisson_ratio"),
        parameters=(),
        takes={"dead forces": ("linear", "nonlinear")},
        memory=lambda size, _: 4e8 + 4e4 * size.tetrahedra,
    )
)
