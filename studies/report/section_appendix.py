"""Where the numbers come from and how to get them again."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from ..study.registry import PARAMETERS
from ..verdict.digest import Digest
from ..verdict.formatting import listed, plain, plural
from .blocks import Block, Code, Facts, Section, Text

_MESH_UNITS = {
    "area": "m²",
    "volume": "m³",
    "seconds": "s",
    "surface_distance_max": "m",
    "surface_distance_mean": "m",
}
_PARAMETER_UNITS = {
    **{name: unit for name, (_, unit) in PARAMETERS.items()},
    "youngs_modulus": "Pa",
    "density": "kg/m³",
    "coarse_density": "kg/m³",
    "solver_estimated_bytes": "B",
    "matrix_bytes": "B",
    "seconds_precompute": "s",
}
_SHORT = 16  # hex digits of a hash that are shown


def how_to_reproduce(digest: Digest) -> Section:
    """The commands, and the study as it was written."""
    plan, name = digest.run.plan, digest.run.study.study.name
    words = plan.get("command") or ["run", name]
    commands = [words, ["report", str(plan.get("directory", f"results/runs/{name}"))]]
    blocks: list[Block] = [
        Text(
            "The first command runs the study, or what is still missing of it. The second makes this page again "
            "from the stored results."
        ),
        Code("\n".join(shlex.join(["vdmbench", *words]) for words in commands)),
        Text(
            "Every number on this page comes from the case files in the run directory, cases/<hash>.vtkhdf. "
            "ParaView opens them too. study.h5 and metrics.csv hold all metrics of all cases.",
            kind="note",
        ),
    ]
    if digest.run.study_text.strip():
        instead = ", whose geometry --surface replaced" if "--surface" in words else ""
        blocks.append(Code(digest.run.study_text.rstrip(), summary=f"The study file{instead}"))
    return Section("reproduce", "How to reproduce", blocks)


def provenance(digest: Digest) -> Section | None:
    """Packages, machine, meshes and the models' parameters."""
    if not digest.cases:
        return None
    files = _geometry_files(digest)
    rows = [("geometry file", listed(files))] if files else []
    rows.append(("surface nodes", _range([len(case.points) for case in digest.cases], "")))
    measured = dict.fromkeys(key for case in digest.cases for key in case.mesh_quality)
    for key in (key for key in measured if key != "surface_nodes"):
        values = [case.mesh_quality[key] for case in digest.cases if key in case.mesh_quality]
        rows.append((f"mesh: {key.replace('_', ' ')}", _range(values, _MESH_UNITS.get(key, ""))))
    keys = dict.fromkeys(key for case in digest.cases for key in case.provenance)
    rows += [(key.removeprefix("package.").replace("_", " "), _over_cases(digest, key)) for key in keys]
    blocks: list[Block] = [Facts(rows)]
    for model in digest.models:
        case = next((case for case in digest.cases if model in case.models), None)
        if case is None:
            continue
        result = case.models[model]
        entries = [
            ("version", result.version),
            *((key, _parameter(key, value)) for key, value in result.parameters.items()),
        ]
        suffix = "" if len(digest.cases) == 1 else f", as in {digest.case_name(case)}"
        blocks.append(Facts(entries, summary=f"Parameters of {model}{suffix}"))
    return Section("provenance", "Provenance", blocks)


def _geometry_files(digest: Digest) -> list[str]:
    """The names of the files that the bodies are from; their directories are the user's own affair."""
    paths = [case.study.geometry.path for case in digest.cases]
    return [path.name for path in dict.fromkeys(paths) if path is not None]


def _range(values: Sequence[float], unit: str) -> str:
    low, high = (plain(float(f(values)), 6 if float(f(values)).is_integer() else 3) for f in (min, max))
    return f"{low if low == high else f'{low} to {high}'} {unit}".strip()


def _over_cases(digest: Digest, key: str) -> str:
    values = list(dict.fromkeys(case.provenance[key] for case in digest.cases if key in case.provenance))
    if key == "date" and len(values) > 1:
        return f"{min(values)} to {max(values)}"
    if key.endswith("hash"):
        values = [value[:_SHORT] for value in values]
    if len(values) > 3:
        return f"{listed(values[:2])} and {plural(len(values) - 2, 'other')}".replace(" and ", ", ", 1)
    return listed(values)


def _parameter(name: str, value: float | str) -> str:
    if isinstance(value, str):
        return value
    unit = _PARAMETER_UNITS.get(name, "1")
    return plain(float(value), 6) + ("" if unit == "1" else f" {unit}")
