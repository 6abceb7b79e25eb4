"""Double integrals of 1/r, r r / r^3 and of Laplace's double layer over pairs of facets, compiled.

Of a facet f with points x and a facet g with points y, r = y - x:

`B = int int r r / r^3` (six numbers; its trace is that of 1/r), and for each corner a of g with the shape function
phi_a `k_a = -1/(4 pi) int int (r . n_g) phi_a / r^3` (Laplace's double layer, tested with a constant on f), and the
same with f and g exchanged. They do not depend on the material.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vdm.boundary.jit import compiled
from vdm.boundary.quadrature import Rule, dunavant, three_points, touching

Array = NDArray[np.float64]
Index = NDArray[np.int64]

# distance of two facets' centres over the sum of their radii, from which a product of two rules is enough
FAR, MIDDLE, NEAR = 4.0, 2.0, 1.15
# facets that are nearer, and slender ones that touch, are cut in two, as often as this at most
CUTS = 18
SLENDER = 1e30  # longest edge over its height: the maps' Gauss points would resolve no more
SAME = 1e-6  # corners within this share of a facet's radius are one
# the twelve integrals of a pair: xx, yy, zz, xy, xz, yz of B, k of g by its corners, k of f by its corners
COUNT = 12


def rules() -> tuple[Array, Index]:
    """All rules as one table (5, n) of two coordinates of x, two of y and the weight, and each rule's start (7,).

    In the order: one vertex, one edge, the same facet, then far, middle and near facets that do not touch.
    """
    parts = [*touching(), *(_product(*rule) for rule in (three_points(), dunavant(4), dunavant(8)))]
    table = np.concatenate([np.stack([*x.T[1:], *y.T[1:], w]) for x, y, w in parts], axis=1)
    starts = np.cumsum([0, *(len(part[2]) for part in parts)])
    return np.ascontiguousarray(table), starts.astype(np.int64)


def _product(points: Array, weights: Array) -> Rule:
    n = len(weights)
    return np.repeat(points, n, axis=0), np.tile(points, (n, 1)), np.outer(weights, weights).ravel()


@compiled
def add_rule(table, lower, upper, p, q, m, n, first, second, scale, total):
    """Add to `total` (12,) the integrals over parts of the triangles p and q (3, 3), whose normals are m and n.

    `first`, `second` (3, 3) are the coordinates of the parts' corners in p and q.
    """
    # x = o + x1 a + x2 b, y = x at the corner + s + y1 c + y2 d
    ax = ay = az = bx = by = bz = cx = cy = cz = dx = dy = dz = sx = sy = sz = 0.0
    for k in range(3):
        i, j = first[1, k] - first[0, k], first[2, k] - first[0, k]
        ax, ay, az = ax + i * p[k, 0], ay + i * p[k, 1], az + i * p[k, 2]
        bx, by, bz = bx + j * p[k, 0], by + j * p[k, 1], bz + j * p[k, 2]
        i, j = second[1, k] - second[0, k], second[2, k] - second[0, k]
        cx, cy, cz = cx + i * q[k, 0], cy + i * q[k, 1], cz + i * q[k, 2]
        dx, dy, dz = dx + j * q[k, 0], dy + j * q[k, 1], dz + j * q[k, 2]
        # from one corner of p: two near points far from the origin lose no digits
        i, j = first[0, k], second[0, k]
        sx += j * (q[k, 0] - p[0, 0]) - i * (p[k, 0] - p[0, 0])
        sy += j * (q[k, 1] - p[0, 1]) - i * (p[k, 1] - p[0, 1])
        sz += j * (q[k, 2] - p[0, 2]) - i * (p[k, 2] - p[0, 2])
    xx = yy = zz = xy = xz = yz = g0 = g1 = g2 = f0 = f1 = f2 = 0.0
    for k in range(lower, upper):
        x1, x2, y1, y2 = table[0, k], table[1, k], table[2, k], table[3, k]
        rx = sx + y1 * cx + y2 * dx - x1 * ax - x2 * bx
        ry = sy + y1 * cy + y2 * dy - x1 * ay - x2 * by
        rz = sz + y1 * cz + y2 * dz - x1 * az - x2 * bz
        square = rx * rx + ry * ry + rz * rz
        w = table[4, k] / (square * np.sqrt(square))
        xx += w * rx * rx
        yy += w * ry * ry
        zz += w * rz * rz
        xy += w * rx * ry
        xz += w * rx * rz
        yz += w * ry * rz
        g = w * (rx * n[0] + ry * n[1] + rz * n[2])
        f = w * (rx * m[0] + ry * m[1] + rz * m[2])
        g0 += g
        g1 += g * y1
        g2 += g * y2
        f0 += f
        f1 += f * x1
        f2 += f * x2
    total[0] += scale * xx
    total[1] += scale * yy
    total[2] += scale * zz
    total[3] += scale * xy
    total[4] += scale * xz
    total[5] += scale * yz
    g0, f0 = g0 - g1 - g2, f0 - f1 - f2
    scale *= 0.25 / np.pi
    for k in range(3):
        total[6 + k] -= scale * (g0 * second[0, k] + g1 * second[1, k] + g2 * second[2, k])
        total[9 + k] += scale * (f0 * first[0, k] + f1 * first[1, k] + f2 * first[2, k])


@compiled
def _place(p, part, corners, centre):
    """Write the corners (3, 3) and the centre (3,) of a part of the triangle p; returns its radius, longest edge's
    start and how slender it is: that edge over the height on it.
    """
    for a in range(3):
        for c in range(3):
            corners[a, c] = part[a, 0] * p[0, c] + part[a, 1] * p[1, c] + part[a, 2] * p[2, c]
    largest, longest, start = 0.0, 0.0, 0
    for c in range(3):
        centre[c] = (corners[0, c] + corners[1, c] + corners[2, c]) / 3.0
    for a in range(3):
        square, edge, b = 0.0, 0.0, (a + 1) % 3
        for c in range(3):
            square += (corners[a, c] - centre[c]) ** 2
            edge += (corners[b, c] - corners[a, c]) ** 2
        largest = max(largest, square)
        if edge > longest:
            longest, start = edge, a
    twice = 0.0
    for c in range(3):
        d, e = (c + 1) % 3, (c + 2) % 3
        twice += (
            (corners[1, d] - corners[0, d]) * (corners[2, e] - corners[0, e])
            - (corners[1, e] - corners[0, e]) * (corners[2, d] - corners[0, d])
        ) ** 2
    return np.sqrt(largest), start, longest / np.sqrt(twice)


@compiled
def _touching(p, q, near, i, j):
    """Number of corners within `near` of one of the other triangle; i, j (3,) are the corners, those first."""
    shared = 0
    for a in range(3):
        for b in range(3):
            x, y, z = p[a, 0] - q[b, 0], p[a, 1] - q[b, 1], p[a, 2] - q[b, 2]
            if x * x + y * y + z * z < near * near and shared < 3:
                i[shared], j[shared] = a, b
                shared += 1
    k = n = shared
    for c in range(3):
        if not (i[:shared] == c).any() and k < 3:
            i[k] = c
            k += 1
        if not (j[:shared] == c).any() and n < 3:
            j[n] = c
            n += 1
    return shared


@compiled
def _halve(part, start, half, other):
    """Write the halves of a part (3, 3), cut across the edge that begins at a corner; `half` may be `part`."""
    for k in range(3):
        left, right, apex = part[start, k], part[(start + 1) % 3, k], part[(start + 2) % 3, k]
        middle = 0.5 * (left + right)
        half[0, k], half[1, k], half[2, k] = left, middle, apex
        other[0, k], other[1, k], other[2, k] = middle, right, apex


@compiled
def _turned(part, order, turned):
    """Write the corners of a part in an order (3,)."""
    for a in range(3):
        for k in range(3):
            turned[a, k] = part[order[a], k]


@compiled
def _shared_edge(start, i, j, shared):
    """Where the other part has the edge that begins at `start`: its first corner, or -1 if it is not shared."""
    if shared < 2:
        return -1
    a = b = -1
    for k in range(shared):
        if i[k] == start:
            a = j[k]
        if i[k] == (start + 1) % 3:
            b = j[k]
    if a < 0 or b < 0:
        return -1
    return a if (a + 1) % 3 == b else b


@compiled
def integrate_pair(mesh, f, g, table, starts, space):
    """The twelve integrals of facets f and g over the product of their areas, in the last part of `space`.

    `mesh` is the corners (F, 3, 3), triangles, normals, areas, centres (F, 3) and radii (F,). Pairs that are near
    but do not touch, and slender ones that do, are cut until a rule fits.
    """
    corners, _, normals, _, centres, radii = mesh
    first, second, cuts, here, there, i, j, total = space
    p, q, m, n = corners[f], corners[g], normals[f], normals[g]
    total[:] = 0.0
    x, y, z = centres[f, 0] - centres[g, 0], centres[f, 1] - centres[g, 1], centres[f, 2] - centres[g, 2]
    ratio = np.sqrt(x * x + y * y + z * z) / (radii[f] + radii[g])
    if ratio > MIDDLE:
        k, whole = 3 if ratio > FAR else 4, first[-1]
        add_rule(table, starts[k], starts[k + 1], p, q, m, n, whole, whole, 1.0, total)
        return
    first[0] = first[-1]
    second[0] = first[-1]
    cuts[0] = 0
    near = SAME * min(radii[f], radii[g])
    top = 0
    while top >= 0:
        r, a, slender = _place(p, first[top], here[:3], here[3])
        s, b, thin = _place(q, second[top], there[:3], there[3])
        x, y, z = here[3, 0] - there[3, 0], here[3, 1] - there[3, 1], here[3, 2] - there[3, 2]
        ratio = np.sqrt(x * x + y * y + z * z) / (r + s)
        done = cuts[top]
        shared = _touching(here[:3], there[:3], near * 0.5 ** (0.5 * done), i, j) if ratio < 1.0 + SAME else 0
        fits = max(slender, thin) < SLENDER if shared else ratio > NEAR
        if fits or done >= CUTS:
            share = 0.5**done
            if shared:
                _turned(first[top], i, first[-2])
                _turned(second[top], j, second[-2])
                k = shared - 1
            else:
                first[-2] = first[top]
                second[-2] = second[top]
                k = 3 if ratio > FAR else (4 if ratio > MIDDLE else 5)
            add_rule(table, starts[k], starts[k + 1], p, q, m, n, first[-2], second[-2], share, total)
            top -= 1
            continue
        of_first = slender > thin if shared else r > s
        # a shared edge is cut in both, so that the halves share whole edges too
        edge = _shared_edge(a, i, j, shared) if of_first else _shared_edge(b, j, i, shared)
        if edge >= 0:
            if of_first:
                b = edge
            else:
                a = edge
            first[-2] = first[top]
            second[-2] = second[top]
            for k in range(4):
                _halve(first[-2], a, first[top + k], first[-3])
                if k % 2:
                    first[top + k] = first[-3]
                _halve(second[-2], b, second[top + k], second[-3])
                if k // 2:
                    second[top + k] = second[-3]
                cuts[top + k] = done + 2
            top += 3
        else:
            if of_first:
                _halve(first[top], a, first[top], first[top + 1])
                second[top + 1] = second[top]
            else:
                _halve(second[top], b, second[top], second[top + 1])
                first[top + 1] = first[top]
            cuts[top] = cuts[top + 1] = done + 1
            top += 1
    if f == g:  # a plane facet does not see its own normal
        total[6:] = 0.0


@compiled
def _space():
    """Work space of `integrate_pair`: two stacks of parts and what is found of their top, the integrals last."""
    size = 2 * CUTS + 8
    first, second = np.empty((size, 3, 3)), np.empty((size, 3, 3))
    first[-1] = np.eye(3)
    order, other = np.empty(3, np.int64), np.empty(3, np.int64)
    here, there = np.empty((4, 3)), np.empty((4, 3))
    return first, second, np.empty(size, np.int64), here, there, order, other, np.empty(COUNT)


@compiled
def all_pairs(mesh, table, starts, of_identity, of_kelvin, single, double):
    """Fill V (3F, 3F) = `of_identity` tr(B) I + `of_kelvin` B, and add Laplace's K to `double` (F, N)."""
    triangles, areas = mesh[1], mesh[3]
    space = _space()
    total = space[-1]
    for f in range(len(triangles)):
        for g in range(f + 1):
            integrate_pair(mesh, f, g, table, starts, space)
            both = areas[f] * areas[g]
            trace = both * of_identity * (total[0] + total[1] + total[2])
            for i in range(3):
                for j in range(3):
                    entry = both * of_kelvin * total[i if i == j else i + j + 2]
                    if i == j:
                        entry += trace
                    single[3 * f + i, 3 * g + j] = entry
                    single[3 * g + i, 3 * f + j] = entry
            if f != g:
                for a in range(3):
                    double[f, triangles[g, a]] += both * total[6 + a]
                    double[g, triangles[f, a]] += both * total[9 + a]


@compiled
def some_pairs(mesh, rows, columns, table, starts, values):
    """Write the first nine integrals of the facets `rows` (m,) with `columns` (n,) to `values` (m, n, 9)."""
    areas = mesh[3]
    space = _space()
    total = space[-1]
    for k in range(len(rows)):
        for n in range(len(columns)):
            integrate_pair(mesh, rows[k], columns[n], table, starts, space)
            for c in range(9):
                values[k, n, c] = areas[rows[k]] * areas[columns[n]] * total[c]
