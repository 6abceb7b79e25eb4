"""Wavefront OBJ surfaces, polygons cut into triangles: numpy only.

A reader of our own: meshio's refuses files whose texture coordinates or normals are not one for each vertex, and
VTK's has coordinates in single precision.
Format: Wavefront, Advanced Visualizer manual, appendix B1 (`v` and `f` lines; all others are passed over).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_common.arrays import Array, Index

from ..study.errors import MeshError


def read_obj(path: Path) -> tuple[Array, Index]:
    """Points (n, 3) and triangles (F, 3); a polygon becomes a fan about its first corner.

    Raises MeshError for a line that cannot be read.
    """
    points: list[list[float]] = []
    triangles: list[list[int]] = []
    text = path.read_bytes().decode("utf-8", "replace").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])  # a weight or a colour may follow
                points.append([x, y, z])
            elif words[0] == "f":
                corners = [_index(word.split("/", 1)[0], len(points)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face needs three corners")
                triangles += [[corners[0], corners[k], corners[k + 1]] for k in range(1, len(corners) - 1)]
        except ValueError as error:
            raise MeshError(
                f"line {number} cannot be read; the file is damaged or of another kind"
            ) from error
    return np.array(points).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _index(word: str, n_points: int) -> int:
    """Position of a vertex: counted from 1, or from the last one so far where negative."""
    number = int(word)
    if number == 0 or abs(number) > 2**53:
        raise ValueError("vertices are counted from 1")
    return number - 1 if number > 0 else n_points + number
