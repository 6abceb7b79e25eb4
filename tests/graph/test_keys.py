"""Content keys: what a result depends on changes its key, and nothing else does."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from vdmbench.graph import keys
from vdmbench.graph.keys import Wanted, case_hash, direction, load_steps, wanted
from vdmbench.study.loads import KINDS
from vdmbench.study.profiles import VERSIONS
from vdmbench.study.registry import all_models, find
from vdmbench.study.schema import Study
from vdmbench.study.sweep import substituted

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


def answers(of: Study, mesh: str = "mesh") -> dict[tuple[str, int], Wanted]:
    return {(want.name, want.level): want for want in wanted(of, mesh)}


@pytest.mark.parametrize("what", DECIDES)
def test_what_decides_an_answer_is_in_its_key(what: str) -> None:
    place, value, read_by = DECIDES[what]
    one, other = study(), study(place, value)
    assert case_hash(one, "mesh") != case_hash(other, "mesh")
    before, after = answers(one), answers(other)
    assert {name for name, level in before if before[name, level] != after[name, level]} == read_by


def test_another_mesh_is_another_answer() -> None:
    one, other = (answers(study(), mesh) for mesh in ("mesh", "finer"))
    assert not {key for want in one.values() for key in want.answers} & {
        key for want in other.values() for key in want.answers
    }


def test_each_level_of_the_reference_is_a_set_up_of_its_own() -> None:
    found = answers(study())
    assert set(found) == {(name, 0) for name in ALL} | {("fem-linear", 1)}
    assert found["fem-linear", 0].body != found["fem-linear", 1].body


@pytest.mark.parametrize("what", NAMES_ONLY)
def test_a_name_decides_nothing(what: str) -> None:
    assert answers(study()) == answers(study(*NAMES_ONLY[what]))


def test_loads_of_one_body_share_its_set_up() -> None:
    one, other = answers(study()), answers(study(("constraints", 1, "force"), 0.03))
    for place, want in one.items():
        assert want.body == other[place].body
        assert want.answers != other[place].answers


def test_multiples_of_a_load_have_one_answer() -> None:
    weightless = substituted(STUDY, ("gravity", "acceleration"), [0.0, 0.0, 0.0])
    history = Study.model_validate(substituted(weightless, ("load", "factors"), [0.0, 0.5, -1.0]))
    want = answers(history)["fem-linear", 0]
    assert len(set(want.answers)) == 1
    assert want.scales == pytest.approx((0.0, 0.01, -0.02))
    twice = substituted(weightless, ("constraints", 1, "force"), 0.04)
    both = Study.model_validate(substituted(twice, ("constraints", 2, "displacement"), [0.002, 0.0, 0.0]))
    assert answers(both)["fem-linear", 0].answers == want.answers[:1]
    assert answers(Study.model_validate(twice))["fem-linear", 0].answers != want.answers[:1], (
        "not all doubled"
    )
    assert answers(both)["fem", 0].answers != answers(history)["fem", 0].answers, "a load path is not scaled"


def test_a_weight_does_not_scale() -> None:
    history = study(("load", "factors"), [0.5, 1.0])
    want = answers(history)["fem-linear", 0]
    assert len(set(want.answers)) == 2
    assert want.scales == (1.0, 1.0)


def test_a_penalty_is_a_load_path() -> None:
    assert answers(study())["vdm-vector", 0].scales == ()


def test_small_loads_beside_large_ones_keep_their_digits() -> None:
    (one, _), (other, _) = (direction({"force": 1e5, "moved": moved}) for moved in (1e-7, 1.0001e-7))
    assert one != other


def test_an_unknown_kind_of_constraint_has_no_loads_to_be_told_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two studies that differ in its size alone would share an answer, also the one that the disk cache keeps."""
    inputs = keys.case_inputs(study())
    drag = {"kind": "drag", "region": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.5}}, "traction": 2.0}
    monkeypatch.setattr(keys, "case_inputs", lambda _: {**inputs, "constraints": [drag]})
    for ask in (load_steps, lambda s: wanted(s, "mesh")):
        with pytest.raises(ValueError, match="kind 'drag' has no unit loads"):
            ask(study())


def test_a_contact_is_told_by_every_key_that_it_has() -> None:
    def units(**more: float) -> list[dict[str, float]]:
        press = {"kind": "contact", "region": {}, "profile": "uniform", "force": 2.0, **more}
        return load_steps(study(), {"constraints": [press], "regions": {}})

    assert units(friction=0.1) != units(friction=0.2)


def test_a_profile_or_a_kind_that_has_changed_is_another_answer_and_another_case(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = study()
    used = {part.profile for part in one.constraints if part.kind == "contact"}
    before = answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh")
    assert before == (answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh"))
    monkeypatch.setitem(VERSIONS, str(used.pop()), "2")
    profile = answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh")
    monkeypatch.setitem(KINDS, "contact", dataclasses.replace(KINDS["contact"], version="2"))
    kind = answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh")
    assert len({before[0], profile[0], kind[0]}) == len({before[1], profile[1], kind[1]}) == 3


def test_what_is_set_up_for_a_contact_is_set_up_for_its_place() -> None:
    """Elements condensed to the nodes of a contact serve no other; the others' set-ups serve both."""
    names = {"name": "keys", "models": ["fem-condensed", "fem-linear"], "reference": "fem-linear"}
    plain = {**STUDY, "study": names, "anisotropy": None, "models": {}, "vdm": {}}
    moved = substituted(plain, ("regions", "finger", "cap", "angle"), 0.6)
    bodies = [
        {want.name: want.body for want in wanted(Study.model_validate(data), "mesh") if not want.level}
        for data in (plain, moved)
    ]
    assert bodies[0]["fem-condensed"] != bodies[1]["fem-condensed"]
    assert bodies[0]["fem-linear"] == bodies[1]["fem-linear"]


def test_a_refusal_ends_when_the_model_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"name": "keys", "models": ["bem", "fem-linear"], "reference": "fem-linear"}
    lump = {"name": "lump", "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.01}, "youngs_modulus": 5e4}
    rest = {key: STUDY[key] for key in ("geometry", "tissue", "regions", "constraints")}
    one = Study.model_validate({**rest, "study": names, "inclusions": [lump]})
    before = {name: want.body for (name, level), want in answers(one).items() if not level}
    model, _ = find("bem")
    taught = dataclasses.replace(model, takes={**model.takes, "inclusions": model.solvers})
    monkeypatch.setitem(all_models(), "bem", taught)
    after = {name: want.body for (name, level), want in answers(one).items() if not level}
    assert before["bem"] != after["bem"]
    assert before["fem-linear"] == after["fem-linear"]
