"""Loads and supports on the surface, as forces and given displacements at the nodes of the element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fem_reference.assembly import gravity_weights
from fem_reference.krylov import independent_columns
from fem_reference.mesh import TetMesh
from fem_reference.springs import Springs
from solver_common.arrays import Array, Mask
from solver_common.quadrature import facet_quadrature
from solver_common.solution import solver_error

_bad_load = partial(solver_error, "bad-load")
_bad_support = partial(solver_error, "bad-support")
_not_held = partial(solver_error, "not-held")
# largest remainder of a combination of loads, relative to the load's norm
_DEPENDENT = 1e-13
# largest difference from a multiple of a load, relative to its largest value: rounding
_SAME = 1e-14
# largest number in a load: the square of its response does not overflow
_LARGEST = 1e100


@dataclass(frozen=True)
class Load:
    """One load step.

    Attributes
    ----------
    facet_pressure : (F, Q) pressure at the points of `mesh.facet_quadrature`, positive pushes into the body [Pa]
    prescribed : (N, 3) displacement of the held surface nodes; ignored elsewhere [m]
    gravity : (3,) acceleration [m/s^2]
    forces : (n_nodes, 3) given forces at the nodes, see `fem_reference.forces`; None for none [N]
    """

    facet_pressure: Array
    prescribed: Array
    gravity: Array
    forces: Array | None = None


def check_loads(mesh: TetMesh, loads: Sequence[Load]) -> None:
    """Raise a `SolverError` for a load of the wrong shape or with values that are not finite."""
    if not loads:
        raise _bad_load("there is no load step", "give at least one load")
    shapes = {
        "facet_pressure": (len(mesh.triangles), len(facet_quadrature()[1])),
        "prescribed": (len(mesh.surface_nodes), 3),
        "gravity": (3,),
        "forces": (mesh.n_nodes, 3),
    }
    for step, load in enumerate(loads, 1):
        for name, shape in shapes.items():
            if name == "forces" and load.forces is None:
                continue
            value, what = np.asarray(getattr(load, name)), f"{name} of load step {step} has"
            if value.shape != shape:
                raise _bad_load(f"{what} shape {value.shape}", f"give shape {shape}")
            if not np.isfinite(value).all():
                raise _bad_load(f"{what} values that are not finite", "give finite numbers")
            if np.abs(value).max(initial=0.0) > _LARGEST:
                raise _bad_load(f"{what} values beyond {_LARGEST:.0e}", "give a load that a body can carry")


def loads_at(mesh: TetMesh, depths: Sequence[float], load: Load | Sequence[Load] | None) -> list[Load]:
    """All other loads at each depth of an indenter: none, one load for all, or one for each.

    Raises a `SolverError` for depths that are missing or not finite, and for a wrong number of loads.
    """
    if not len(depths) or not np.isfinite(depths).all():
        raise _bad_load(f"the depths are {list(depths)}", "give one finite number of metres or more")
    if load is None:
        pressure = np.zeros((len(mesh.triangles), len(facet_quadrature()[1])))
        load = Load(pressure, np.zeros((len(mesh.surface_nodes), 3)), np.zeros(3))
    loads = [load] * len(depths) if isinstance(load, Load) else list(load)
    if len(loads) != len(depths):
        raise _bad_load(f"{len(loads)} loads go with {len(depths)} depths", "give one for each depth")
    return loads


def check_nodal(mesh: TetMesh, forces: Array, prescribed: Array) -> None:
    """Raise a `SolverError` for nodal arrays that are not (S, n_nodes, 3), one S for both, or not finite."""
    shape = (len(forces), mesh.n_nodes, 3)
    for name, value in (("forces", forces), ("prescribed", prescribed)):
        if not len(forces) or value.shape != shape:
            remedy = f"give shape (load steps, {mesh.n_nodes}, 3) for both arrays"
            raise _bad_load(f"{name} at the nodes has shape {value.shape}", remedy)
        if not np.isfinite(value).all():
            raise _bad_load(f"{name} at the nodes has values that are not finite", "give finite numbers")


def nodal_forces(mesh: TetMesh, loads: Sequence[Load], density: float) -> Array:
    """Consistent forces of pressure and weight, and given forces, at all nodes: (S, n_nodes, 3) [N].

    `density` in kg/m^3. The sum over the nodes is the load's resultant to rounding.
    """
    points, weights = facet_quadrature()
    shape = mesh.facet_functions(points)
    forces = np.zeros((len(loads), mesh.n_nodes, 3))
    gravities = np.array([load.gravity for load in loads], dtype=np.float64)
    if density and gravities.any():
        forces += density * gravity_weights(mesh)[None, :, None] * gravities[:, None, :]
    for force, load in zip(forces, loads, strict=True):
        pressure = np.asarray(load.facet_pressure) * weights
        force -= mesh.summed(mesh.facet_nodes, (pressure @ shape)[:, :, None] * mesh.area_vectors[:, None])
        if load.forces is not None:
            force += load.forces
    return forces


def check_cavities(mesh: TetMesh, cavities: ArrayLike | None) -> Mask:
    """(F, k) facets of the walls of k cavities; k is 0 for None.

    Raises
    ------
    SolverError
        another array than a mask of the facets, or a wall that is not closed.
    """
    count = len(mesh.triangles)
    walls = np.zeros((count, 0), dtype=bool) if cavities is None else np.asarray(cavities)
    if walls.dtype != bool or walls.ndim != 2 or len(walls) != count:
        raise _bad_load(
            f"cavities is an array of {walls.dtype} of shape {walls.shape}", f"give a mask ({count}, k)"
        )
    left = np.linalg.norm(walls.T @ mesh.area_vectors, axis=1)
    if (left > 1e-9 * (walls.T @ np.linalg.norm(mesh.area_vectors, axis=1))).any():
        raise _bad_load("the wall of a cavity is not closed", "give all of its facets")
    return walls


def cavity_forces(mesh: TetMesh, cavities: Mask) -> Array:
    """(k, n_nodes, 3) forces of a unit pressure on each wall (F, k): the gradient of the cavity's volume [m^2]."""
    nothing, weights = np.zeros((len(mesh.surface_nodes), 3)), facet_quadrature()[1]
    loads = [Load(np.outer(wall, np.ones_like(weights)), nothing, np.zeros(3)) for wall in cavities.T]
    return nodal_forces(mesh, loads, 0.0)


def held_nodes(mesh: TetMesh, held: Mask, springs: Springs | None = None) -> Mask:
    """(n_nodes, 3) held components of all nodes from the (N,) or (N, 3) mask of the surface nodes.

    An edge's middle is held where a facet of the edge has three held vertices.

    Raises
    ------
    SolverError
        If the mask has a wrong shape, or a body can still move rigidly, springs or not.
    """
    count = len(mesh.surface_nodes)
    given = np.asarray(held)
    if given.dtype != bool:
        raise _bad_support(f"held is an array of {given.dtype}, not of true and false", "give a mask")
    mask = given
    if mask.shape == (count,):
        mask = np.repeat(mask[:, None], 3, axis=1)
    if mask.shape != (count, 3):
        raise _bad_support(f"held has shape {mask.shape}", f"give shape ({count},) or ({count}, 3)")
    out = np.zeros((mesh.n_nodes, 3), dtype=bool)
    out[mesh.surface_nodes] = mask
    _check_rigid_motion(mesh, out, springs)
    if mesh.order == 2:
        for k in range(3):
            facets = np.all(mask[mesh.triangles, k], axis=1)
            edges = mesh.facet_edges[facets].ravel()
            out[mesh.surface_edge_nodes[edges], k] = True
    return out


def prescribed_nodes(mesh: TetMesh, loads: Sequence[Load]) -> Array:
    """(S, n_nodes, 3) displacement given at the surface; an edge's middle takes the mean of its ends [m]."""
    values = np.zeros((len(loads), mesh.n_nodes, 3))
    given = np.array([load.prescribed for load in loads], dtype=np.float64)
    given = given.reshape(len(loads), len(mesh.surface_nodes), 3)
    values[:, mesh.surface_nodes] = given
    values[:, mesh.surface_edge_nodes] = 0.5 * given[:, mesh.surface_edges].sum(axis=2)
    return values


def independent_loads(loads: Sequence[Load]) -> tuple[NDArray[np.int64], Array]:
    """A subset of the loads with all others as combinations: linear results need only its solutions.

    Returns
    -------
    chosen : (r,) ascending numbers of loads
    coefficients : (r, S); load s is the sum over k of coefficients[k, s] times load chosen[k], to rounding
    """
    # histories and sweeps are mostly runs of multiples, which are cheaper to find than combinations
    size = max((np.size(load.forces) for load in loads if load.forces is not None), default=0)
    first, share = _runs_of_multiples([_kinds(load, size) for load in loads])
    heads, run = np.unique(first, return_inverse=True)
    parts = [np.array(part) for part in zip(*(_kinds(loads[k], size) for k in heads), strict=True)]
    # pressures, lengths and accelerations side by side, each kind in units of its largest value
    kinds = [part[:, part.any(axis=0)] / np.abs(part).max() for part in parts if part.any()]
    if not kinds:
        return np.zeros(0, dtype=np.int64), np.zeros((0, len(loads)))
    columns = np.concatenate(kinds, axis=1).T
    chosen, coefficients = independent_columns(columns, _DEPENDENT)
    order = np.argsort(chosen)
    return heads[chosen[order]], coefficients[order][:, run] * share


def _kinds(load: Load, size: int) -> tuple[Array, ...]:
    """Pressure, prescribed displacement, weight and `size` given forces, each flat."""
    forces = np.zeros(size) if load.forces is None else load.forces
    parts = (load.facet_pressure, load.prescribed, load.gravity, forces)
    return tuple(np.ravel(np.asarray(part, dtype=np.float64)) for part in parts)


def _runs_of_multiples(loads: Sequence[tuple[Array, ...]]) -> tuple[NDArray[np.int64], Array]:
    """For each load the first of its run of multiples, and the factor; a load without a run is its own first."""
    first, share = np.arange(len(loads)), np.ones(len(loads))
    for k in range(1, len(loads)):
        found = _multiple_of(loads[first[k - 1]], loads[k])
        if found is not None:
            first[k], share[k] = first[k - 1], found
    return first, share


def _multiple_of(load: Sequence[Array], other: Sequence[Array]) -> float | None:
    """The factor c where `other` is c times `load`, to rounding in each kind; None where it is not.

    Parameters
    ----------
    load, other : arrays of as many kinds, such as pressures and displacements, of one shape each
    """
    places = [np.flatnonzero(part) for part in load]  # usually few
    parts = [part.ravel()[place] for part, place in zip(load, places, strict=True)]
    others = [part.ravel()[place] for part, place in zip(other, places, strict=True)]
    kind = next((kind for kind, place in enumerate(places) if len(place)), None)
    if kind is None or any(
        np.count_nonzero(part) != np.count_nonzero(there) for part, there in zip(other, others, strict=True)
    ):
        return None
    largest = np.abs(parts[kind]).argmax()
    with np.errstate(over="ignore", invalid="ignore"):  # a factor that is not finite counts as no multiple
        share = float(others[kind][largest] / parts[kind][largest])
        for part, there in zip(parts, others, strict=True):
            gap = np.abs(there - share * part).max(initial=0.0)
            if not gap <= _SAME * np.abs(there).max(initial=0.0):
                return None
    return share


def gather_to_vertices(mesh: TetMesh, nodal: Array) -> Array:
    """(S, N, 3) sums at surface vertices of (S, n_nodes, 3); an edge's value goes half to each end."""
    out = np.array(nodal[:, mesh.surface_nodes])
    halves = 0.5 * nodal[:, mesh.surface_edge_nodes]
    for end in range(2):
        for step, half in zip(out, halves, strict=True):
            np.add.at(step, mesh.surface_edges[:, end], half)
    return out


def _check_rigid_motion(mesh: TetMesh, held: Mask, springs: Springs | None) -> None:
    vertices = np.flatnonzero(held[: mesh.n_vertices].any(axis=1))
    rows = held[vertices][:, :, None] * np.eye(3)  # the directions in which each vertex is held
    if springs is not None:
        sprung, directions = springs.rigid_rows(mesh)
        vertices, rows = np.concatenate([vertices, sprung]), np.concatenate([rows, directions])
    if not len(vertices):
        raise _not_held("nothing is held, so the body can move freely", "hold a part of the surface")
    count, label = mesh.components
    for body in range(count):
        mine = label[vertices] == body
        if _rigid_rank(mesh.points[vertices[mine]], rows[mine]) < 6:
            name = "the body" if count == 1 else f"body {body} of {count}"
            raise _not_held(
                f"too little is held: {name} can still move or turn freely",
                "hold an area of the surface, the nodes of some of its facets",
            )


def _rigid_rank(points: Array, rows: Array) -> int:
    """Rank of the six rigid motions along (k, 3, 3) directions at (k, 3) points, scaled by their spread."""
    if not len(points):
        return 0
    x = points - points.mean(axis=0)
    x = x / max(float(np.abs(x).max()), np.finfo(np.float64).tiny)
    modes = (rows @ rigid_modes(x)).reshape(-1, 6)
    return int(np.linalg.matrix_rank(modes, tol=1e-9 * np.sqrt(len(points))))


def rigid_modes(points: Array) -> Array:
    """(n, 3, 6) displacements of the three translations and the three rotations about the origin."""
    modes = np.zeros((len(points), 3, 6))
    modes[:, :, :3] = np.eye(3)
    for k in range(3):
        axis = np.zeros(3)
        axis[k] = 1.0
        modes[:, :, 3 + k] = np.cross(axis, points)
    return modes
