"""Double integrals of 1/r, r r / r^3 and of Laplace's double layer over pairs of facets, compiled.

For a facet f with points x, a facet g with points y and r = y - x, the integrals are

`B = int int r r / r^3` (six numbers; its trace is the integral of 1/r), and for each corner a of g with the shape
function phi_a `k_a = -1/(4 pi) int int (r . n_g) phi_a / r^3` (Laplace's double layer, tested with a constant on
f), and the same with f and g exchanged. They do not depend on the material.
"""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index
from solver_common.jit import compiled
from solver_common.quadrature import facet_quadrature
from vdm.boundary.far import far_row
from vdm.boundary.plane import add_near, graded
from vdm.boundary.quadrature import Rule, sixteen_points, touching

# distance of two facets' centres over the sum of their radii: from here on a product of two rules is accurate
# enough
FAR, MIDDLE, NEAR = 4.0, 2.0, 1.15
# the same ratio for facets that do not touch: from here on 16 even points beside a closed form are more accurate
# than 75 points that crowd at the edges
CLOSE = 0.8
# largest ratio of longest edge to height for which the maps of touching facets have enough points
SLENDER = 3.0
# the twelve integrals of a pair: xx, yy, zz, xy, xz, yz of B, k of g by its corners, k of f by its corners
COUNT = 12


def rules() -> tuple[Array, Index, Array, Array, Array, Array]:
    """All rules in a table (5, n) of two coordinates of x, two of y and the weight, and each rule's start (6,).

    Order: one common vertex, one common edge, the same facet, then middle and near facets that do not touch.
    The last outputs are points and weights for one facet where the other is integrated in closed form: those of
    `vdm.boundary.plane.graded` for facets that touch or are close, 16 even ones for the others.
    """
    parts = [
        *touching(),
        *(_product(*rule) for rule in (facet_quadrature(), sixteen_points())),
    ]
    table = np.concatenate([np.stack([*x.T[1:], *y.T[1:], w]) for x, y, w in parts], axis=1)
    starts = np.cumsum([0, *(len(part[2]) for part in parts)])
    return np.ascontiguousarray(table), starts.astype(np.int64), *graded(), *sixteen_points()


def _product(points: Array, weights: Array) -> Rule:
    n = len(weights)
    return np.repeat(points, n, axis=0), np.tile(points, (n, 1)), np.outer(weights, weights).ravel()


@compiled
def add_rule(table, lower, upper, corners, normals, f, g, i, j, total):
    """Add the integrals over facets f and g to `total` (12,); corners are (F, 3, 3), normals (F, 3).

    i and j (3,) number the corners of f and g in the order of the rule.
    """
    # r = s + y1 c + y2 d - x1 a - x2 b
    px, py, pz = corners[f, i[0], 0], corners[f, i[0], 1], corners[f, i[0], 2]
    qx, qy, qz = corners[g, j[0], 0], corners[g, j[0], 1], corners[g, j[0], 2]
    ax, ay, az = corners[f, i[1], 0] - px, corners[f, i[1], 1] - py, corners[f, i[1], 2] - pz
    bx, by, bz = corners[f, i[2], 0] - px, corners[f, i[2], 1] - py, corners[f, i[2], 2] - pz
    cx, cy, cz = corners[g, j[1], 0] - qx, corners[g, j[1], 1] - qy, corners[g, j[1], 2] - qz
    dx, dy, dz = corners[g, j[2], 0] - qx, corners[g, j[2], 1] - qy, corners[g, j[2], 2] - qz
    sx, sy, sz = qx - px, qy - py, qz - pz
    mx, my, mz = normals[f, 0], normals[f, 1], normals[f, 2]
    nx, ny, nz = normals[g, 0], normals[g, 1], normals[g, 2]
    xx = yy = zz = xy = xz = yz = g0 = g1 = g2 = f0 = f1 = f2 = 0.0
    # contiguous slices that start at zero: only these let the compiler vectorise the loop over points
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
        n = w * (rx * nx + ry * ny + rz * nz)
        m = w * (rx * mx + ry * my + rz * mz)
        g0 += n
        g1 += n * y1
        g2 += n * y2
        f0 += m
        f1 += m * x1
        f2 += m * x2
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
def _add_others(i, n):
    """Complete i (3,) behind its first n entries with the missing ones of 0, 1, 2."""
    for c in range(3):
        is_other = True
        for a in range(n):
            is_other = is_other and i[a] != c
        if is_other:
            i[n] = c
            n += 1


@compiled
def _shared_first(t, v, p, q, i, j):
    """Number of common nodes of facets t and v (3,); i and j (3,) become their corners, common ones first.

    Lengths decide the order, so that a mirror image of the body has the same one.
    """
    shared = 0
    for a in range(3):
        for b in range(3):
            if t[a] == v[b]:
                i[shared], j[shared] = a, b
                shared += 1
    _add_others(i, shared)
    _add_others(j, shared)
    # distance to the corners that are not shared; of a facet with itself to both others
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
def integrate_near(mesh, f, g, ratio, rules, space):
    """Add the twelve integrals of near facets f and g, per product of their areas, to the last part of `space`.

    `mesh` holds corners (F, 3, 3), triangles, normals, areas, centres (F, 3), radii (F,) and slenderness (F,).
    `ratio` is the distance of the centres over the sum of the radii; `rules` is the result of `rules()`.
    """
    corners, triangles, normals, areas, _, _, slender = mesh
    table, starts, graded_points, graded_weights, even_points, even_weights = rules
    i, j, both, total = space
    shared = _shared_first(triangles[f], triangles[g], corners[f], corners[g], i, j)
    if shared and max(slender[f], slender[g]) < SLENDER:
        add_rule(table, starts[shared - 1], starts[shared], corners, normals, f, g, i, j, total)
    else:
        p, q, m, n = corners[f], corners[g], normals[f], normals[g]
        both[0], both[1] = areas[f], areas[g]
        if shared or ratio < CLOSE:
            add_near(p, q, m, n, both, graded_points, graded_weights, total)
        else:
            add_near(p, q, m, n, both, even_points, even_weights, total)
    if f == g:  # a plane facet does not see its own normal
        total[6:] = 0.0


@compiled
def _space():
    """Work space of `integrate_near`: corners of either facet, their areas, the integrals."""
    return np.empty(3, np.int64), np.empty(3, np.int64), np.empty(2), np.empty(COUNT)


@compiled
def all_pairs(mesh, points, rules, factors, curls, tractions, sums, laplace, double):
    """Add V, tr(B) and Laplace's K over all pairs of facets, each pair once, for tractions P and forms M.

    V = `factors[0]` tr(B) I + `factors[1]` B, split as V = X + X^T, is not stored. `sums` are P^T X P (3P, 3P),
    P^T X M (3P, 3N), M^T X P and M^T X M, zero on entry. P makes each facet's traction from the one that it
    shares, by the `tractions` of `vdm.boundary.operators.Facets`. M^T turns a vector v of a facet into v x c at
    each corner, by the `curls` c (F, 3, 3). tr(B) (F, F) is below the diagonal; Laplace's K is (F, N). `points`
    (3, 3, F) are those of `vdm.boundary.far`.
    """
    corners, triangles, normals, areas, centres, radii, _ = mesh
    table, starts = rules[0], rules[1]
    of_identity, of_kelvin = factors
    across = np.ascontiguousarray(normals.T)
    totals = np.zeros((COUNT, len(triangles)))
    space, as_they_are = _space(), np.arange(3)
    total = space[-1]
    # V of one facet with all before it; then its products with P and M
    row = np.zeros((len(triangles), 6), sums[0].dtype)
    pushed = np.zeros((sums[1].shape[0], 3), sums[0].dtype)
    turned = np.zeros((sums[1].shape[1], 3), sums[0].dtype)
    # tractions and nodes of the facets so far: the arrays beyond are untouched
    n_tractions = n_nodes = 0
    for f in range(len(triangles)):
        far_row(f, points, across, totals)
        x, y, z = centres[f, 0], centres[f, 1], centres[f, 2]
        for g in range(f + 1):
            # no view of a row here: it would take longer than the rest of the loop
            a, b, c = centres[g, 0] - x, centres[g, 1] - y, centres[g, 2] - z
            square, reach = a * a + b * b + c * c, radii[f] + radii[g]
            if square > (FAR * reach) ** 2:
                continue
            ratio = np.sqrt(square) / reach
            total[:] = 0.0
            if ratio > NEAR:  # summed in place: a call with all the rules takes longer than the sum
                k = 3 if ratio > MIDDLE else 4
                add_rule(
                    table, starts[k], starts[k + 1], corners, normals, f, g, as_they_are, as_they_are, total
                )
            else:
                integrate_near(mesh, f, g, ratio, rules, space)
            for k in range(COUNT):
                totals[k, g] = total[k]
        for g in range(f + 1):
            both = areas[f] * areas[g]
            trace = both * (totals[0, g] + totals[1, g] + totals[2, g])
            laplace[f, g] = trace
            if f == g:
                trace, both = 0.5 * trace, 0.5 * both
            trace *= of_identity
            both *= of_kelvin
            row[g, 0] = trace + both * totals[0, g]
            row[g, 1] = trace + both * totals[1, g]
            row[g, 2] = trace + both * totals[2, g]
            row[g, 3], row[g, 4], row[g, 5] = both * totals[3, g], both * totals[4, g], both * totals[5, g]
        n_tractions = max(n_tractions, tractions[0][f] + 1)
        for a in range(3):
            n_nodes = max(n_nodes, triangles[f, a] + 1)
        known, moved = pushed[: 3 * n_tractions], turned[: 3 * n_nodes]
        add_row(row[: f + 1], triangles, curls, tractions, known, moved)
        spread_row(known.T.copy(), moved.T.copy(), f, triangles[f], curls[f], tractions, sums)
        for g in range(f):
            both = areas[f] * areas[g]
            for a in range(3):
                double[f, triangles[g, a]] += both * totals[6 + a, g]
                double[g, triangles[f, a]] += both * totals[9 + a, g]


@compiled
def add_row(row, triangles, curls, tractions, pushed, turned):
    """Write V_fg (m, 6: xx, yy, zz, xy, xz, yz) times P to `pushed` (3P, 3), and times M to `turned` (3N, 3)."""
    numbers, axes, tilts = tractions
    pushed[:] = 0.0
    turned[:] = 0.0
    for g in range(len(row)):
        xx, yy, zz, xy, xz, yz = row[g, 0], row[g, 1], row[g, 2], row[g, 3], row[g, 4], row[g, 5]
        x, y, z = tilts[g, 0], tilts[g, 1], tilts[g, 2]
        a, b, c = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
        x, y, z = axes[g, 0], axes[g, 1], axes[g, 2]
        p = 3 * numbers[g]
        pushed[p, 0] += xx + x * a
        pushed[p, 1] += xy + x * b
        pushed[p, 2] += xz + x * c
        pushed[p + 1, 0] += xy + y * a
        pushed[p + 1, 1] += yy + y * b
        pushed[p + 1, 2] += yz + y * c
        pushed[p + 2, 0] += xz + z * a
        pushed[p + 2, 1] += yz + z * b
        pushed[p + 2, 2] += zz + z * c
        for a in range(3):
            n = 3 * triangles[g, a]
            x, y, z = curls[g, a, 0], curls[g, a, 1], curls[g, a, 2]
            turned[n, 0] += xy * z - xz * y
            turned[n, 1] += yy * z - yz * y
            turned[n, 2] += yz * z - zz * y
            turned[n + 1, 0] += xz * x - xx * z
            turned[n + 1, 1] += yz * x - xy * z
            turned[n + 1, 2] += zz * x - xz * z
            turned[n + 2, 0] += xx * y - xy * x
            turned[n + 2, 1] += xy * y - yy * x
            turned[n + 2, 2] += xz * y - yz * x


@compiled
def spread_row(pushed, turned, f, triangle, curls, tractions, sums):
    """Add the row of facet f, by tractions (3, 3P) and forms (3, 3N), to those of its traction and corners."""
    of_tractions, pulled, of_forms, smooth = sums
    numbers, axes, tilts = tractions
    for i in range(3):
        p = 3 * numbers[f] + i
        add_tilted(pushed, i, axes[f, i], tilts[f], of_tractions[p])
        add_tilted(turned, i, axes[f, i], tilts[f], pulled[p])
    for a in range(3):
        n = 3 * triangle[a]
        add_turned(pushed, curls[a], of_forms[n], of_forms[n + 1], of_forms[n + 2])
        add_turned(turned, curls[a], smooth[n], smooth[n + 1], smooth[n + 2])


@compiled
def add_tilted(vectors, i, axis, tilt, total):
    """Add to `total` (n,) vector i of three (3, n), and `axis` times their sum weighted by a tilt (3,)."""
    own, u, v, w = vectors[i], vectors[0], vectors[1], vectors[2]
    a, b, c = axis * tilt[0], axis * tilt[1], axis * tilt[2]
    for m in range(len(own)):
        total[m] += own[m] + a * u[m] + b * v[m] + c * w[m]


@compiled
def add_turned(vectors, c, x, y, z):
    """Add the cross products of `vectors` (3, n) with c (3,) to the three rows x, y, z (n,)."""
    u, v, w = vectors[0], vectors[1], vectors[2]
    c0, c1, c2 = c[0], c[1], c[2]
    for m in range(len(u)):
        x[m] += v[m] * c2 - w[m] * c1
        y[m] += w[m] * c0 - u[m] * c2
        z[m] += u[m] * c1 - v[m] * c0


@compiled
def add_transposed(matrix, other):
    """Add the transpose of `other` (m, n) to a matrix (n, m)."""
    size = 64
    for top in range(0, matrix.shape[0], size):
        for left in range(0, matrix.shape[1], size):
            for i in range(top, min(top + size, matrix.shape[0])):
                for j in range(left, min(left + size, matrix.shape[1])):
                    matrix[i, j] += other[j, i]


@compiled
def add_own_transposed(matrix):
    """Add the transpose of a matrix (n, n) to it."""
    n, size = len(matrix), 64
    for top in range(0, n, size):
        for left in range(0, top + 1, size):
            for i in range(top, min(top + size, n)):
                for j in range(left, min(left + size, i + 1)):
                    matrix[i, j] = matrix[j, i] = matrix[i, j] + matrix[j, i]


@compiled
def mirror(matrix):
    """Copy the part of a matrix (n, n) below its diagonal to the part above."""
    n, size = len(matrix), 64
    for top in range(0, n, size):
        for left in range(0, top + 1, size):
            for i in range(top, min(top + size, n)):
                for j in range(left, min(left + size, i)):
                    matrix[j, i] = matrix[i, j]


@compiled
def add_layers(double, smooth, tractions, matrix):
    """Add P^T (K I - e_ijk s_k / (4 pi)) to a matrix (3P, 3N), from K (F, N) and three s_k (F, N)."""
    numbers, axes, tilts = tractions
    share = 0.25 / np.pi
    x, y, z = smooth
    for f in range(double.shape[0]):
        p, axis, d = 3 * numbers[f], axes[f], tilts[f]
        first, second, third = matrix[p], matrix[p + 1], matrix[p + 2]
        for n in range(double.shape[1]):
            own, a, b, c = double[f, n], share * x[f, n], share * y[f, n], share * z[f, n]
            u = d[0] * own + d[1] * c - d[2] * b
            v = d[1] * own + d[2] * a - d[0] * c
            w = d[2] * own + d[0] * b - d[1] * a
            first[3 * n] += own + axis[0] * u
            first[3 * n + 1] += axis[0] * v - c
            first[3 * n + 2] += axis[0] * w + b
            second[3 * n] += axis[1] * u + c
            second[3 * n + 1] += own + axis[1] * v
            second[3 * n + 2] += axis[1] * w - a
            third[3 * n] += axis[2] * u - b
            third[3 * n + 1] += axis[2] * v + a
            third[3 * n + 2] += own + axis[2] * w
