"""Linear elasticity on a coarser mesh of the same body: what the elements give at the price of a surface model.

The coarse body is made from the case's own surface, remeshed and filled. Displacement goes from its quadratic
facets to the case's surface nodes by their shape functions, forces the other way by the transpose, which keeps
the resultant and the work.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from fem_reference.linear import LinearProblem
from fem_reference.loads import Load, nodal_forces, prescribed_nodes
from fem_reference.mesh import TetMesh, triangle_p2
from fem_reference.solution import CONVERGED, Solution, SolverError, Status
from fem_reference.springs import ElasticSupport
from solver_common.arrays import Array, Index, Mask
from solver_common.quadrature import facet_quadrature

from ..body.geometry import fill_surface
from ..body.mesh import Mesh
from ..body.surface_measures import Surface, enclosed_volume, facet_areas
from ..scene.inclusions import moduli, on_mesh
from ..scene.scene import Scene, SurfaceLoad
from ..scene.warnings import motion_share

FEW_NODES = 400  # of the surface of a mesh that tells how far a load moves the body
COARSENING = 2.0  # edge of the coarse mesh over that of the case's own
MOST_OFF = 0.5  # of the support's area on the coarse mesh, over that of the case's own
SMALL_SUPPORT = Status(
    "small-support",
    f"the support is too small for the coarse mesh, whose edges are {COARSENING:g} times as long: "
    f"the facets that could hold there have an area more than {MOST_OFF:.0%} off",
    "hold a wider region, or take a smaller mesh_size",
)
_CHUNK = 256  # points per pass: bounds the temporary arrays


def coarse_mesh(mesh: Mesh, coarsening: float = COARSENING) -> Mesh:
    """The same body with edges `coarsening` times as long, from its surface.

    Raises
    ------
    MeshError
        a surface that cannot be remeshed as coarsely.
    """
    corners = mesh.surface_points[mesh.triangles]
    edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    return fill_surface(mesh.surface_points, mesh.triangles, coarsening * edge)


def coarse_support(scene: Scene, coarse: Mesh) -> tuple[Mask, Index]:
    """(n_coarse,) held nodes of the coarse surface, and the scene's held node nearest to each of its nodes.

    A support is the facets whose three nodes are held. On nodes as far apart as these its area is what decides
    how a body rocks: nodes are held up to the distance at which the area is closest to that of the scene.

    Raises
    ------
    SolverError
        a support so small that what coarse facets can hold has another area, by more than half.
    """
    nodes = np.flatnonzero(scene.held)
    if not len(nodes):
        return np.zeros(len(coarse.surface_nodes), dtype=bool), np.zeros(
            len(coarse.surface_nodes), dtype=np.int64
        )
    found = cKDTree(scene.mesh.surface_points[nodes]).query(coarse.surface_points)
    distance, place = np.asarray(found[0]), np.asarray(found[1])
    of_facet = distance[coarse.triangles].max(axis=1)
    order = np.argsort(of_facet)
    covered = np.cumsum(_areas(coarse)[order])
    wanted = _areas(scene.mesh)[scene.held[scene.mesh.triangles].all(axis=1)].sum()
    closest = np.abs(covered - wanted).argmin()
    if not abs(covered[closest] - wanted) <= MOST_OFF * wanted:
        raise SolverError(SMALL_SUPPORT)
    reach = of_facet[order][closest]
    return distance <= reach, nodes[place]


def coarse_springs(scene: Scene, coarse: Mesh) -> list[ElasticSupport]:
    """The scene's springs under the coarse facets whose nearest facet has them, of the same stiffness altogether.

    Raises
    ------
    SolverError
        springs under no coarse facet.
    """
    if not scene.springs:
        return []
    tree = cKDTree(scene.mesh.surface_points[scene.mesh.triangles].mean(axis=1))
    nearest = np.asarray(tree.query(coarse.surface_points[coarse.triangles].mean(axis=1))[1])
    own, areas = _areas(scene.mesh), _areas(coarse)
    found = []
    for part in scene.springs:
        facets = part.facets[nearest]
        if not facets.any():
            raise SolverError(SMALL_SUPPORT)
        stiffness = part.stiffness * own[part.facets].sum() / areas[facets].sum()
        found.append(ElasticSupport(facets, stiffness, part.direction))
    return found


def _areas(mesh: Mesh) -> Array:
    return facet_areas(mesh.surface_points, mesh.triangles)


def _volume(mesh: Mesh) -> float:
    return enclosed_volume(mesh.surface_points, mesh.triangles)


def expected_motion(scene: Scene) -> tuple[float, float]:
    """How far the body moves at full load, over its smallest extent, and the change of its volume, over that.

    Of linear elasticity with the weight, on a mesh of some `FEW_NODES` surface nodes, in about a second.

    Raises
    ------
    ValueError
        a body that cannot be made so coarse, or that nothing holds.
    """
    points, triangles = scene.mesh.surface_points, scene.mesh.triangles
    coarsening = max(1.0, float(np.sqrt(len(points) / FEW_NODES)))
    load = scene.load(float(scene.load_factors[np.abs(scene.load_factors).argmax()]))
    (displacement,) = CoarseProblem(scene, 1, coarsening).solve([load]).displacement
    drift = enclosed_volume(points + displacement, triangles) / enclosed_volume(points, triangles) - 1.0
    extent = Surface(points, triangles).smallest_extent
    pushed = load.depth / extent  # an indenter moves the surface under it
    return max(pushed, motion_share(displacement, scene.held, extent)), abs(drift)


class CoarseProblem:
    """Answers loads of a scene's body with the mixed P2-P1 element on a coarser mesh, at the scene's surface nodes.

    Contact is the scene's nodal forces, and the body weighs what the scene's does, whatever volume flatter facets
    leave it. Coarse nodes are held within the distance of the scene's held nodes that
    gives the support its area; reactions go to the nearest held node. Held nodes of the scene have the
    displacement that is given.

    Raises
    ------
    ValueError
        MeshError where the body cannot be remeshed as coarsely, SolverError of a support that is too small for it,
        or what `LinearProblem` refuses.
    """

    def __init__(self, scene: Scene, n_loads: int, coarsening: float = COARSENING) -> None:
        start = time.perf_counter()
        self._scene = scene
        coarse, tissue, fibres = coarse_mesh(scene.mesh, coarsening), scene.tissue, scene.anisotropy
        held, self._nearest = coarse_support(scene, coarse)
        young: ArrayLike = tissue.youngs_modulus
        ratio: ArrayLike = tissue.poisson_ratio
        options: dict[str, Any] = {"elastic_supports": coarse_springs(scene, coarse)}
        if fibres:
            options |= {"fibre_direction": fibres.fibre_direction, "contrast": fibres.contrast}
        if scene.inclusions:
            placed = on_mesh([part.declared for part in scene.inclusions], coarse)
            young, ratio, options["parts"] = moduli(tissue, placed)
        self.problem = LinearProblem(
            coarse.points,
            coarse.tetrahedra,
            coarse.surface_nodes,
            coarse.triangles,
            youngs_modulus=young,
            poisson_ratio=ratio,
            density=tissue.density * _volume(scene.mesh) / _volume(coarse),
            held=held,
            solver="direct",
            expected_loads=n_loads,
            **options,
        )
        self._interpolation = surface_interpolation(self.problem.mesh, scene.mesh.surface_points)
        self._coarse = coarse
        self._seconds = time.perf_counter() - start

    def solve(self, loads: Sequence[SurfaceLoad]) -> Solution:
        """One step per load, independent of each other and solved together."""
        scene, problem, tissue, start = self._scene, self.problem, self._scene.tissue, time.perf_counter()
        mesh, interpolation, count = problem.mesh, self._interpolation, len(loads)
        no_pressure = np.zeros((len(mesh.triangles), len(facet_quadrature()[1])))
        coarse = [Load(no_pressure, one.prescribed[self._nearest], one.gravity) for one in loads]
        forces = nodal_forces(mesh, coarse, problem.density)
        for own, load in zip(forces, loads, strict=True):
            own += interpolation.T @ (load.contact_force + load.dead_force)
        fields = problem.solve_nodal(forces, prescribed_nodes(mesh, coarse))
        displacement = np.array([interpolation @ u for u in fields.displacement])
        displacement[:, scene.held] = [load.prescribed[scene.held] for load in loads]
        work = ((forces + fields.reaction) * fields.displacement).sum(axis=(1, 2))
        residual = np.asarray(fields.residual)
        return Solution(
            displacement=displacement,
            fluid_pressure=problem.mean_pressure(fields),
            reaction_force=np.array([_reaction(scene, problem, nodal) for nodal in fields.reaction]),
            energy=0.5 * work,
            iterations=np.zeros(count, dtype=np.int64),
            status=tuple(
                CONVERGED if one <= problem.solver.tolerance else _not_converged(one)
                for one in residual.tolist()
            ),
            seconds_setup=self._seconds,
            seconds_per_step=np.full(count, (time.perf_counter() - start) / count),
            parameters={
                "youngs_modulus": tissue.youngs_modulus,
                "poisson_ratio": tissue.poisson_ratio,
                "coarse_density": problem.density,  # flatter facets hold less: the weight is the case's own
                "coarse_tetrahedra": float(len(self._coarse.tetrahedra)),
                "coarse_surface_nodes": float(len(self._coarse.surface_nodes)),
                "dofs": float(problem.system.size),
            },
            scalars={
                "relative_residual": residual,
                **({"condition_estimate": np.full(count, problem.condition)} if scene.condition else {}),
            },
        )


def _reaction(scene: Scene, problem: LinearProblem, nodal: Array) -> Array:
    """(N, 3) coarse reactions (n_nodes, 3), each at the nearest node of the scene that is held or has springs."""
    held = np.flatnonzero(scene.supported)
    pulling = np.flatnonzero(nodal.any(axis=1))
    place = cKDTree(scene.mesh.surface_points[held]).query(problem.mesh.node_points[pulling])[1]
    out = np.zeros((len(scene.held), 3))
    np.add.at(out, held[place], nodal[pulling])
    return out


def surface_interpolation(mesh: TetMesh, points: Array) -> csr_array:
    """(N, n_nodes) shape functions of the coarse facets near to (N, 3) points: each row sums to one."""
    corners = mesh.points[mesh.surface_nodes[mesh.triangles]]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    gram = np.stack(
        [np.einsum("fi,fi->f", a, b) for a, b in ((first, first), (first, second), (second, second))]
    )
    scale = gram[0] * gram[2] - gram[1] ** 2
    rows, values = [], []
    for start in range(0, len(points), _CHUNK):
        some = points[start : start + _CHUNK]
        offset = some[:, None, :] - corners[None, :, 0]
        p, q = (np.einsum("nfi,fi->nf", offset, edge) for edge in (first, second))
        b = np.stack([(gram[2] * p - gram[1] * q) / scale, (gram[0] * q - gram[1] * p) / scale], axis=2)
        inside = np.concatenate([1.0 - b.sum(axis=2, keepdims=True), b], axis=2).clip(0.0)
        inside /= inside.sum(axis=2, keepdims=True)
        gap = np.linalg.norm(np.einsum("nfa,fai->nfi", inside, corners) - some[:, None, :], axis=2)
        facet = gap.argmin(axis=1)
        rows.append(mesh.facet_nodes[facet])
        values.append(triangle_p2(inside[np.arange(len(some)), facet]))
    nodes, weights = np.concatenate(rows), np.concatenate(values)
    indptr = np.arange(0, nodes.size + 1, nodes.shape[1])
    return csr_array((weights.ravel(), nodes.ravel(), indptr), shape=(len(points), mesh.n_nodes))


def _not_converged(residual: float) -> Status:
    return Status(
        "not-converged",
        f"the coarse mesh's solver reached a relative residual of {residual:.1e}",
        "use a smaller mesh_size",
    )
