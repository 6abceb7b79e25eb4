"""Content keys: what a result depends on changes its key, and nothing else does."""

from __future__ import annotations

from typing import Any

import pytest

from studies import keys
from studies.keys import answer_key, case_hash, reference_keys, result_keys, unit_loads
from studies.study_file.schema import Study
from studies.study_file.sweep import substituted

SURFACE, VOLUME = {"vdm-paper", "vdm-vector"}, {"fem-linear", "fem"}
ALL = SURFACE | VOLUME
STUDY: dict[str, Any] = {
    "study": {"name": "keys", "models": sorted(ALL), "reference": "fem-linear"},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.012},
    "tissue": {"youngs_modulus": 5e3, "poisson_ratio": 0.49, "density": 1e3},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.5}},
        "tool": {"above": {"axis": "x", "fraction": 0.1}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "contact", "region": "finger", "force": 0.02},
        {"kind": "constrained", "region": "tool", "displacement": [0.001, 0.0, 0.0]},
    ],
    "load": {"factors": [1.0]},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "environment": {"pressure": 0.0},
    "anisotropy": {"fibre_direction": [1.0, 0.0, 0.0], "contrast": 2.0},
    "vdm": {"penalty": 1e6, "foundation": 1e4},
    "models": {"vdm-paper": {"bulk_modulus": 900.0}},
    "uncertainty": {"levels": 2},
}
DECIDES: dict[str, tuple[tuple[str | int, ...], Any, set[str]]] = {
    "stiffness": (("tissue", "youngs_modulus"), 6e3, ALL),
    "compressibility": (("tissue", "poisson_ratio"), 0.48, VOLUME),
    "density": (("tissue", "density"), 1.1e3, ALL),
    "weight": (("gravity", "acceleration", 0), 1.0, ALL),
    "fibres": (("anisotropy", "fibre_direction", 1), 1.0, ALL),
    "contrast": (("anisotropy", "contrast"), 3.0, ALL),
    "surroundings": (("environment", "pressure"), 10.0, SURFACE),
    "history": (("load", "factors"), [0.5, 1.0], ALL),
    "another full load": (("load", "factors"), [2.0], ALL),
    "steps": (("load", "steps"), 2, ALL),
    "support": (("regions", "base", "below", "fraction"), 0.3, ALL),
    "what is held": (("constraints", 0, "region"), "tool", ALL),
    "contact": (("regions", "finger", "cap", "angle"), 0.6, ALL),
    "force": (("constraints", 1, "force"), 0.03, ALL),
    "profile": (("constraints", 1, "profile"), "hertz", ALL),
    "movement": (("constraints", 2, "displacement", 2), -0.001, ALL),
    "parameter": (("vdm", "penalty"), 1e7, SURFACE),
    "parameter of one formulation": (("vdm", "foundation"), 2e4, {"vdm-vector"}),
    "parameter of one model": (("models", "vdm-paper", "bulk_modulus"), 800.0, {"vdm-paper"}),
    "figures of the condition": (("study", "condition"), True, ALL),
}
NAMES_ONLY: dict[str, tuple[tuple[str | int, ...], Any]] = {
    "study": (("study", "name"), "another"),
    "title": (("study", "title"), "Another"),
    "constraint": (("constraints", 1, "name"), "thumb"),
}


def study(*change: Any) -> Study:
    return Study.model_validate(substituted(STUDY, *change) if change else STUDY)


@pytest.mark.parametrize("what", DECIDES)
def test_what_decides_a_result_is_in_its_key(what: str) -> None:
    place, value, read_by = DECIDES[what]
    one, other = study(), study(place, value)
    assert case_hash(one, "mesh") != case_hash(other, "mesh")
    keys, others = result_keys(one, "mesh"), result_keys(other, "mesh")
    assert {name for name in keys if keys[name] != others[name]} == read_by
    same = "fem-linear" not in read_by
    assert (reference_keys(one, "mesh") == reference_keys(other, "mesh")) is same
    assert (answer_key(one, "mesh", "fem-linear") == answer_key(other, "mesh", "fem-linear")) is same


def test_another_mesh_is_another_result() -> None:
    one, other = (result_keys(study(), mesh) for mesh in ("mesh", "finer"))
    assert not set(one.values()) & set(other.values())


@pytest.mark.parametrize("what", NAMES_ONLY)
def test_a_name_decides_nothing(what: str) -> None:
    one, other = study(), study(*NAMES_ONLY[what])
    assert result_keys(one, "mesh") == result_keys(other, "mesh")
    assert reference_keys(one, "mesh") == reference_keys(other, "mesh")


def test_an_unknown_kind_of_constraint_has_no_loads_to_be_told_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two studies that differ in its size alone would share a reference, also the one that the disk cache keeps."""
    drag = {"kind": "drag", "region": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.5}}, "traction": 2.0}
    monkeypatch.setattr(keys, "anonymous_constraints", lambda _: [drag])
    plain = study(("gravity", "acceleration"), [0.0, 0.0, 0.0])
    for ask in (unit_loads, keys.loads_of, keys.load_key, lambda s: answer_key(s, "mesh", "fem-linear")):
        with pytest.raises(ValueError, match="kind 'drag' has no unit loads"):
            ask(plain)


def test_a_contact_is_told_by_every_key_that_it_has(monkeypatch: pytest.MonkeyPatch) -> None:
    def units(**more: float) -> list[tuple[str, float]]:
        press = {"kind": "contact", "region": {}, "profile": "uniform", "force": 2.0, **more}
        monkeypatch.setattr(keys, "anonymous_constraints", lambda _: [press])
        return unit_loads(study())

    assert units(friction=0.1) != units(friction=0.2)
