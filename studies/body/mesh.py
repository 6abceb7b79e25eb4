"""A tetrahedral mesh and its boundary surface as plain arrays, on which every model is built."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from solver_common.arrays import Array, Index, Mask

from .surface_measures import shells

T = TypeVar("T")
_MOST_KNOWN = 64  # results remembered on a mesh: contacts of a sweep, of some 100 kB each


def read_only(value: T) -> T:
    """The same value with all its arrays read-only: models share their input."""
    if isinstance(value, np.ndarray):
        value.flags.writeable = False
    elif isinstance(value, Mapping):
        read_only(list(value.values()))
    elif isinstance(value, list | tuple):
        for part in value:
            read_only(part)
    elif is_dataclass(value):
        for part in fields(value):
            read_only(getattr(value, part.name))
    return value


@dataclass(frozen=True)
class Mesh:
    """n points, m tetrahedra and their boundary of N surface nodes and F triangles; its arrays are read-only.

    Attributes
    ----------
    points : (n, 3) coordinates [m]
    tetrahedra : (m, 4) indices into `points`, positive volume; (0, 4) where no model needs the inside
    surface_nodes : (N,) ascending indices into `points`: surface node i is point `surface_nodes[i]`
    triangles : (F, 3) indices into 0..N-1, outward
    groups : named sets of surface nodes, (N,) masks
    volumes : named sets of tetrahedra, (m,) masks
    quality : figures for the record, such as `worst_sicn` and `surface_distance`
    moved : (N,) largest distance between the surface and that of the file near each node [m], None for other bodies
    """

    points: Array
    tetrahedra: Index
    surface_nodes: Index
    triangles: Index
    groups: Mapping[str, Mask] = field(default_factory=dict)
    quality: Mapping[str, float] = field(default_factory=dict)
    volumes: Mapping[str, Mask] = field(default_factory=dict)
    moved: Array | None = None

    def __post_init__(self) -> None:
        read_only([getattr(self, part.name) for part in fields(self)])

    @cached_property
    def surface_points(self) -> Array:
        """(N, 3) coordinates of the surface nodes [m]."""
        return read_only(self.points[self.surface_nodes])

    @cached_property
    def shells(self) -> Index:
        """(F,) the closed piece of each facet: 0 the outer one, then the walls of cavities."""
        return read_only(shells(self.surface_points, self.triangles))

    @cached_property
    def in_cavity(self) -> Mask:
        """(N,) surface nodes on the walls of cavities."""
        found = np.zeros(len(self.surface_nodes), dtype=bool)
        found[self.triangles[self.shells > 0]] = True
        return read_only(found)

    @cached_property
    def known(self) -> dict[Hashable, Any]:
        """Results computed on this mesh alone, by key; see `remembered`."""
        return {}

    def remembered(self, asked: Hashable, work: Callable[[], T]) -> T:
        """The result of `work`, computed once for a mesh and key; it must depend on these two alone."""
        if asked not in self.known:
            if len(self.known) >= _MOST_KNOWN:
                self.known.clear()
            self.known[asked] = read_only(work())
        found: T = self.known[asked]
        return found

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the arrays."""
        digest = hashlib.sha256()
        for name in ("points", "tetrahedra", "surface_nodes", "triangles"):
            array = np.ascontiguousarray(getattr(self, name))
            digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
            digest.update(array.tobytes())
        for name, mask in sorted(self.groups.items()):
            digest.update(name.encode())
            digest.update(np.packbits(mask).tobytes())
        for name, mask in sorted(self.volumes.items()):
            digest.update(f"volume {name}".encode())
            digest.update(np.packbits(mask).tobytes())
        return digest.hexdigest()
