"""Content keys: equal keys are equal work, done once within a case, a study, and between studies.

mesh      geometry, size, whether tetrahedra are needed              (`vdmbench.study.shapes`)
body      model, mesh level, tissue, supports, parameters: one set-up
answer    body and load: one load step up to a factor if answers superpose, else one load path
case      all inputs, mesh, the version of each model

Keys are complete by construction: a field of the schema enters all of them, unless it is marked there (`Enters`).
From some tables a set-up's key includes only the keys that its model reads, as declared by models and kinds of
constraints.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .. import models
from ..study.config import case_inputs
from ..study.kinds import Enters
from ..study.loads import KINDS, VERSION
from ..study.registry import lacks
from ..study.schema import Study, extras_for, extras_of, has_weight

_FORMAT = 4  # of the answers' files; raised when their content changes
_DIGITS = 12  # of a load relative to others: further digits are rounding
_OF_MODELS = ("models", "reference", "homogeneous")  # of [study]; they enter a model's key in another form


@dataclass(frozen=True)
class Wanted:
    """The answers of one model on one mesh level that a case needs.

    Attributes
    ----------
    name, level : the model; 0 for the case's own mesh, 1 for its first refinement and so on
    body : key of the set-up
    answers : keys: one per load step if answers superpose, else one for the whole load path
    scales : factor of each step on its answer; () for a path
    """

    name: str
    level: int
    body: str
    answers: tuple[str, ...]
    scales: tuple[float, ...]


def case_hash(study: Study, mesh_key: str) -> str:
    """SHA-256 (hex) over all that decides a case's numbers: inputs, mesh, and each model's declared version."""
    return _digest(
        {
            "inputs": study.without(case_inputs(study), Enters.MESH),
            "mesh": mesh_key,
            "models": {name: models.find(name)[0].version for name in study.study.models},
            "loads": VERSION,
        }
    )


def wanted(study: Study, mesh_key: str) -> list[Wanted]:
    """The answers that a case needs: every model on its own mesh, and the reference on finer levels."""
    inputs = case_inputs(study)
    levels = study.uncertainty.levels if study.uncertainty else 1
    setup = study.without(inputs, Enters.MESH, Enters.CASE)
    steps, out = load_steps(study, inputs), []
    for name in study.study.models:
        finest = levels if name == study.study.reference else 1
        for level in range(finest):
            about = setup | _read_by(name, study, inputs) | {"mesh": level_key(mesh_key, level)}
            out.append(_wanted(study, steps, name, level, _digest(about)))
    return out


def _wanted(study: Study, steps: Sequence[Mapping[str, float]], name: str, level: int, body: str) -> Wanted:
    def key(load: Any) -> str:
        return _digest({"body": body, "load": load, "format": _FORMAT})

    if not models.superposes(name, penalty=has_penalty(study, name)) or "indenter" in extras_of(study):
        return Wanted(name, level, body, (key(steps),), ())
    sized = [direction(step) for step in steps]
    acting = next(
        (load for load, scale in sized if scale), sized[0][0]
    )  # a step without load is zero times any load
    return Wanted(
        name,
        level,
        body,
        tuple(key(load if scale else acting) for load, scale in sized),
        tuple(scale for _, scale in sized),
    )


def level_key(mesh_key: str, level: int) -> str:
    """Key of a mesh refined `level` times."""
    return f"{mesh_key}-{level}" if level else mesh_key


def load_steps(study: Study, inputs: Mapping[str, Any]) -> list[dict[str, float]]:
    """The loads of each step: load of size 1 -> its factor; the weight, which does not scale, is included.

    `inputs` are the study's `case_inputs`.
    """
    parts = _unit_loads(inputs)
    weight = {"weight": 1.0} if has_weight(study) else {}
    return [{unit: factor * value for unit, value in parts.items()} | weight for factor in study.load.history]


def direction(step: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """A load step up to a factor, and the factor; a step with weight as it is, with factor 1."""
    acting = {unit: value for unit, value in step.items() if value}
    if "weight" in acting:
        return acting, 1.0
    scale = max(acting.values(), key=abs, default=0.0)
    # 0.0 is added because -0.0 would be written differently
    return {unit: float(f"{value / scale:.{_DIGITS}g}") + 0.0 for unit, value in acting.items()}, scale


def has_penalty(study: Study, name: str) -> bool:
    """Whether a model holds its supports by a penalty, as printed."""
    given = {**study.vdm.given(), **study.model_parameters().get(name, {})}
    return "penalty" in given and "penalty" in models.reads(name)


def _read_by(name: str, study: Study, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The keys that a model's set-up reads from tables that it reads in part; None for no key of a table."""
    model, solver = models.find(name)
    weighs = has_weight(study)
    tissue = (*model.tissue, "density") if weighs else model.tissue
    parameters = {**inputs["vdm"], **(inputs["models"].get(name) or {})}
    return {
        "model": [model.name, solver, model.version, VERSION],
        "study": {key: value for key, value in inputs["study"].items() if key not in _OF_MODELS},
        "tissue": {key: inputs["tissue"][key] for key in tissue if key in inputs["tissue"]},
        "constraints": [_held(part, inputs) for part in inputs["constraints"] if KINDS[part["kind"]].holds],
        "supports": [
            {key: value for key, value in part.items() if key != "name"} | _held(part, inputs)
            for part in inputs["constraints"]
            if KINDS[part["kind"]].supports
        ],
        "gravity": inputs["gravity"] if weighs else None,
        "vdm": {key: value for key, value in parameters.items() if key in models.reads(name)},
        "environment": None if model.volumetric else inputs.get("environment"),
        "inclusions": None if name in study.study.homogeneous else inputs.get("inclusions"),
        "touched": _touched(inputs) if model.contact_in_setup else None,
        "lacks": lacks(name, extras_for(name, study)),  # a stored refusal ends when the model takes more
        **dict.fromkeys(("models", "regions", "load")),
    }


def _held(constraint: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    kind = KINDS[constraint["kind"]]
    apart = {"kind", "name", "region", *kind.loads}
    others = {key: value for key, value in constraint.items() if key not in apart}
    return {"region": inputs["regions"][constraint["region"]]} | others


def _touched(inputs: Mapping[str, Any]) -> list[tuple[str, float]]:
    """The places of contact, and one motion of held nodes up to a factor."""
    loads = _unit_loads(inputs)
    moved = {unit: value for unit, value in loads.items() if KINDS[unit.partition(" ")[0]].holds}
    largest = max(moved.values(), key=abs, default=0.0) or 1.0
    return [(unit, value / largest if unit in moved else 1.0) for unit, value in loads.items() if value]


def _unit_loads(inputs: Mapping[str, Any]) -> dict[str, float]:
    """Load of size 1 -> its factor at load factor 1, by components, without the weight."""
    out: dict[str, float] = {}
    for constraint in inputs["constraints"]:
        loads = KINDS[constraint["kind"]].loads
        apart = {"kind", "name", "region", *loads}
        about = {key: value for key, value in constraint.items() if key not in apart}
        described = json.dumps([about, inputs["regions"][constraint["region"]]], sort_keys=True)
        for name in loads:
            value = constraint.get(name, ())
            for axis, part in enumerate(value if isinstance(value, tuple | list) else [value]):
                unit = f"{constraint['kind']} {name} {axis} {described}"
                out[unit] = out.get(unit, 0.0) + float(part)
    return out


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()
