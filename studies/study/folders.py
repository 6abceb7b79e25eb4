"""Studies as results keep them: files and directories by their names, for folders may name a patient."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

GEOMETRY_PATH = "geometry.path"
# a quoted absolute path to a mesh, on any system
_ABSOLUTE = re.compile(
    r"""(["'])(?:/|~|[A-Za-z]:[\\/])[^"'\n]*[\\/]([^"'\\/\n]+\.(?:stl|obj|ply|vtp|vtk|vtu|msh))\1""",
    re.IGNORECASE,
)


def without_folders(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The inputs of a case, or a resolved study, with the names of geometry files only."""
    kept = dict(inputs)
    if (kept.get("geometry") or {}).get("path"):
        kept["geometry"] = {**kept["geometry"], "path": Path(str(kept["geometry"]["path"])).name}
    if GEOMETRY_PATH in (kept.get("sweep") or {}):
        axis = kept["sweep"][GEOMETRY_PATH]
        kept["sweep"] = {**kept["sweep"], GEOMETRY_PATH: [short_path(value) for value in axis]}
    return kept


def swept_without_folders(swept: Mapping[str, Any]) -> dict[str, Any]:
    """The swept values of a case, with the name alone of a geometry file that has an absolute path."""
    return {key: short_path(value) if key == GEOMETRY_PATH else value for key, value in swept.items()}


def short_path(value: Any) -> Any:
    """The name of a file that has an absolute path; any other value as it is."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def told_directory(directory: Path, command: Sequence[str]) -> str:
    """A run directory as its results name it: from the last name of --out on, else from `results` on."""
    given = command[command.index("--out") + 1] if "--out" in command else "runs"
    parts = directory.parts
    if given not in parts:
        return directory.name
    own = parts[len(parts) - 1 - parts[::-1].index(given) :]
    return str(Path(*own) if "--out" in command else Path("results", *own))


def text_without_folders(text: str) -> str:
    """The text of a study file with the name alone of each mesh file that has an absolute path."""
    return _ABSOLUTE.sub(r"\1\2\1", text)
