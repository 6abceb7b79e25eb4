"""Meshes kept on disk by content key: written whole or not at all, checked before they are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Index

from ..machine import read_arrays, write_arrays
from ..study.shapes import Geometry, geometry_key
from .mesh import Mesh


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
    groups, volumes = (
        {name.removeprefix(kind): stored[name] for name in stored if name.startswith(kind)}
        for kind in ("group/", "volume/")
    )
    mesh = Mesh(
        points=stored["points"],
        tetrahedra=stored["tetrahedra"],
        surface_nodes=stored["surface_nodes"],
        triangles=stored["triangles"],
        groups=groups,
        volumes=volumes,
        quality=json.loads(str(stored["quality"])),
        moved=stored.get("moved"),
    )
    return mesh, stored.get("parents", np.empty((0, 2), dtype=np.int64))


def write_mesh(path: Path, mesh: Mesh, parents: Index | None = None) -> None:
    """Store a mesh, of a refinement with its parents, whole or not at all. Raises OSError."""
    arrays: dict[str, NDArray[Any]] = {
        "points": mesh.points,
        "tetrahedra": mesh.tetrahedra,
        "surface_nodes": mesh.surface_nodes,
        "triangles": mesh.triangles,
        "quality": np.array(json.dumps(dict(mesh.quality), sort_keys=True)),
    }
    if mesh.moved is not None:
        arrays["moved"] = mesh.moved
    if parents is not None:
        arrays["parents"] = parents
    arrays |= {f"volume/{name}": mask for name, mask in mesh.volumes.items()}
    arrays |= {f"group/{name}": mask for name, mask in mesh.groups.items()}
    write_arrays(path, arrays)
