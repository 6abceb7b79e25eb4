"""The integrals of `vdm.boundary.kernels` for facets far apart, by three points on each and without a table.

Nine tenths of all pairs are far. For the same points this takes a fifteenth of the time of `add_rule`.
"""

from __future__ import annotations

import numpy as np

from solver_common.jit import compiled


@compiled
def _between(x, y0, y1, y2):
    """From three points x (9,) to a point (y0, y1, y2): three values of 1/r^3, and six sums of r r / r^3."""
    ax, ay, az = y0 - x[0], y1 - x[1], y2 - x[2]
    bx, by, bz = y0 - x[3], y1 - x[4], y2 - x[5]
    cx, cy, cz = y0 - x[6], y1 - x[7], y2 - x[8]
    a, b, c = ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz
    a, b, c = 1.0 / (a * np.sqrt(a)), 1.0 / (b * np.sqrt(b)), 1.0 / (c * np.sqrt(c))
    return (
        a,
        b,
        c,
        a * ax * ax + b * bx * bx + c * cx * cx,
        a * ay * ay + b * by * by + c * cy * cy,
        a * az * az + b * bz * bz + c * cz * cz,
        a * ax * ay + b * bx * by + c * cx * cy,
        a * ax * az + b * bx * bz + c * cx * cz,
        a * ay * az + b * by * bz + c * cy * cz,
    )


@compiled
def far_row(f, points, normals, totals):
    """Write the twelve integrals of facet f with every facet before it to `totals` (12, F), over both areas.

    `points` are (3 points, 3 coordinates, F), each nearest to its corner; `normals` are (3, F). Values for facets
    that are not far are wrong: the caller overwrites them.
    """
    x = (
        points[0, 0, f],
        points[0, 1, f],
        points[0, 2, f],
        points[1, 0, f],
        points[1, 1, f],
        points[1, 2, f],
        points[2, 0, f],
        points[2, 1, f],
        points[2, 2, f],
    )
    mx, my, mz = normals[0, f], normals[1, f], normals[2, f]
    foot = x[0] * mx + x[1] * my + x[2] * mz
    share, part = 1.0 / 9.0, 0.25 / np.pi / 9.0
    for g in range(f):
        ax, ay, az = points[0, 0, g], points[0, 1, g], points[0, 2, g]
        bx, by, bz = points[1, 0, g], points[1, 1, g], points[1, 2, g]
        cx, cy, cz = points[2, 0, g], points[2, 1, g], points[2, 2, g]
        nx, ny, nz = normals[0, g], normals[1, g], normals[2, g]
        a0, a1, a2, axx, ayy, azz, axy, axz, ayz = _between(x, ax, ay, az)
        b0, b1, b2, bxx, byy, bzz, bxy, bxz, byz = _between(x, bx, by, bz)
        c0, c1, c2, cxx, cyy, czz, cxy, cxz, cyz = _between(x, cx, cy, cz)
        totals[0, g] = share * (axx + bxx + cxx)
        totals[1, g] = share * (ayy + byy + cyy)
        totals[2, g] = share * (azz + bzz + czz)
        totals[3, g] = share * (axy + bxy + cxy)
        totals[4, g] = share * (axz + bxz + cxz)
        totals[5, g] = share * (ayz + byz + cyz)
        # r . n_g is the height of a point of f under the plane of g, for all points of g; and f and g exchanged
        plane = ax * nx + ay * ny + az * nz
        h0 = plane - (x[0] * nx + x[1] * ny + x[2] * nz)
        h1 = plane - (x[3] * nx + x[4] * ny + x[5] * nz)
        h2 = plane - (x[6] * nx + x[7] * ny + x[8] * nz)
        a, b, c = h0 * a0 + h1 * a1 + h2 * a2, h0 * b0 + h1 * b1 + h2 * b2, h0 * c0 + h1 * c1 + h2 * c2
        mean = (a + b + c) / 6.0
        totals[6, g] = -part * (mean + 0.5 * a)
        totals[7, g] = -part * (mean + 0.5 * b)
        totals[8, g] = -part * (mean + 0.5 * c)
        ea = ax * mx + ay * my + az * mz - foot
        eb = bx * mx + by * my + bz * mz - foot
        ec = cx * mx + cy * my + cz * mz - foot
        a, b, c = ea * a0 + eb * b0 + ec * c0, ea * a1 + eb * b1 + ec * c1, ea * a2 + eb * b2 + ec * c2
        mean = (a + b + c) / 6.0
        totals[9, g] = part * (mean + 0.5 * a)
        totals[10, g] = part * (mean + 0.5 * b)
        totals[11, g] = part * (mean + 0.5 * c)
