"""A tetrahedral mesh and its boundary surface as plain arrays: what every model is built on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from solver_common.arrays import Array, Index, Mask

T = TypeVar("T")
_MOST_KNOWN = 64  # things remembered on a mesh: contacts of a sweep, of some 100 kB each


@dataclass(frozen=True)
class Mesh:
    """n points, m tetrahedra and their boundary of N surface nodes and F triangles.

    Attributes
    ----------
    points : (n, 3) coordinates [m]
    tetrahedra : (m, 4) indices into `points`, positive volume; (0, 4) where no model needs the inside
    surface_nodes : (N,) ascending indices into `points`: surface node i is point `surface_nodes[i]`
    triangles : (F, 3) indices into 0..N-1, outward
    groups : named sets of surface nodes, (N,) masks
    volumes : named sets of tetrahedra, (m,) masks
    quality : figures for the record, such as `worst_sicn` and `surface_distance`
    centre : (3,) middle of the bounding box of the file that the body is from [m], zero of other shapes
    """

    points: Array
    tetrahedra: Index
    surface_nodes: Index
    triangles: Index
    groups: Mapping[str, Mask] = field(default_factory=dict)
    quality: Mapping[str, float] = field(default_factory=dict)
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    volumes: Mapping[str, Mask] = field(default_factory=dict)

    @cached_property
    def surface_points(self) -> Array:
        """(N, 3) coordinates of the surface nodes [m]."""
        return self.points[self.surface_nodes]

    @cached_property
    def known(self) -> dict[Hashable, Any]:
        """What has been worked out on this mesh alone, by what was asked; see `remembered`."""
        return {}

    def remembered(self, asked: Hashable, work: Callable[[], T]) -> T:
        """What `work` gives, done once for a mesh: a pure function of the mesh and of what is asked."""
        if asked not in self.known:
            if len(self.known) >= _MOST_KNOWN:
                self.known.clear()
            self.known[asked] = work()
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
