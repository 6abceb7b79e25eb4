"""The origin of a case: packages, platform, source, mesh, time."""

from __future__ import annotations

import platform
import subprocess
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..body.mesh import Mesh
from ..machine import processor_name

PACKAGES = (
    "vdmbench",
    "numpy",
    "scipy",
    "scikit-fem",
    "gmsh",
    "meshio",
    "pyvista",
    "h5py",
    "rslab",
    "cholespy",
    "pyamg",
    "numba",
)


def provenance(mesh: Mesh) -> dict[str, str]:
    """The origin of a case: packages, platform, mesh, time."""
    return {
        **_machine(),
        "mesh_hash": mesh.content_hash,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


@cache
def _machine() -> dict[str, str]:
    return {
        **{f"package.{name}": _version(name) for name in PACKAGES},
        "commit": _commit(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": processor_name(),
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # an optional one
        return "not installed"


def _commit() -> str:
    """Commit of the running source tree, with "-dirty" if it has changes."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return "not a source tree"
    try:
        asked = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--dirty", "--exclude=*"]
        return subprocess.run(asked, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):  # no git, or git does not trust the tree's owner
        return "unknown"
