"""The studies that come with the package, and the file of a study by its name."""

from __future__ import annotations

import difflib
from pathlib import Path

SHIPPED = Path(__file__).parents[1] / "cases"


class NoSuchStudyError(ValueError):
    """Neither a file nor a shipped study; the message has the names that are near."""


def shipped_studies() -> dict[str, Path]:
    """Name -> file, sorted."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def study_path(study: str | Path) -> Path:
    """The file of a study: a path, or the name of a shipped one.

    Raises
    ------
    NoSuchStudyError
        neither of them.
    """
    path, known = Path(study), shipped_studies()
    if path.exists():
        return path
    if (found := known.get(str(study))) is not None:
        return found
    beside = {file.stem: str(file) for file in path.parent.glob("*.toml")}
    names = [
        found[name]
        for found in (beside, {name: name for name in known})
        for name in difflib.get_close_matches(path.stem[:80], found, n=2, cutoff=0.7)
    ]
    if not names and path.suffix == ".toml":
        return path  # whoever reads it says that it is not there
    hint = f"did you mean {' or '.join(names)}?" if names else f"shipped are: {', '.join(known)}"
    raise NoSuchStudyError(f"no study file {str(study)!r} and no shipped study of that name; {hint}")
