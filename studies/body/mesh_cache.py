"""Meshes kept on disk by content key: written whole or not at all, checked before they are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_common.arrays import Index

from ..machine import read_arrays, write_arrays
from ..study.shapes import Geometry, geometry_key
from .mesh import Mesh

_NO_PARENTS = np.empty((0, 2), dtype=np.int64)


def mesh_from_cache(geometry: Geometry, cache_dir: Path, *, volume: bool = True) -> Mesh:
    """The mesh of a geometry: from `cache_dir`/meshes/<key>.npz where that is sound, else built and kept.

    Raises MeshError as `vdmbench.body.geometry.build_mesh` does, OSError where the directory cannot be written.
    """
    path = mesh_path(cache_dir, geometry_key(geometry, volume=volume))
    mesh = read_mesh(path)
    if mesh is None:
        from .geometry import build_mesh  # gmsh is slow to load: only where it is needed

        mesh = build_mesh(geometry, volume=volume)
        write_mesh(path, mesh)
    return mesh


def mesh_path(cache_dir: Path, key: str) -> Path:
    """Where the cache keeps the mesh of a geometry's key."""
    return cache_dir / "meshes" / f"{key}.npz"


def read_mesh(path: Path) -> Mesh | None:
    """The mesh stored at `path`, or None where there is none or it is damaged."""
    found = read_level(path)
    return None if found is None else found[0]


def read_level(path: Path) -> tuple[Mesh, Index] | None:
    """A refinement and its parents (see `refine`), as `read_mesh`."""
    stored = read_arrays(path)
    if stored is None:
        return None
    parents = stored.pop("parents")
    return Mesh(**stored), parents


def write_mesh(path: Path, mesh: Mesh, parents: Index = _NO_PARENTS) -> None:
    """Store a mesh, of a refinement with its parents, whole or not at all. Raises OSError."""
    write_arrays(path, mesh, parents=parents)
