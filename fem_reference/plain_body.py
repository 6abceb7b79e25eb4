"""The part that both plain problems share: a body in scikit-fem's objects, its supports, loads and reactions.

Method: Taylor-Hood element on straight tetrahedra, displacement P2 and pressure P1, both continuous.
Order: 3 in displacement, 2 in strain and pressure (L2 norms).
Source: Taylor and Hood 1973, doi 10.1016/0045-7930(73)90027-3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from skfem import (
    Basis,
    BilinearForm,
    ElementTetP1,
    ElementTetP2,
    ElementVector,
    FacetBasis,
    LinearForm,
    MeshTet,
)
from skfem.helpers import dot

from fem_reference.costs import superlu_bytes
from fem_reference.kinematics import Law
from fem_reference.linear_algebra import DIRECT_TOLERANCE
from fem_reference.loads import Load, check_loads, held_nodes
from fem_reference.materials import TransverselyIsotropic
from fem_reference.memory import check_memory
from fem_reference.mesh import TetMesh
from fem_reference.moduli import Moduli, check_density, check_fibres, make_moduli
from fem_reference.solution import CONVERGED, Solution, Status
from fem_reference.springs import DIRECTIONS, ElasticSupport, make_springs
from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

NOT_REACHED = Status("not-reached", "an earlier load step failed", "see that step")


@dataclass(frozen=True)
class Dofs:
    """A state of equilibrium, as dof vectors of scikit-fem.

    Attributes
    ----------
    displacement : (body.basis.N,) [m]
    pressure : (body.pressure_basis.N,) [Pa]
    reaction : (body.basis.N,) force of supports and springs on the body [N]
    energy : elastic energy [J]
    mean_pressure : volume mean of -tr(stress)/3 [Pa]
    residual : relative norm of the residual at free dofs
    status : of the step
    seconds : time of the step
    iterations : of Newton's method
    scalars : further outputs by name
    """

    displacement: Array
    pressure: Array
    reaction: Array
    energy: float
    mean_pressure: float
    residual: float
    status: Status
    seconds: float = 0.0
    iterations: int = 0
    scalars: Mapping[str, float] = field(default_factory=dict)


class PlainBody:
    """A body in scikit-fem's objects, also for custom forms.

    Parameters
    ----------
    points, tetrahedra, surface_nodes, triangles : see `fem_reference.mesh.TetMesh`
    parts : (m,) number of the part of each tetrahedron: the pressure may jump between parts
    elastic_supports : springs under parts of the surface
    held : (N,) surface nodes whose displacement is given, or (N, 3) single components of them (rollers)
    intorder : degree to which integrals over a tetrahedron are exact

    Attributes
    ----------
    mesh : MeshTet
    basis, pressure_basis : of displacement and pressure, one quadrature; the latter's is cut open between parts
    surface_basis : of displacement on the F triangles, in their order
    held_dofs : (D,) displacement dofs that are given
    springs : matrix of the elastic supports on the displacement dofs [N/m]

    Raises
    ------
    SolverError
        For a mesh or a support that `fem_reference.linear.LinearProblem` would refuse, and for too little memory.
    """

    def __init__(
        self,
        points: ArrayLike,
        tetrahedra: ArrayLike,
        surface_nodes: ArrayLike,
        triangles: ArrayLike,
        *,
        held: ArrayLike,
        intorder: int,
        parts: ArrayLike | None = None,
        elastic_supports: Sequence[ElasticSupport] = (),
    ) -> None:
        # these two refuse unusable input
        self.checked = TetMesh(points, tetrahedra, surface_nodes, triangles, parts=parts)
        held_nodes(self.checked, np.asarray(held), make_springs(self.checked, elastic_supports, 1.0))
        self.surface_nodes, self.triangles = self.checked.surface_nodes, self.checked.triangles
        self.mesh = MeshTet(self.checked.points.T.copy(), self.checked.tetrahedra.T.copy())
        self.basis = Basis(self.mesh, ElementVector(ElementTetP2()), intorder=intorder)
        self.pressure_basis = Basis(self.checked.pressure_mesh, ElementTetP1(), intorder=intorder)
        self.facets = self._facets_of_triangles()
        points_on_facet, weights = facet_quadrature()
        self.surface_basis = FacetBasis(
            self.mesh,
            self.basis.elem,
            facets=self.facets,
            quadrature=(points_on_facet[:, 1:].T, 0.5 * weights),
        )
        self.held_dofs = self._held_dofs(np.asarray(held))
        self.springs = self._springs(elastic_supports)
        check_memory(superlu_bytes(self.basis.N + self.pressure_basis.N), None, "plain")

    def _facets_of_triangles(self) -> Index:
        """(F,) scikit-fem's number of each triangle."""
        boundary = self.mesh.boundary_facets()
        corners = np.sort(self.surface_nodes[self.triangles], axis=1)
        facets = np.empty(len(corners), dtype=np.int64)
        facets[np.lexsort(corners.T)] = boundary[np.lexsort(np.sort(self.mesh.facets[:, boundary], axis=0))]
        return facets

    def _held_dofs(self, held: Mask) -> Index:
        """Held vertices, and all of a facet whose three vertices are held, component by component."""
        components = held.T if held.ndim == 2 else np.stack([held] * 3)
        dofs = []
        for name, mask in zip(("u^1", "u^2", "u^3"), components, strict=True):
            facets = self.facets[mask[self.triangles].all(axis=1)]
            dofs += [
                self.basis.get_dofs(facets).all(name),
                self.basis.get_dofs(nodes=self.surface_nodes[mask]).all(name),
            ]
        return np.unique(np.concatenate(dofs)).astype(np.int64)

    @property
    def volume(self) -> float:
        """Volume of the body [m^3]."""
        return float(self.basis.dx.sum())

    def _springs(self, supports: Sequence[ElasticSupport]) -> csr_matrix:
        stiffness = {direction: np.zeros((len(self.triangles), 1)) for direction in DIRECTIONS}
        for support in supports:
            stiffness[support.direction] += np.where(support.facets, support.stiffness, 0.0)[:, None]

        robin = BilinearForm(lambda u, v, w: w.normal * dot(u, w.n) * dot(v, w.n) + w.full * dot(u, v))
        return robin.assemble(self.surface_basis, **stiffness)

    def check(self, loads: Sequence[Load]) -> None:
        """Raise a `SolverError` for a load of the wrong shape or with values that are not finite."""
        check_loads(self.checked, loads)

    def parameters(
        self, youngs_modulus: ArrayLike, poisson_ratio: ArrayLike, density: float, law: Law
    ) -> tuple[dict[str, Any], Moduli]:
        """The material values for the forms, and the means of the moduli.

        Parameters
        ----------
        youngs_modulus, poisson_ratio : one number or (m,)
        density : [kg/m^3]
        law : neo-Hookean or with fibres, for a Young's modulus of one

        Returns
        -------
        values : G [Pa]; k [Pa] and a of the fibres; `couples` and `gives` of the constraint couples q dilation +
            gives q p = 0, which is p = -lambda dilation with lambda = 2 G nu / (1 - 2 nu)
        moduli : see `fem_reference.moduli.Moduli`

        Raises
        ------
        SolverError
            For moduli that `LinearProblem` refuses, and an incompressible body with all nodes held.
        """
        check_density(density)
        moduli = make_moduli(self.checked, youngs_modulus, poisson_ratio, mixed=True)
        E, nu = (np.asarray(value, dtype=np.float64) for value in (youngs_modulus, poisson_ratio))
        if (nu == 0.5).all() and np.isin(self.basis.get_dofs().all(), self.held_dofs).all():
            message = (
                "an incompressible body is held over its whole surface, which leaves its pressure undefined"
            )
            remedy = "free a part of the surface or set poisson_ratio to 0.4999"
            raise solver_error("enclosed", message, remedy)
        G = E / (2.0 * (1.0 + nu))
        couples, gives = 0.0, np.ones(1)  # p = 0
        if nu.all():
            couples = float(G.mean())  # scales the row, so that all rows are of similar size
            gives = couples * (1.0 - 2.0 * nu) / (2.0 * G * nu)
        values = {"G": _per_tetrahedron(G), "couples": couples, "gives": _per_tetrahedron(gives)}
        if not isinstance(law, TransverselyIsotropic):
            return {**values, "k": 0.0, "a": np.zeros((3, 1, 1))}, moduli
        check_fibres(moduli)
        fibres = {"k": _per_tetrahedron(law.fibre_modulus * E), "a": law.fibre[:, None, None]}
        return {**values, **fibres}, moduli

    def given(self, load: Load) -> Array:
        """(basis.N,) displacement prescribed at the surface; an edge's middle takes the mean of its ends [m]."""
        x = self.basis.zeros()
        x[self.basis.nodal_dofs[:, self.surface_nodes]] = np.asarray(load.prescribed).T
        x[self.basis.edge_dofs] = x[self.basis.nodal_dofs[:, self.mesh.edges]].mean(axis=1)
        return x

    def pressure_at_points(self, load: Load) -> Array:
        """(F, Q) pressure at the points of `surface_basis` [Pa], whose facets have ascending vertices."""
        rising = np.argsort(self.surface_nodes[self.triangles], axis=1)
        # the rule's points come in threes, one nearest to each vertex or each edge
        threes = np.asarray(load.facet_pressure, dtype=np.float64).reshape(len(rising), -1, 3)
        return np.take_along_axis(threes, rising[:, None, :], axis=2).reshape(len(rising), -1)

    def body_forces(self, load: Load, density: float) -> Array:
        """(basis.N,) forces of gravity and given forces [N]."""
        g = load.gravity
        form = LinearForm(lambda v, _: density * (g[0] * v[0] + g[1] * v[1] + g[2] * v[2]))
        given = 0.0 if load.forces is None else np.ravel(load.forces)  # nodal values are dofs
        return np.asarray(form.assemble(self.basis) + given)

    def dead_pressure(self, load: Load) -> Array:
        """(basis.N,) forces of the traction -p n on the undeformed surface [N]."""
        form = LinearForm(lambda v, w: -w.pressure * dot(w.n, v))
        return np.asarray(form.assemble(self.surface_basis, pressure=self.pressure_at_points(load)))

    def at_surface(self, x: Array) -> Array:
        """(N, 3) values of a dof vector at the surface vertices."""
        return x[self.basis.nodal_dofs[:, self.surface_nodes]].T

    def gathered(self, forces: Array) -> Array:
        """(N, 3) nodal forces at the surface vertices; an edge's force goes half to each end."""
        total = forces[self.basis.nodal_dofs]
        for end in self.mesh.edges:
            np.add.at(total.T, end, 0.5 * forces[self.basis.edge_dofs].T)
        return total[:, self.surface_nodes].T

    def solution(
        self, steps: Sequence[Dofs], wanted: int, seconds_setup: float, parameters: Mapping[str, float | str]
    ) -> Solution:
        """A model's result from the steps of a load history; NaN for steps that are `wanted` and missing."""

        def column(values: Sequence[Any]) -> Array:
            missing = np.full((wanted - len(values), *np.shape(values[0])), np.nan)
            return np.concatenate([np.asarray(values, dtype=np.float64), missing])

        scalars = {"relative_residual": column([x.residual for x in steps])}
        scalars |= {name: column([x.scalars[name] for x in steps]) for name in steps[0].scalars}
        return Solution(
            displacement=column([self.at_surface(x.displacement) for x in steps]),
            fluid_pressure=column([x.mean_pressure for x in steps]),
            reaction_force=column([self.gathered(x.reaction) for x in steps]),
            energy=column([x.energy for x in steps]),
            iterations=np.nan_to_num(column([x.iterations for x in steps])).astype(np.int64),
            status=(*(x.status for x in steps), *[NOT_REACHED] * (wanted - len(steps))),
            seconds_setup=seconds_setup,
            seconds_per_step=np.nan_to_num(column([x.seconds for x in steps])),
            parameters={
                "element": "P2-P1",
                "solver": "plain",
                "factorisation": "SuperLU",
                "dofs": float(self.basis.N + self.pressure_basis.N - len(self.held_dofs)),
                "tetrahedra": float(self.mesh.nelements),
                **parameters,
            },
            scalars=scalars,
        )


def _per_tetrahedron(value: Array) -> Array:
    """(1, 1) or (m, 1), which broadcasts to (m, Q) values at quadrature points."""
    return np.reshape(value, (-1, 1))


def lu_status(residual: float) -> Status:
    """The status of a solve by LU with this relative residual."""
    if residual <= DIRECT_TOLERANCE:
        return CONVERGED
    message = f"the LU factor gave a relative residual of {residual:.1e}, {DIRECT_TOLERANCE:.0e} is needed"
    return Status("not-converged", message, "hold more of the surface, or improve the worst tetrahedra")
