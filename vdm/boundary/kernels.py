"""Double integrals of 1/r, r r / r^3 and of Laplace's double layer over pairs of facets, compiled.

Of a facet f with points x and a facet g with points y, r = y - x:

`B = int int r r / r^3` (six numbers; its trace is that of 1/r), and for each corner a of g with the shape function
phi_a `k_a = -1/(4 pi) int int (r . n_g) phi_a / r^3` (Laplace's double layer, tested with a constant on f), and the
same with f and g exchanged. They do not depend on the material.
"""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index
from solver_common.quadrature import facet_quadrature
from vdm.boundary.far import far_row
from vdm.boundary.jit import compiled
from vdm.boundary.plane import add_near, graded
from vdm.boundary.quadrature import Rule, sixteen_points, three_points, touching

# distance of two facets' centres over the sum of their radii, from which a product of two rules is enough
FAR, MIDDLE, NEAR = 4.0, 2.0, 1.15
# longest edge over its height, up to which the maps of facets that touch have points enough
SLENDER = 3.0
# the twelve integrals of a pair: xx, yy, zz, xy, xz, yz of B, k of g by its corners, k of f by its corners
COUNT = 12


def rules() -> tuple[Array, Index, Array, Array]:
    """All rules as one table (5, n) of two coordinates of x, two of y and the weight, and each rule's start (7,).

    Last the points and weights of `vdm.boundary.plane.graded`.

    In the order: one vertex, one edge, the same facet, then far, middle and near facets that do not touch.
    """
    parts = [
        *touching(),
        *(_product(*rule) for rule in (three_points(), facet_quadrature(), sixteen_points())),
    ]
    table = np.concatenate([np.stack([*x.T[1:], *y.T[1:], w]) for x, y, w in parts], axis=1)
    starts = np.cumsum([0, *(len(part[2]) for part in parts)])
    return np.ascontiguousarray(table), starts.astype(np.int64), *graded()


def _product(points: Array, weights: Array) -> Rule:
    n = len(weights)
    return np.repeat(points, n, axis=0), np.tile(points, (n, 1)), np.outer(weights, weights).ravel()


@compiled
def add_rule(table, lower, upper, p, q, m, n, i, j, total):
    """Add to `total` (12,) the integrals over the triangles p and q (3, 3), whose normals are m and n.

    The rule's first to third corners are those of numbers i and j (3,).
    """
    # r = s + y1 c + y2 d - x1 a - x2 b
    ax, ay, az = p[i[1], 0] - p[i[0], 0], p[i[1], 1] - p[i[0], 1], p[i[1], 2] - p[i[0], 2]
    bx, by, bz = p[i[2], 0] - p[i[0], 0], p[i[2], 1] - p[i[0], 1], p[i[2], 2] - p[i[0], 2]
    cx, cy, cz = q[j[1], 0] - q[j[0], 0], q[j[1], 1] - q[j[0], 1], q[j[1], 2] - q[j[0], 2]
    dx, dy, dz = q[j[2], 0] - q[j[0], 0], q[j[2], 1] - q[j[0], 1], q[j[2], 2] - q[j[0], 2]
    sx, sy, sz = q[j[0], 0] - p[i[0], 0], q[j[0], 1] - p[i[0], 1], q[j[0], 2] - p[i[0], 2]
    nx, ny, nz, mx, my, mz = n[0], n[1], n[2], m[0], m[1], m[2]
    xx = yy = zz = xy = xz = yz = g0 = g1 = g2 = f0 = f1 = f2 = 0.0
    # contiguous parts, counted from zero: else the compiler does not take several points at once
    first, second, third = table[0][lower:upper], table[1][lower:upper], table[2][lower:upper]
    fourth, weights = table[3][lower:upper], table[4][lower:upper]
    for k in range(len(weights)):
        x1, x2, y1, y2 = first[k], second[k], third[k], fourth[k]
        rx = sx + y1 * cx + y2 * dx - x1 * ax - x2 * bx
        ry = sy + y1 * cy + y2 * dy - x1 * ay - x2 * by
        rz = sz + y1 * cz + y2 * dz - x1 * az - x2 * bz
        square = rx * rx + ry * ry + rz * rz
        w = weights[k] / (square * np.sqrt(square))
        xx += w * rx * rx
        yy += w * ry * ry
        zz += w * rz * rz
        xy += w * rx * ry
        xz += w * rx * rz
        yz += w * ry * rz
        g = w * (rx * nx + ry * ny + rz * nz)
        f = w * (rx * mx + ry * my + rz * mz)
        g0 += g
        g1 += g * y1
        g2 += g * y2
        f0 += f
        f1 += f * x1
        f2 += f * x2
    total[0] += xx
    total[1] += yy
    total[2] += zz
    total[3] += xy
    total[4] += xz
    total[5] += yz
    total[6 + j[0]] -= (g0 - g1 - g2) * 0.25 / np.pi
    total[6 + j[1]] -= g1 * 0.25 / np.pi
    total[6 + j[2]] -= g2 * 0.25 / np.pi
    total[9 + i[0]] += (f0 - f1 - f2) * 0.25 / np.pi
    total[9 + i[1]] += f1 * 0.25 / np.pi
    total[9 + i[2]] += f2 * 0.25 / np.pi


@compiled
def _square(x, y):
    """Square of the distance of two points (3,)."""
    a, b, c = x[0] - y[0], x[1] - y[1], x[2] - y[2]
    return a * a + b * b + c * c


@compiled
def _shared_first(t, v, p, q, i, j):
    """Number of nodes that facets of nodes t and v (3,) share; i, j (3,) become their corners, shared ones first.

    Their order is one of lengths, so that a mirror image of the body has the same one.
    """
    shared = 0
    for a in range(3):
        for b in range(3):
            if t[a] == v[b]:
                i[shared], j[shared] = a, b
                shared += 1
    k = n = shared
    for c in range(3):
        if k < 3 and not (i[:shared] == c).any():
            i[k] = c
            k += 1
        if n < 3 and not (j[:shared] == c).any():
            j[n] = c
            n += 1
    # distance from the corners that are not shared, of one facet with itself from both others
    far = np.zeros(3)
    if shared == 2:
        for a in range(2):
            far[a] = _square(p[i[a]], p[i[2]]) + _square(q[j[a]], q[j[2]])
    elif shared == 3:
        for a in range(3):
            far[a] = -_square(p[i[(a + 1) % 3]], p[i[(a + 2) % 3]])
    for a in range(shared - 1 if shared > 1 else 0):
        for b in range(shared - 1 - a):
            if far[b] > far[b + 1]:
                far[b], far[b + 1] = far[b + 1], far[b]
                i[b], i[b + 1] = i[b + 1], i[b]
                j[b], j[b + 1] = j[b + 1], j[b]
    return shared


@compiled
def integrate_pair(mesh, f, g, rules, space):
    """The twelve integrals of facets f and g over the product of their areas, in the last part of `space`.

    `mesh` is the corners (F, 3, 3), triangles, normals, areas, centres (F, 3), radii (F,) and how slender they are
    (F,); `rules` what the function of that name gives.
    """
    corners, triangles, normals, areas, centres, radii, slender = mesh
    table, starts, points, weights = rules
    i, j, both, total = space
    p, q, m, n = corners[f], corners[g], normals[f], normals[g]
    total[:] = 0.0
    ratio = np.sqrt(_square(centres[f], centres[g])) / (radii[f] + radii[g])
    shared = 0 if ratio > NEAR else _shared_first(triangles[f], triangles[g], p, q, i, j)
    if ratio > NEAR:
        for a in range(3):
            i[a] = j[a] = a
        k = 3 if ratio > FAR else (4 if ratio > MIDDLE else 5)
        add_rule(table, starts[k], starts[k + 1], p, q, m, n, i, j, total)
    elif shared and max(slender[f], slender[g]) < SLENDER:
        add_rule(table, starts[shared - 1], starts[shared], p, q, m, n, i, j, total)
    else:
        both[0], both[1] = areas[f], areas[g]
        add_near(p, q, m, n, both, points, weights, total)
    if f == g:  # a plane facet does not see its own normal
        total[6:] = 0.0


@compiled
def _space():
    """Work space of `integrate_pair`: corners of either facet, their areas, the integrals."""
    return np.empty(3, np.int64), np.empty(3, np.int64), np.empty(2), np.empty(COUNT)


@compiled
def all_pairs(mesh, points, rules, of_identity, of_kelvin, single, laplace, double):
    """Fill V = `of_identity` tr(B) I + `of_kelvin` B and tr(B) below the diagonal; add Laplace's K to `double`.

    V (3F, 3F), tr(B) (F, F), K (F, N). `points` (3, 3, F) are those of `vdm.boundary.far`.
    """
    _, triangles, normals, areas, centres, radii, _ = mesh
    across = np.ascontiguousarray(normals.T)
    totals = np.zeros((COUNT, len(triangles)))
    space = _space()
    for f in range(len(triangles)):
        far_row(f, points, across, totals)
        x, y, z = centres[f, 0], centres[f, 1], centres[f, 2]
        for g in range(f + 1):
            # without a view of a row, which takes longer than all else here
            a, b, c = centres[g, 0] - x, centres[g, 1] - y, centres[g, 2] - z
            reach = FAR * (radii[f] + radii[g])
            if a * a + b * b + c * c <= reach * reach:
                integrate_pair(mesh, f, g, rules, space)
                totals[:, g] = space[-1]
        for g in range(f + 1):
            both = areas[f] * areas[g]
            trace = both * (totals[0, g] + totals[1, g] + totals[2, g])
            laplace[f, g] = trace
            trace *= of_identity
            both *= of_kelvin
            xy, xz, yz = both * totals[3, g], both * totals[4, g], both * totals[5, g]
            single[3 * f, 3 * g] = trace + both * totals[0, g]
            single[3 * f, 3 * g + 1] = xy
            single[3 * f, 3 * g + 2] = xz
            single[3 * f + 1, 3 * g] = xy
            single[3 * f + 1, 3 * g + 1] = trace + both * totals[1, g]
            single[3 * f + 1, 3 * g + 2] = yz
            single[3 * f + 2, 3 * g] = xz
            single[3 * f + 2, 3 * g + 1] = yz
            single[3 * f + 2, 3 * g + 2] = trace + both * totals[2, g]
        for g in range(f):
            both = areas[f] * areas[g]
            for a in range(3):
                double[f, triangles[g, a]] += both * totals[6 + a, g]
                double[g, triangles[f, a]] += both * totals[9 + a, g]


@compiled
def mirror(matrix, into):
    """Write a symmetric matrix (n, n), given on and below its diagonal, to `into`, which may be itself."""
    n, size = len(matrix), 64
    for top in range(0, n, size):
        for left in range(0, top + 1, size):
            for i in range(top, min(top + size, n)):
                for j in range(left, min(left + size, i + 1)):
                    into[i, j] = into[j, i] = matrix[i, j]


@compiled
def add_square(matrix, vector):
    """Add v v^T (n,) to a matrix (n, n), below the diagonal."""
    for i in range(len(vector)):
        for j in range(i + 1):
            matrix[i, j] += vector[i] * vector[j]


@compiled
def interleave(double, smooth, matrix):
    """Fill B (F, 3, N, 3) = K I - e_ijk s_k / (4 pi) of K (F, N) and three s_k (F, N)."""
    n_facets, n_nodes = double.shape
    share = 0.25 / np.pi
    x, y, z = smooth
    for f in range(n_facets):
        for n in range(n_nodes):
            own, a, b, c = double[f, n], share * x[f, n], share * y[f, n], share * z[f, n]
            matrix[f, 0, n, 0] = own
            matrix[f, 0, n, 1] = -c
            matrix[f, 0, n, 2] = b
            matrix[f, 1, n, 0] = c
            matrix[f, 1, n, 1] = own
            matrix[f, 1, n, 2] = -a
            matrix[f, 2, n, 0] = -b
            matrix[f, 2, n, 1] = a
            matrix[f, 2, n, 2] = own
