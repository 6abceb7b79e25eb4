"""Where the numbers come from and how to get them again."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping

from ..study.registry import PARAMETERS
from ..verdict.digest import Digest
from ..verdict.formatting import first_of, plain
from .blocks import Block, Code, Facts, Section, Text

_UNITS = {
    **{name: unit for name, (_, unit) in PARAMETERS.items()},
    "area": "m²",
    "volume": "m³",
    "seconds": "s",
    "surface_distance_max": "m",
    "surface_distance_mean": "m",
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
    """Packages, machine, meshes and the models' parameters, each over all cases."""
    cases = digest.cases
    if not cases:
        return None
    # the names of files alone: their directories are the user's own affair
    files = [path.name for case in cases if (path := case.study.geometry.path) is not None]
    rows = [("geometry file", first_of(list(dict.fromkeys(files)), 3))] if files else []
    rows.append(("surface nodes", _over([len(case.points) for case in cases], "surface_nodes")))
    rows += [
        (f"mesh: {key}", told)
        for key, told in _each(case.mesh_quality for case in cases)
        if key != "surface nodes"
    ]
    rows += _each(case.provenance for case in cases)
    blocks: list[Block] = [Facts(rows)]
    for model in digest.models:
        results = [case.models[model] for case in cases if model in case.models]
        if results:
            facts = [("version", _over([result.version for result in results], "version"))]
            facts += _each(result.parameters for result in results)
            blocks.append(Facts(facts, summary=f"Parameters of {model}"))
    return Section("provenance", "Provenance", blocks)


def _each(tables: Iterable[Mapping[str, float | str]]) -> list[tuple[str, str]]:
    """(key in words, its values) of every key of some tables."""
    found: dict[str, list[float | str]] = {}
    for table in tables:
        for key, value in table.items():
            found.setdefault(key, []).append(value)
    return [(k.removeprefix("package.").replace("_", " "), _over(values, k)) for k, values in found.items()]


def _over(values: list[float | str], key: str) -> str:
    """Numbers as a range with their unit, dates as one too, of other texts the first."""
    numbers = [float(value) for value in values if not isinstance(value, str)]
    if len(numbers) == len(values):
        ends = dict.fromkeys(plain(end, 6 if end.is_integer() else 3) for end in (min(numbers), max(numbers)))
        return f"{' to '.join(ends)} {_UNITS.get(key, '1').strip('1')}".strip()
    texts = list(dict.fromkeys(str(value)[: _SHORT if key.endswith("hash") else None] for value in values))
    return " to ".join(dict.fromkeys((min(texts), max(texts)))) if key == "date" else first_of(texts, 3)
