"""Results of another program on a study's body, mapped to its surface nodes.

A file has rest points and displacements, or deformed positions, in metres and in the coordinates of the mesh. A
surface node at the place of a point takes its displacement exactly. Other nodes take that of the nearest point,
whose distance is reported. Nothing is extrapolated by more than half a mesh edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_common.arrays import Array

from ..body.mesh import Mesh
from ..body.read_apart import point_fields_of
from ..study.errors import InputError, MeshError
from ..study.measured import AXES, DEFORMED, DISPLACEMENT, Layouts, MeasuredFileError, read_table

NAMES = (
    "displacement",
    "Displacement",
    "u",
    "U",
    "DISPLACEMENT",
)  # accepted names of a displacement field
POSITIONS = ("position", "Position", "positions")
EXACT = 1e-6  # of the mean edge: closer nodes coincide
MOST_OFF = 0.5  # of the mean edge
MOST_BYTES = 200_000_000
_TABLES: Layouts = (
    ("displacements at places", (*AXES, *DISPLACEMENT), ("point",)),
    ("positions at places", (*AXES, *DEFORMED), ("point",)),
    ("displacements of nodes", ("node", *DISPLACEMENT), ("point",)),
    ("positions of nodes", ("node", *DEFORMED), ("point",)),
)
MOST_CSV_BYTES = 20_000_000  # a text takes about fifty times its size in memory


class ForeignResultError(InputError):
    """A file that is no result on this body; one line gives the reason and the remedy."""


@dataclass(frozen=True)
class Foreign:
    """A result of another program on N surface nodes.

    Attributes
    ----------
    displacement : (N, 3) [m]
    exact : share of the nodes with a point of the file at their place
    distance : largest distance of a node from the point that gives its displacement [m]
    bend : largest change of the file's own displacement over such a distance [m]: the possible error of mapping
    """

    displacement: Array
    exact: float
    distance: float
    bend: float


def read_foreign(path: Path, mesh: Mesh, array: str | None = None) -> Foreign:
    """Read a result file of another program for a mesh.

    Parameters
    ----------
    path : VTU or VTK with a displacement, or positions, at its points; or CSV with columns `node` or `x`, `y`, `z`,
        and `displacement_x` ... or `deformed_x` ..., units in brackets; `node` counts the surface nodes from 0
    array : name of the field of a VTU or VTK file; by default one of `NAMES` or `POSITIONS`

    Raises
    ------
    ForeignResultError
        a missing file or field, numbers that are not finite, points that are not on the body.
    """
    try:
        if path.exists() and not path.is_file():  # reading a FIFO or a device might never end
            raise ForeignResultError(f"{path}: is no regular file")
        if path.stat().st_size > MOST_BYTES:
            raise ForeignResultError(f"{path}: is larger than {MOST_BYTES // 1_000_000} MB")
        if path.suffix.lower() == ".csv":
            return _of_csv(path, mesh)
        if path.suffix.lower() in (".vtu", ".vtk"):
            return _of_vtk(path, mesh, array)
    except OSError as error:
        raise ForeignResultError(f"{path}: cannot be read: {error.strerror}") from None
    except (MeasuredFileError, MeshError) as error:
        told = str(error) if isinstance(error, MeasuredFileError) else f"{path.name} {error}"
        raise ForeignResultError(f"{path.parent / told}") from None
    raise ForeignResultError(f"{path}: unknown kind of file; give VTU, VTK or CSV")


def _of_csv(path: Path, mesh: Mesh) -> Foreign:
    _, rows = read_table(path, _TABLES, MOST_CSV_BYTES)
    deformed, by_node = DEFORMED[0] in rows[0], "node" in rows[0]

    def columns(keys: Sequence[str]) -> Array:
        return np.array([[row[key] for key in keys] for row in rows], dtype=float)

    values = columns(DEFORMED if deformed else DISPLACEMENT)
    if not by_node:
        rest = columns(AXES)
        return _mapped(path, rest, values - rest if deformed else values, mesh)
    (nodes,) = columns(("node",)).T
    count = len(mesh.surface_points)
    if not np.array_equal(np.sort(nodes), np.arange(count)):
        raise ForeignResultError(
            f"{path}: its column node is not each of 0 to {count - 1} once, which are the mesh's surface nodes"
        )
    ordered = values[np.argsort(nodes)]
    return Foreign(ordered - mesh.surface_points if deformed else ordered, 1.0, 0.0, 0.0)


def _of_vtk(path: Path, mesh: Mesh, array: str | None) -> Foreign:
    points, fields = point_fields_of(path)
    names = [name for name in ([array] if array else [*NAMES, *POSITIONS]) if name in fields]
    if not names:
        wanted = f"no field {array!r}" if array else "no field displacement or position"
        raise ForeignResultError(
            f"{path}: has {wanted} with three numbers a point; "
            f"it has {', '.join(sorted(fields)) or 'none'}: name one by --array"
        )
    values = fields[names[0]]
    moved = values - points if names[0] in POSITIONS else values
    return _mapped(path, points, moved, mesh)


def _mapped(path: Path, points: Array, displacement: Array, mesh: Mesh) -> Foreign:
    from scipy.spatial import cKDTree  # slow to load

    if not np.isfinite(displacement).all() or not np.isfinite(points).all():
        bad = int(
            np.flatnonzero(~np.isfinite(displacement).all(axis=1) | ~np.isfinite(points).all(axis=1))[0]
        )
        raise ForeignResultError(f"{path}: point {bad} has numbers that are not finite")
    corners = mesh.surface_points[mesh.triangles]
    edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())
    found, taken = cKDTree(points).query(mesh.surface_points)
    distance, nearest = np.asarray(found, dtype=float), np.asarray(taken)
    if distance.max() > MOST_OFF * edge:
        worst = int(distance.argmax())
        place = ", ".join(f"{x:.4g}" for x in mesh.surface_points[worst])
        raise ForeignResultError(
            f"{path}: has no point within {MOST_OFF:g} of an edge ({edge:.3g} m) of the surface node at ({place}) "
            f"m, the nearest is {distance[worst]:.3g} m off: another origin or unit, or too coarse a result?"
        )
    moved = displacement[nearest]
    return Foreign(
        moved, float((distance <= EXACT * edge).mean()), float(distance.max()), _bend(moved, distance, mesh)
    )


def _bend(moved: Array, distance: Array, mesh: Mesh) -> float:
    """Largest distance of all nodes times the steepest change of displacement along their edges."""
    steepest = np.zeros(len(moved))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        ends = mesh.triangles[:, [first, second]]
        length = np.linalg.norm(np.diff(mesh.surface_points[ends], axis=1)[:, 0], axis=1)
        slope = np.linalg.norm(np.diff(moved[ends], axis=1)[:, 0], axis=1) / length
        for end in ends.T:
            np.maximum.at(steepest, end, slope)
    return float((steepest * distance).max())
