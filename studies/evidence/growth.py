"""How the cost of the surface model grows: spheres of up to 163,842 nodes: set-up, frame, fill and work."""

from __future__ import annotations

import time
from collections.abc import Collection
from functools import partial

import numpy as np
from scipy import sparse
from scipy.sparse import linalg

from solver_common.arrays import Array, Index
from vdm import Load, Model, Parameters, SurfaceMesh
from vdm.formulations.vector import VectorFormulation

from .bench_data import Growth, median
from .timing import median_seconds

LEVELS, LARGE_LEVELS = (2, 3, 4, 5), (3, 4, 5, 6, 7)
QUANTITIES = {"set-up": "s", "frame": "s", "fill": "1", "flops": "1"}
FORMULATIONS = ("paper", "consistent", "vector")
RADIUS = 0.05
_PATIENCE = 10.0  # seconds after which a surface is measured no further
_GOLDEN = (1.0 + 5.0**0.5) / 2.0


def sphere(levels: int) -> tuple[Array, Index]:
    """An icosahedron whose facets are split into four `levels` times: 10 * 4^levels + 2 nodes on a sphere."""
    corners = [(0.0, s, t * _GOLDEN) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    points = np.array([np.roll(corner, k) for k in range(3) for corner in corners])
    n = range(len(points))
    sides = [(i, j, k) for i in n for j in range(i) for k in range(j)]
    triangles = np.array([f for f in sides if _longest_side(points[list(f)]) < 2.1])
    inward = np.linalg.det(points[triangles]) < 0.0
    triangles[inward, :2] = triangles[inward, 1::-1]
    for _ in range(levels):
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
        pairs, place = np.unique(ends, axis=0, return_inverse=True)
        ab, bc, ca = (len(points) + place.reshape(-1, 3)).T
        a, b, c = triangles.T
        points = np.concatenate([points, points[pairs].mean(axis=1)])
        split = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in split])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return RADIUS * points / np.linalg.norm(points, axis=1, keepdims=True), triangles


def _longest_side(corners: Array) -> float:
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())


def growths(rounds: int, names: Collection[str], *, large: bool = False) -> list[Growth]:
    """Set-up [s], one load over all nodes [s], fill and work of a factor, for each sparse formulation among models.

    Fill and work are those of a stand-in, a factor by SuperLU's symmetric minimum degree ordering: that in use,
    cholespy's by METIS, does not tell its own.
    """
    out = []
    levels = LARGE_LEVELS if large else LEVELS
    for formulation in FORMULATIONS:
        if f"vdm-{formulation}" not in names:
            continue
        measured = [_measure(formulation, level, rounds) for level in levels]
        nodes, *columns = (np.array(column, dtype=float) for column in zip(*measured, strict=True))
        for (what, unit), values in zip(QUANTITIES.items(), columns, strict=True):
            out.append(Growth(f"vdm-{formulation} {what}", unit, nodes, values))
    return out


def _measure(formulation: str, levels: int, rounds: int) -> tuple[float, ...]:
    points, triangles = sphere(levels)
    parameters = Parameters.from_tissue(5000.0, SurfaceMesh(points, triangles), formulation)
    fixed = points[:, 2] < -0.9 * RADIUS
    load = Load(100.0 * (points[:, 2] / RADIUS) ** 2)
    setups: list[float] = []
    frames: list[float] = []
    start = time.perf_counter()
    for _ in range(rounds):
        if setups and time.perf_counter() - start > _PATIENCE:
            break
        model = Model(points, triangles, parameters, formulation=formulation, fixed=fixed)
        setups.append(model.seconds_setup)
        frames.append(median_seconds(partial(model.solver.step, load)))
    return len(points), median(np.array(setups)), median(np.array(frames)), *fill_and_flops(model)


def fill_and_flops(model: Model) -> tuple[int, int]:
    """Non-zeros of one triangular factor of the matrix that a sparse model's solver factors, and its work.

    A column with c non-zeros costs c^2 operations: a multiplication and an addition for each entry of the triangle
    that it updates.
    """
    block = factored(model)
    options = {"SymmetricMode": True}
    factor = linalg.splu(block, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    columns = np.diff(factor.L.indptr).astype(np.int64)
    return int(columns.sum()), int((columns**2).sum())


def factored(model: Model) -> sparse.csc_array:
    """The matrix that a sparse model's solver factors: the vector form's three components share one."""
    form, free = model.formulation, model.problem.free
    matrix = form.tension if isinstance(form, VectorFormulation) else form.stiffness()
    return sparse.csc_array(matrix[free][:, free])
