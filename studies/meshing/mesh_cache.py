"""Meshes kept on disk by content key: written whole or not at all, checked before they are read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..sealed import read_arrays, write_arrays
from .geometry_spec import Geometry, geometry_key
from .mesh import Mesh


def mesh_from_cache(geometry: Geometry, cache_dir: Path, *, volume: bool = True) -> Mesh:
    """The mesh of a geometry: from `cache_dir`/meshes/<key>.npz where that is sound, else built and kept.

    Raises MeshError as `studies.meshing.geometry.build_mesh` does, OSError where the directory cannot be written.
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
    stored = read_arrays(path)
    if stored is None:
        return None
    groups = {name.removeprefix("group/"): stored[name] for name in stored if name.startswith("group/")}
    return Mesh(
        points=stored["points"],
        tetrahedra=stored["tetrahedra"],
        surface_nodes=stored["surface_nodes"],
        triangles=stored["triangles"],
        groups=groups,
        quality=json.loads(str(stored["quality"])),
    )


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Store a mesh, whole or not at all. Raises OSError."""
    arrays = {
        "points": mesh.points,
        "tetrahedra": mesh.tetrahedra,
        "surface_nodes": mesh.surface_nodes,
        "triangles": mesh.triangles,
        "quality": np.array(json.dumps(dict(mesh.quality), sort_keys=True)),
    }
    write_arrays(path, arrays | {f"group/{name}": mask for name, mask in mesh.groups.items()})
