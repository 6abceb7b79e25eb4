"""A case's surface with what each model answers on it, for other programs: in the unit of the scan it came from."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..measures.case import CaseResult


def mesh_names(cases: Sequence[CaseResult]) -> Iterator[tuple[str, CaseResult]]:
    """A file for each case with a name that a person can read: its label, and its hash where labels are alike."""
    seen: set[str] = set()
    for case in cases:
        name = re.sub(r"[^A-Za-z0-9.=-]+", "_", case.label).strip("_.")[:80] or "case"
        name = name if name not in seen else f"{name}-{case.hash[:8]}"
        seen.add(name)
        yield f"meshes/{name}.vtu", case


def surface_fields(case: CaseResult) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
    """Points (N, 3) and fields of a case at full load, lengths in the unit that `unit_of` tells."""
    step, metres = case.full_load, metres_per_unit(case)
    fields: dict[str, np.ndarray] = {}
    for name, model in case.models.items():
        fields[f"{name}.displacement"] = model.displacement[step] / metres
        fields[f"{name}.reaction_force"] = model.reaction_force[step]
        if case.reference is not None and name != case.reference:
            reference = case.models[case.reference].displacement[step]
            fields[f"{name}.difference"] = (model.displacement[step] - reference) / metres
    fields |= {f"region.{name}": mask.astype(np.int8) for name, mask in case.regions.items()}
    return case.points / metres, fields


def metres_per_unit(case: CaseResult) -> float:
    """1 but for a body from a file: what its unit is in metres."""
    return float(case.mesh_quality.get("scale", 1.0))


def unit_of(case: CaseResult) -> str:
    """The unit of a case's mesh, in words."""
    if "scale" not in case.mesh_quality:
        return "metres"
    file = Path(case.study.geometry.path or "its file").name
    return f"the unit of {file} ({metres_per_unit(case):.6g} m)"
