"""What decides a result, as content keys: two things with one key are the same work, done once.

A case's hash names its file. The keys of results and set-ups say what cases, studies and runs can share.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from . import models
from .study_file.config import case_inputs
from .study_file.schema import Study

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
            tissue = {k: v for k, v in inputs["tissue"].items() if k != "poisson_ratio"}
            own |= {"tissue": tissue, "vdm": inputs["vdm"], "environment": inputs.get("environment")}
        keys[name] = _digest(scene | own)
    return keys


def _outputs(study: Study) -> dict[str, bool]:
    """What the models are asked for beyond the usual; nothing where they are not."""
    return {"condition": True} if study.study.condition else {}


def answer_key(study: Study, mesh_key: str, name: str, n_levels: int = 1) -> str:
    """Key of what a model answers on `n_levels` mesh levels; of one that scales, up to a factor of its loads."""
    if study.gravity is not None or not models.solves_together(name):
        return _digest({"result": result_keys(study, mesh_key)[name], "levels": n_levels, "format": _FORMAT})
    return _digest(
        {
            "model": name,
            "version": models.find(name)[0].version,
            "setup": setup_key(study, mesh_key),
            "loads": load_key(study),
            "levels": n_levels,
            "format": _FORMAT,
        }
        | _outputs(study)
    )


def setup_key(study: Study, mesh_key: str) -> str:
    """Key of what the volumetric models' set-ups depend on: cases that share it differ in loads and VDM only."""
    inputs = _inputs(study)
    held = [
        _anonymous({"kind": "held", "region": constraint["region"]}, inputs)
        for constraint in inputs["constraints"]
        if constraint["kind"] != "contact"
    ]
    return _digest(_body(inputs, mesh_key) | {"held": held})


def surface_key(study: Study) -> str:
    """Key of the parameters of the VDM models: cases of one set-up that share it share their set-ups too."""
    inputs = _inputs(study)
    return _digest({name: inputs.get(name) for name in ("vdm", "models", "environment")})


def _body(inputs: Mapping[str, Any], mesh_key: str) -> dict[str, Any]:
    return {"mesh": mesh_key, **{name: inputs.get(name) for name in ("tissue", "gravity", "anisotropy")}}


def anonymous_constraints(study: Study) -> list[dict[str, Any]]:
    """A study's constraints without their names, with the regions themselves instead of the regions' names."""
    inputs = _inputs(study)
    return [_anonymous(constraint, inputs) for constraint in inputs["constraints"]]


def unit_loads(study: Study) -> list[tuple[str, float]]:
    """What acts at load factor 1, the weight apart: how much of which load of size 1."""
    out: list[tuple[str, float]] = []
    for constraint in anonymous_constraints(study):
        described: dict[str, Any] = {k: v for k, v in constraint.items() if k in ("region", "profile")}
        if constraint["kind"] == "contact":
            size = "force" if constraint.get("force") is not None else "pressure"
            out.append((f"{size} {described}", float(constraint.get(size) or 0.0)))
        elif constraint["kind"] == "constrained":
            out += [(f"{axis} {described}", float(v)) for axis, v in enumerate(constraint["displacement"])]
    return out


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
    if not first or study.gravity is not None:
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
