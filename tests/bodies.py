"""Bodies for tests, by their keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from vdmbench.study.shapes import Geometry


def shaped(shape: str, mesh_size: float, keys: Mapping[str, Any]) -> Geometry:
    """The [geometry] of these keys; a mesh size of 0 is left out."""
    size = {"mesh_size": mesh_size} if mesh_size else {}
    return Geometry.model_validate({"shape": shape, **size, **keys})
