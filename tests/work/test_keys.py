"""Content keys: what a result depends on changes its key, and nothing else does."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pytest

from vdmbench.study.files import substituted
from vdmbench.study.kinds import Enters, Table
from vdmbench.study.registry import all_models, find
from vdmbench.study.schema import Study
from vdmbench.study.shapes import Geometry, geometry_key
from vdmbench.work import keys
from vdmbench.work.keys import Wanted, case_hash, direction, load_steps, wanted

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
    "compressibility": (("tissue", "poisson_ratio"), 0.48, VOLUME),
    "surroundings": (("environment", "pressure"), 10.0, SURFACE),
    "history": (("load", "factors"), [0.5, 1.0], ALL),
    "support": (("regions", "base", "below", "fraction"), 0.3, ALL),
    "movement": (("constraints", 2, "displacement", 2), -0.001, ALL),
    "parameter": (("vdm", "penalty"), 1e7, SURFACE),
    "parameter of one formulation": (("vdm", "foundation"), 2e4, {"vdm-vector"}),
    "parameter of one model": (("models", "vdm-paper", "bulk_modulus"), 800.0, {"vdm-paper"}),
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


def test_a_contact_is_told_by_every_key_that_it_has() -> None:
    def units(**more: float) -> list[dict[str, float]]:
        press = {"kind": "contact", "region": "tip", "profile": "uniform", "force": 2.0, **more}
        return load_steps(study(), {"constraints": [press], "regions": {"tip": {}}})

    assert units(friction=0.1) != units(friction=0.2)


def test_loads_that_have_changed_are_other_answers_and_another_case(monkeypatch: pytest.MonkeyPatch) -> None:
    one = study()
    before = answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh")
    assert before == (answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh"))
    monkeypatch.setattr(keys, "VERSION", "of another program")
    now = answers(one)["vdm-paper", 0].answers, case_hash(one, "mesh")
    assert set(before[0]).isdisjoint(now[0])
    assert before[1] != now[1]


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
    names = {"name": "keys", "models": ["vdm-vector", "fem-linear"], "reference": "fem-linear"}
    lump = {"name": "lump", "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.01}, "youngs_modulus": 5e4}
    rest = {key: STUDY[key] for key in ("geometry", "tissue", "regions", "constraints")}
    one = Study.model_validate({**rest, "study": names, "inclusions": [lump]})
    before = {name: want.body for (name, level), want in answers(one).items() if not level}
    model, _ = find("vdm-vector")
    taught = dataclasses.replace(model, takes={**model.takes, "inclusions": model.solvers})
    monkeypatch.setitem(all_models(), "vdm-vector", taught)
    after = {name: want.body for (name, level), want in answers(one).items() if not level}
    assert before["vdm-vector"] != after["vdm-vector"]
    assert before["fem-linear"] == after["fem-linear"]


# --- every field of the schema ---

WHOLE: dict[str, Any] = STUDY | {
    "study": {
        "name": "keys",
        "models": [*sorted(all_models()), "vdm-paper:figure-8", "bem:nonlinear"],
        "reference": "fem",
    },
    "regions": STUDY["regions"]
    | {
        "leaf": {"below": {"axis": "y", "fraction": 0.2}},  # which nothing names
        "all": {
            "above": {"axis": "x", "value": 0.0},
            "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.01},
            "box": {"min": [0.0, 0.0, 0.0], "max": [0.1, 0.1, 0.1]},
            "group": "skin",
        },
    },
    "constraints": [
        *STUDY["constraints"],
        {"kind": "contact", "region": "all", "pressure": 3.0},
        {"kind": "line", "region": "finger", "resultant": [0.0, 0.0, 1.0]},
        {"kind": "elastic", "region": "finger", "stiffness": 1e5},
        {
            "kind": "indenter",
            "region": "finger",
            "shape": "capsule",
            "radius": 0.01,
            "depth": 0.001,
            "length": 0.01,
        }
        | {"along": [1.0, 0.0, 0.0], "push": [0.0, 0.0, -1.0]},
    ],
    "load": {"factors": [0.5, 1.0], "steps": 3},
    "vdm": {},
    "inclusions": [
        {"name": "a", "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.01}, "youngs_modulus": 5e4},
        {"name": "b", "box": {"min": [0.0, 0.0, 0.0], "max": [0.1, 0.1, 0.1]}, "youngs_modulus": 5e4},
    ],
    "inputs": {"tissue.youngs_modulus": {"sd": 100.0}},
    "limits": {},
    "measured": [
        {"name": "points", "points": [{"x": 0.0, "y": 0.0, "z": 0.05, "displacement_z": 0.001}]},
        {"name": "curve", "forces": [{"depth": 0.001, "force": 0.1}]},
    ],
    "models": {"vdm-paper": {"bulk_modulus": 900.0}},
}
CHOSEN = {
    "region": "base",
    "models": ("fem", "vdm-paper"),
    "homogeneous": ("fem",),
    "reference": "fem-linear",
}


def sample(kind: Any, now: Any) -> Any:
    """Another value of a type of the schema."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return sample(inner[0], now)
    if origin in (Union, UnionType):
        return sample(next(one for one in inner if one is not type(None)), now)
    if origin is Literal:
        return next(one for one in inner if one != now)
    if origin is tuple:
        return tuple(sample(one, None) for one in inner if one is not Ellipsis)
    if origin is dict:
        return {"sampled": sample(inner[1], None)}
    if issubclass(kind, Table):
        needed = {name: field for name, field in kind.model_fields.items() if field.is_required()}
        return kind.model_construct(
            **{name: sample(field.annotation, None) for name, field in needed.items()}
        )
    return not now if kind is bool else {float: 0.37, int: 7, str: "leaf", Path: Path("x.stl")}[kind]


def changed(table: Table, above: Enters | None) -> Iterator[tuple[str, Enters | None, Table]]:
    """A field of a table or of those in it, what it is declared to enter, and the table with that field changed."""
    for name, field in type(table).model_fields.items():
        value, mark = getattr(table, name), above or Enters.of(field) or table.enters
        inner: dict[Any, Any] = {}
        if isinstance(value, Table):
            inner = {None: value}
        elif isinstance(value, tuple | dict):
            pairs = value.items() if isinstance(value, dict) else enumerate(value)
            inner = {key: one for key, one in pairs if isinstance(one, Table)}
        for key, one in inner.items():
            for label, own, other in changed(one, mark):
                if key is None:
                    new: Any = other
                elif isinstance(value, dict):
                    new = value | {key: other}
                else:
                    new = (*value[:key], other, *value[key + 1 :])
                yield label, own, table.model_copy(update={name: new})
        if not inner and len(get_args(field.annotation)) != 1:  # what a table's only kind says stays
            new = CHOSEN[name] if name in CHOSEN else sample(field.annotation, value)
            owner = [one for one in type(table).__mro__ if name in getattr(one, "model_fields", ())][-1]
            yield f"{owner.__name__}.{name}", mark, table.model_copy(update={name: new})


def mesh_key(geometry: Table) -> str:
    one = Study.model_validate(STUDY).model_copy(update={"geometry": geometry})
    return geometry_key(one.geometry, volume=True)


def test_each_field_of_a_mesh_enters_its_key(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_text("a")
    (tmp_path / "b.stl").write_text("b")
    for kind in Geometry.kinds.values():
        of_mesh = {n: f for n, f in kind.model_fields.items() if Enters.of(f) is None and n != "shape"}
        given = {name: sample(field.annotation, None) for name, field in of_mesh.items()}
        given |= {"path": tmp_path / "a.stl"} if "path" in given else {}
        whole = kind.model_construct(shape=get_args(kind.model_fields["shape"].annotation)[0], **given)
        for name in of_mesh:
            other = tmp_path / "b.stl" if name == "path" else _other(getattr(whole, name))
            assert mesh_key(whole.model_copy(update={name: other})) != mesh_key(whole), (kind, name)


def _other(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_other, value))
    return f"{value}s" if isinstance(value, str) else value + 1


def test_each_field_enters_the_keys_of_what_may_read_it_or_is_declared_not_to() -> None:
    one = Study.model_validate(WHOLE)
    before, before_answers = case_hash(one, "mesh"), answers(one)
    found: dict[str, tuple[Enters | None, list[bool], list[bool]]] = {}
    for label, mark, other in changed(one, None):
        _, cases, of_answers = found.setdefault(label, (mark, [], []))
        cases.append(case_hash(other, "mesh") != before)
        after = answers(other)
        of_answers.append(
            any(want != before_answers[place] for place, want in after.items() if place in before_answers)
        )
    wrong = [
        label
        for label, (mark, cases, of_answers) in found.items()
        if (any(cases), any(of_answers))
        != {
            Enters.NOTHING: (False, False),
            Enters.MESH: (False, False),
            Enters.CASE: (True, False),
            None: (True, True),
        }[mark]
    ]
    assert not wrong
    assert len(found) > 100
