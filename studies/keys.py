"""What decides a result, as content keys: two things with one key are the same work, done once.

A case's hash names its file. The keys of results and set-ups say what cases, studies and runs can share.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from . import models
from .model_name import reads
from .study_file.config import case_inputs
from .study_file.schema import MOST_LEVELS, Study

_FORMAT = 2  # of the cache's files of references: raised with what is in them
_latest: list[tuple[Study, Mapping[str, Any]]] = []  # all keys of a case are asked for one after the other


def _inputs(study: Study) -> Mapping[str, Any]:
    if not _latest or _latest[0][0] is not study:
        _latest[:] = [(study, case_inputs(study))]
    return _latest[0][1]


def case_hash(study: Study, mesh_key: str) -> str:
    """SHA-256 (hex) over what decides a case's numbers: inputs, mesh, and each model's declared version."""
    return _digest(
        {
            "inputs": {name: value for name, value in _inputs(study).items() if name != "geometry"},
            "mesh": mesh_key,
            "models": {name: models.find(name)[0].version for name in study.study.models},
            "reference": study.study.reference,
        }
        | _outputs(study)
    )


def result_keys(study: Study, mesh_key: str) -> dict[str, str]:
    """Model name -> key of its result: mesh, tissue, supports, loads, version, and for VDM its parameters."""
    inputs = _inputs(study)
    scene = _body(inputs, mesh_key) | {
        "constraints": anonymous_constraints(study),
        "load": inputs["load"],
    }
    keys = {}
    for name in study.study.models:
        model, _ = models.find(name)
        own = {"model": name, "version": model.version, "overrides": inputs["models"].get(name)}
        own |= _outputs(study)
        if not model.volumetric:  # whose fluid keeps the volume whatever Poisson's ratio is
            own["tissue"] = {k: v for k, v in inputs["tissue"].items() if k != "poisson_ratio"}
            own |= _surface_inputs(inputs, name)
        keys[name] = _digest(scene | own)
    return keys


def _outputs(study: Study) -> dict[str, bool]:
    """What the models are asked for beyond the usual; nothing where they are not."""
    return {"condition": True} if study.study.condition else {}


def reference_keys(study: Study, mesh_key: str) -> list[str]:
    """Keys of what the reference answers on the study's mesh levels, and on more, which hold these."""
    if study.study.reference is None:
        return []
    answer = _answer(study, mesh_key, study.study.reference)
    fewest = study.uncertainty.levels if study.uncertainty else 1
    return [_digest(answer | {"levels": count}) for count in range(fewest, MOST_LEVELS + 1)]


def answer_key(study: Study, mesh_key: str, name: str) -> str:
    """Key of what a model answers on the case's mesh; of one that scales, up to a factor of its loads."""
    return _digest(_answer(study, mesh_key, name) | {"levels": 1})


def _answer(study: Study, mesh_key: str, name: str) -> dict[str, Any]:
    if has_weight(study) or not models.solves_together(name):
        return {"result": result_keys(study, mesh_key)[name], "format": _FORMAT}
    return {
        "model": name,
        "version": models.find(name)[0].version,
        "setup": setup_key(study, mesh_key),
        "loads": load_key(study),
        "format": _FORMAT,
    } | _outputs(study)


def setup_key(study: Study, mesh_key: str) -> str:
    """Key of what the volumetric models' set-ups depend on: cases that share it differ in loads and VDM only."""
    return _digest(_body(_inputs(study), mesh_key) | {"held": _held(study)})


def surface_setup_key(study: Study, mesh_key: str) -> str:
    """Key of what the surface models' set-ups depend on beyond their own tables: of the tissue what they read."""
    inputs = _inputs(study)
    read = ("youngs_modulus", "density") if has_weight(study) else ("youngs_modulus",)
    tissue = {key: inputs["tissue"][key] for key in read}
    return _digest(_body(inputs, mesh_key) | {"tissue": tissue, "held": _held(study)})


def model_setups(study: Study, mesh_key: str) -> dict[str, str]:
    """Model name -> key of its set-up."""
    return {name: _model_setup(study, mesh_key, name) for name in study.study.models}


def _model_setup(study: Study, mesh_key: str, name: str) -> str:
    inputs, model = _inputs(study), models.find(name)[0]
    if not model.volumetric:
        own = {"overrides": inputs["models"].get(name)} | _surface_inputs(inputs, name)
        return _digest({"body": surface_setup_key(study, mesh_key)} | own)
    body = setup_key(study, mesh_key)
    return _digest({"body": body, "to": _condensed_to(study)}) if model.name == "fem-condensed" else body


def _held(study: Study) -> list[dict[str, Any]]:
    inputs = _inputs(study)
    return [
        _anonymous({"kind": "held", "region": constraint["region"]}, inputs)
        for constraint in inputs["constraints"]
        if constraint["kind"] != "contact"
    ]


def _condensed_to(study: Study) -> list[tuple[str, float]]:
    """What a set-up of condensed elements is for: where there is contact, and one motion up to a factor."""
    loads = loads_of(study)
    moved = {unit: value for unit, value in loads.items() if not unit.startswith(("force ", "pressure "))}
    largest = max(moved.values(), key=abs, default=0.0) or 1.0
    return [(unit, value / largest if unit in moved else 1.0) for unit, value in loads.items() if value]


def _surface_inputs(inputs: Mapping[str, Any], name: str) -> dict[str, Any]:
    """What a surface model reads beside the body, its supports and loads and its own table."""
    read = {key: value for key, value in inputs["vdm"].items() if key in reads(name)}
    return {"vdm": read, "environment": inputs.get("environment")}


def _body(inputs: Mapping[str, Any], mesh_key: str) -> dict[str, Any]:
    gravity = inputs.get("gravity")
    return {
        "mesh": mesh_key,
        "tissue": inputs["tissue"],
        "gravity": gravity if gravity and any(gravity["acceleration"]) else None,
        "anisotropy": inputs.get("anisotropy"),
    }


def is_at_rest(study: Study) -> bool:
    """Whether no load acts, the weight apart."""
    return not any(part.force or part.pressure or any(part.displacement or ()) for part in study.constraints)


def has_weight(study: Study) -> bool:
    """Whether the body's weight acts, which does not scale with the loads."""
    return study.gravity is not None and any(study.gravity.acceleration)


def anonymous_constraints(study: Study) -> list[dict[str, Any]]:
    """A study's constraints without their names, with the regions themselves instead of the regions' names."""
    inputs = _inputs(study)
    return [_anonymous(constraint, inputs) for constraint in inputs["constraints"]]


def unit_loads(study: Study) -> list[tuple[str, float]]:
    """What acts at load factor 1, the weight apart: how much of which load of size 1.

    Raises
    ------
    ValueError
        a kind of constraint whose loads nobody has described: results kept under its key would serve others.
    """
    return [load for constraint in anonymous_constraints(study) for load in _unit_loads(constraint)]


def _unit_loads(constraint: Mapping[str, Any]) -> list[tuple[str, float]]:
    sizes = ("force", "pressure", "displacement")
    described = {k: v for k, v in constraint.items() if k != "kind" and k not in sizes}
    match constraint["kind"]:
        case "fixed":
            return []
        case "contact":
            size = "force" if constraint.get("force") is not None else "pressure"
            return [(f"{size} {described}", float(constraint.get(size) or 0.0))]
        case "constrained":
            return [(f"{axis} {described}", float(v)) for axis, v in enumerate(constraint["displacement"])]
        case kind:
            raise ValueError(
                f"a constraint of kind {kind!r} has no unit loads, so its results cannot be told from others'; "
                "describe them in studies.keys.unit_loads"
            )


def loads_of(study: Study) -> dict[str, float]:
    """Load of size 1 -> how much of it acts at load factor 1, the weight apart."""
    parts: dict[str, float] = {}
    for unit, value in unit_loads(study):
        parts[unit] = parts.get(unit, 0.0) + value
    return parts


def load_key(study: Study) -> str:
    """Key of a study's loads up to a common factor; of those with a weight, which does not scale, as they are."""
    parts = loads_of(study)
    largest = max((abs(value) for value in parts.values()), default=0.0)
    first = next((value for value in parts.values() if abs(value) == largest), 0.0)
    if not first or has_weight(study):
        return _digest({"loads": parts, "history": study.load.history})
    # 0.0 is added because -0.0 is written otherwise
    return _digest({"loads": {unit: round(value / first, 12) + 0.0 for unit, value in parts.items()}})


def _anonymous(constraint: Mapping[str, Any], inputs: Mapping[str, Any]) -> dict[str, Any]:
    """A constraint without its name, with the region itself instead of the region's."""
    return {k: v for k, v in constraint.items() if k != "name"} | {
        "region": _spelt_out(constraint["region"], inputs["regions"])
    }


def _spelt_out(region: Any, named: Mapping[str, Any]) -> Any:
    if isinstance(region, str):
        return _spelt_out(named[region], named)
    out = dict(region)
    for key in ("all", "any"):
        if key in out:
            out[key] = [_spelt_out(part, named) for part in out[key]]
    if "not" in out:
        out["not"] = _spelt_out(out["not"], named)
    return out


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
