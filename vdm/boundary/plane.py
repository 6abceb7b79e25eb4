"""Integrals over one flat facet in closed form, seen from a point: exact for every facet, slivers included.

r = y - x, and d is the height of the facet over x. Each edge has a direction s, an outward normal m in the plane, a
distance t, and ends at l-, l+ along s and R-, R+ from x (Wilton et al. 1984, IEEE Trans. Antennas Propag. 32):

`f = ln (R+ + l+) / (R- + l-)`, `int 1/r = sum t f - d omega`, `int r/r^3 = omega n - sum f m` and by parts
`int r r/r^3 = int 1/r (I - n n) - sum (t f m m + (R+ - R-) sym(m s)) - d sum f (m n + n m) + d omega n n`,
with the solid angle omega of corners at r1, r2, r3 from x by (van Oosterom and Strackee 1983, IEEE Trans. Biomed.
Eng. 30) `tan(omega / 2) = r1 . r2 x r3 / (R1 R2 R3 + r1 . r2 R3 + r2 . r3 R1 + r3 . r1 R2)`.
"""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array
from solver_common.jit import compiled

# Gauss points outward from the centre and along the edges, in each of the three parts of a facet
POINTS = 5
ON_LINE = 1e-24  # squared distance from an edge's line over squared length, below which a point is on it


def graded() -> tuple[Array, Array]:
    """(75, 3) points and weights of sum 1 that crowd at the edges, where the potential of a facet is singular."""
    at, weights = np.polynomial.legendre.leggauss(POINTS)
    at, weights = 0.5 * (at + 1.0), 0.5 * weights
    out = 1.0 - (1.0 - at) ** 3
    along = at**2 * (3.0 - 2.0 * at)
    share = np.outer(weights * 3.0 * (1.0 - at) ** 2 * out, weights * 6.0 * at * (1.0 - at)).ravel()
    s, t = (part.ravel() for part in np.meshgrid(out, along, indexing="ij"))
    start, end, apex = (1.0 - s) / 3.0 + s * (1.0 - t), (1.0 - s) / 3.0 + s * t, (1.0 - s) / 3.0
    corners = np.stack([start, end, apex], axis=1)
    points = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    return np.ascontiguousarray(points), np.tile(share * 2.0 / 3.0, 3)


@compiled
def add_plane(x, y, z, q, n, weight, at, total):
    """Add the integrals over the triangle q (3, 3) of normal n, seen from the point (x, y, z), to `total` (12,).

    B times `weight` goes to the first six. Laplace's double layer by corners, times twice `weight`, goes to `at`
    and after.
    """
    d = (q[0, 0] - x) * n[0] + (q[0, 1] - y) * n[1] + (q[0, 2] - z) * n[2]
    height = abs(d)
    inverse = inner = fx = fy = fz = xx = yy = zz = xy = xz = yz = twice = 0.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        ux, uy, uz = q[a, 0] - x, q[a, 1] - y, q[a, 2] - z
        vx, vy, vz = q[b, 0] - x, q[b, 1] - y, q[b, 2] - z
        wx, wy, wz = q[c, 0] - x, q[c, 1] - y, q[c, 2] - z
        sx, sy, sz = q[b, 0] - q[a, 0], q[b, 1] - q[a, 1], q[b, 2] - q[a, 2]
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        sx, sy, sz = sx / length, sy / length, sz / length
        mx, my, mz = sy * n[2] - sz * n[1], sz * n[0] - sx * n[2], sx * n[1] - sy * n[0]
        t = mx * ux + my * uy + mz * uz
        start = sx * ux + sy * uy + sz * uz
        end = start + length
        near, far = np.sqrt(ux * ux + uy * uy + uz * uz), np.sqrt(vx * vx + vy * vy + vz * vz)
        # a third of R1 R2 R3 at each edge
        inner += (near * far / 3.0 + ux * vx + uy * vy + uz * vz) * np.sqrt(wx * wx + wy * wy + wz * wz)
        square = t * t + d * d
        if square < ON_LINE * length * length:
            f = 0.0 if start < 0.0 < end else abs(np.log(far / near))
        elif start > 0.0:
            f = np.log((far + end) / (near + start))
        elif end < 0.0:
            f = np.log((near - start) / (far - end))
        else:
            f = np.log((far + end) * (near - start) / square)
        inverse += t * f
        fx, fy, fz = fx + f * mx, fy + f * my, fz + f * mz
        g, h = t * f, 0.5 * (far - near)
        xx += g * mx * mx + 2.0 * h * mx * sx
        yy += g * my * my + 2.0 * h * my * sy
        zz += g * mz * mz + 2.0 * h * mz * sz
        xy += g * mx * my + h * (mx * sy + my * sx)
        xz += g * mx * mz + h * (mx * sz + mz * sx)
        yz += g * my * mz + h * (my * sz + mz * sy)
        twice += length * t  # twice the area, by the triangles that x makes with the edges
    angle = 2.0 * np.arctan2(height * twice, inner)
    inverse -= height * angle
    omega = np.copysign(angle, d)
    # factor of n n in B: its own term less the identity's
    own = d * omega - inverse
    total[0] += weight * (inverse - xx - 2.0 * d * fx * n[0] + own * n[0] * n[0])
    total[1] += weight * (inverse - yy - 2.0 * d * fy * n[1] + own * n[1] * n[1])
    total[2] += weight * (inverse - zz - 2.0 * d * fz * n[2] + own * n[2] * n[2])
    total[3] += weight * (-xy - d * (fx * n[1] + fy * n[0]) + own * n[0] * n[1])
    total[4] += weight * (-xz - d * (fx * n[2] + fz * n[0]) + own * n[0] * n[2])
    total[5] += weight * (-yz - d * (fy * n[2] + fz * n[1]) + own * n[1] * n[2])
    share = 2.0 * weight * 0.25 / np.pi / twice
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        ex, ey, ez = q[c, 0] - q[b, 0], q[c, 1] - q[b, 1], q[c, 2] - q[b, 2]
        gx, gy, gz = n[1] * ez - n[2] * ey, n[2] * ex - n[0] * ez, n[0] * ey - n[1] * ex
        at_foot = gx * (x - q[b, 0]) + gy * (y - q[b, 1]) + gz * (z - q[b, 2])
        total[at + a] -= share * (at_foot * omega - d * (gx * fx + gy * fy + gz * fz))


@compiled
def add_near(p, q, m, n, areas, points, weights, total):
    """Add the integrals over facets p and q of normals m and n, per product of their areas, to `total` (12,).

    The facets take turns: one is integrated in closed form, the other by points. B is the mean of the two.
    """
    for k in range(len(weights)):
        a, b, c, half = points[k, 0], points[k, 1], points[k, 2], 0.5 * weights[k]
        x, y, z = (
            a * p[0, 0] + b * p[1, 0] + c * p[2, 0],
            a * p[0, 1] + b * p[1, 1] + c * p[2, 1],
            a * p[0, 2] + b * p[1, 2] + c * p[2, 2],
        )
        add_plane(x, y, z, q, n, half / areas[1], 6, total)
        x, y, z = (
            a * q[0, 0] + b * q[1, 0] + c * q[2, 0],
            a * q[0, 1] + b * q[1, 1] + c * q[2, 1],
            a * q[0, 2] + b * q[1, 2] + c * q[2, 2],
        )
        add_plane(x, y, z, p, m, half / areas[0], 9, total)
