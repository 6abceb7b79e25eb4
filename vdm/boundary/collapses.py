"""Which edges of a surface may collapse, and what each collapse costs.

Half-edge 3 f + k runs from corner k of facet f to the next one, its `end` (3m,). `by_start` (3m,) has them in the
order of their starts, those of node i from first[i] to first[i + 1].
"""

import numpy as np

from solver_common.jit import compiled

# a collapse may not turn a facet by more than this, nor squeeze it below this share of an equilateral one
LEAST_COSINE = 0.5
LEAST_QUALITY = 0.2
MOST_NEIGHBOURS = 9
# a distance from the planes of the facets that vanish counts this many times more than length
OFF_PLANE = 8.0


@compiled
def usable(end, by_start, first):
    """(3m,) whether the two ends of a half-edge share exactly two neighbours and keep three to nine together.

    A tetrahedron would keep two: the shell of a small cavity therefore keeps four nodes.
    """
    may = np.zeros(len(end), np.bool_)
    around = np.full(len(first) - 1, -1)  # for each node, the last node that had it as a neighbour
    for i in range(len(first) - 1):
        for one in range(first[i], first[i + 1]):
            around[end[by_start[one]]] = i
        for one in range(first[i], first[i + 1]):
            h = by_start[one]
            shared, begin, stop = 0, first[end[h]], first[end[h] + 1]
            for other in range(begin, stop):
                shared += around[end[by_start[other]]] == i
            left = first[i + 1] - first[i] + stop - begin - 4
            may[h] = shared == 2 and 3 <= left <= MOST_NEIGHBOURS
    return may


@compiled
def costs(points, size, triangles, half, by_start, first):
    """(k,) cost of moving the start of a half-edge (k,) onto its end; -1 where a facet would turn or degenerate.

    Cost: the longest new edge in units of the local mesh `size` (n,), plus the end's distance off a facet's plane.
    """
    found = np.empty(len(half))
    for k in range(len(half)):
        gone, onto = triangles[half[k] // 3, half[k] % 3], triangles[half[k] // 3, (half[k] + 1) % 3]
        p, q = points[gone], points[onto]
        longest = off_plane = 0.0
        may = True
        for h in by_start[first[gone] : first[gone + 1]]:
            b, c = triangles[h // 3, (h + 1) % 3], triangles[h // 3, (h + 2) % 3]
            before = _turned(p, points[b], points[c])
            area = np.sqrt(_dot(before, before))
            along = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            off_plane = max(off_plane, abs(_dot(before, along)) / (area * size[onto]))
            if onto in (b, c):  # the facet vanishes
                continue
            after = _turned(q, points[b], points[c])
            new_area = np.sqrt(_dot(after, after))
            one, other, third = _square(q, points[b]), _square(q, points[c]), _square(points[b], points[c])
            may &= _dot(before, after) > LEAST_COSINE * area * new_area
            may &= 2.0 * np.sqrt(3.0) * new_area > LEAST_QUALITY * (one + other + third)
            longest = max(longest, one / (size[onto] * size[b]), other / (size[onto] * size[c]))
        found[k] = np.sqrt(longest) + OFF_PLANE * off_plane if may else -1.0
    return found


@compiled
def _turned(a, b, c):
    """The vector product of b - a and c - a."""
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    u, v, w = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return y * w - z * v, z * u - x * w, x * v - y * u


@compiled
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _square(a, b):
    """Squared distance of two points."""
    return (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2
