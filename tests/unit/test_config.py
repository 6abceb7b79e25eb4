"""A study file becomes typed SI values, or every problem with its line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from studies.checks import SHAPE_KEYS
from studies.config import (
    Study,
    StudyError,
    case_inputs,
    expand,
    field_table,
    geometry_of,
    load_study,
    resolved,
)
from studies.geometry_spec import check_geometry
from studies.units import DIMENSIONS, QuantityError, to_si

FULL = """\
[study]
name = "palpation"
title = "A fingertip on a sphere"
models = ["vdm-paper", "vdm-vector:nonlinear", "fem-linear"]
reference = "fem-linear"

[geometry]
shape = "sphere"
radius = "50 mm"
mesh_size = "6 mm"

[tissue]
youngs_modulus = "5 kPa"
poisson_ratio = 0.4999
density = "1.06 g/cm^3"

[vdm]
bulk_modulus = "10 Pa"
foundation = "1 kPa/mm"
surface_tension = "58 mN/mm"
rotation = "global"

[models."vdm-vector:nonlinear"]
surface_tension = 60

[regions.base]
below = { axis = "z", fraction = 0.15 }
[regions.finger]
cap = { direction = [0, 0, 1], angle = "25 deg" }
[regions.rest]
all = [{ not = "base" }, { not = { any = ["finger", { box = { min = [0, 0, 0], max = ["1 cm", 1, 1] } }] } }]

[[constraints]]
kind = "fixed"
region = "base"
[[constraints]]
name = "tip"
kind = "contact"
region = "finger"
pressure = "0.2 kPa"
profile = "hertz"
[[constraints]]
kind = "constrained"
region = "rest"
displacement = ["0 mm", "0 mm", "-5 mm"]

[load]
factors = [0.25, 1]

[gravity]
acceleration = [0, 0, "-9.81 m/s^2"]

[environment]
pressure = "1 mbar"

[anisotropy]
fibre_direction = [1, 0, 0]
contrast = 3

[limits]
along = "constraints.tip.pressure"

[uncertainty]
levels = 3
"""

SMALL = """\
[study]
name = "small"
models = ["vdm-paper"]
[geometry]
shape = "sphere"
radius = 0.05
mesh_size = 0.006
[tissue]
youngs_modulus = 5e3
poisson_ratio = 0.45
[regions.base]
below = { axis = "z", fraction = 0.15 }
[regions.tip]
cap = { direction = [0, 0, 1], angle = 0.4 }
[[constraints]]
kind = "fixed"
region = "base"
[[constraints]]
kind = "contact"
region = "tip"
pressure = 200
"""


def load(directory: Path, text: str, **options: bool) -> Study:
    path = directory / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path, **options)


def problems(directory: Path, text: str) -> list[tuple[int, str, str]]:
    with pytest.raises(StudyError) as caught:
        load(directory, text)
    return [(problem.line, problem.key, problem.message) for problem in caught.value.problems]


def line_of(text: str, start: str) -> int:
    return next(n for n, line in enumerate(text.split("\n"), start=1) if line.startswith(start))


# --- what is read ---


def test_every_value_is_in_si(tmp_path: Path) -> None:
    study = load(tmp_path, FULL)
    assert study.geometry.radius == 0.05
    assert study.tissue.youngs_modulus == 5000.0
    assert study.tissue.density == 1060.0
    assert study.vdm_parameters() == {
        "bulk_modulus": 10.0,
        "foundation": 1e6,
        "surface_tension": 58.0,
        "rotation": "global",
    }
    assert study.model_parameters() == {"vdm-vector:nonlinear": {"surface_tension": 60.0}}
    cap = study.regions["finger"].cap
    assert cap is not None
    assert cap.angle == pytest.approx(math.radians(25), rel=1e-15)
    base, tip, rest = study.constraints
    assert (base.name, tip.name, rest.name) == ("base", "tip", "rest")
    assert (tip.pressure, tip.force, tip.profile) == (200.0, None, "hertz")
    assert rest.displacement == (0.0, 0.0, -0.005)
    assert study.load.factors == (0.25, 1.0)
    assert study.gravity is not None
    assert study.gravity.acceleration == (0.0, 0.0, -9.81)
    assert study.environment is not None
    assert study.environment.pressure == 100.0
    assert study.limits is not None
    assert study.limits.thresholds == (0.05, 0.10)
    parts = study.regions["rest"].all_of
    assert parts is not None
    assert [part if isinstance(part, str) else part.not_of is not None for part in parts] == [True, True]


def test_what_is_left_out_has_its_default(tmp_path: Path) -> None:
    study = load(tmp_path, SMALL)
    assert study.study.title == "small"
    assert study.study.reference is None
    assert study.tissue.density == 1060.0
    assert study.load.factors == (1.0,)
    assert study.constraints[1].profile == "uniform"
    assert study.constraints[0].profile is None
    assert (study.gravity, study.environment, study.anisotropy, study.uncertainty) == (None, None, None, None)
    assert study.vdm_parameters() == {}


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("50 mm", "m", 0.05),
        ("0.3mm", "m", 0.0003),
        ("-5e-1 cm", "m", -0.005),
        ("5 kPa", "Pa", 5000.0),
        ("120 mmHg", "Pa", 15998.6864898),
        ("2 N/mm^2", "Pa", 2e6),
        ("180 deg", "rad", math.pi),
        ("180°", "rad", math.pi),
        ("1.06 g/cm³", "kg/m^3", 1060.0),
        ("1 kPa/mm", "Pa/m", 1e6),
        ("9.81 m/s**2", "m/s^2", 9.81),
        ("250 mN", "N", 0.25),
        ("58 N/m", "N/m", 58.0),
    ],
)
def test_a_text_with_a_unit_is_the_same_float_as_the_number(text: str, unit: str, value: float) -> None:
    assert to_si(text, unit) == value  # exactly: the case hash is taken over it


def test_every_documented_example_of_a_quantity_converts() -> None:
    for unit, (_, example) in DIMENSIONS.items():
        assert to_si(float(example) if unit == "1" else example, unit) > 0


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("5 kPa", "m", '"kPa" is not a unit of a length; write it as in "50 mm"'),
        ("5 mm", "Pa", '"mm" is not a unit of a pressure or modulus'),
        ("5 %", "rad", '"%" is not a unit of an angle'),
        ("5 s", "rad", '"s" is not a unit of an angle'),
        ("20 degC", "Pa", '"degC" is not a unit of a pressure'),
        ("5", "m", '"5" has no unit; write a length with one, such as "50 mm", or a bare number in m'),
        ("5 furlongz", "m", 'unknown unit "furlongz"'),
        ("fifty mm", "m", '"fifty mm" is not a length'),
        ("9**9**9 m", "m", "is not a length"),
        ("1 m^9^9^9", "m", "is not a length"),
        ("__import__('os') m", "m", "is not a length"),
        ("1 m" + " " * 100, "m", "is not a length"),
        ("nan m", "m", "is not a length"),
        ("1e999 m", "m", "must be a finite number"),
        ("1e99999999999999999999 m", "m", "must be a finite number"),
        (float("nan"), "Pa", "must be a finite number"),
        (float("inf"), "Pa", "must be a finite number"),
        (10**400, "Pa", "must be a finite number"),
        (True, "Pa", 'must be a pressure or modulus, such as "5 kPa" or a number in Pa, not true or false'),
        ([1], "Pa", "not a list"),
        ({}, "1", "must be a plain number, such as 0.45, not a table"),
        ("0.45", "1", "must be a plain number without quotes or a unit"),
    ],
)
def test_what_is_no_quantity_is_refused_with_a_sentence(value: object, unit: str, message: str) -> None:
    with pytest.raises(QuantityError) as caught:
        to_si(value, unit)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


# --- canonical form ---


def test_the_resolved_form_is_plain_json_and_reads_back(tmp_path: Path) -> None:
    study = load(tmp_path, FULL)
    data = resolved(study)
    again = Study.model_validate(json.loads(json.dumps(data, allow_nan=False)))
    assert resolved(again) == data
    assert again == study
    assert data["geometry"] == {"shape": "sphere", "mesh_size": 0.006, "radius": 0.05}
    assert data["constraints"][1] == {
        "kind": "contact",
        "region": "finger",
        "name": "tip",
        "pressure": 200.0,
        "profile": "hertz",
    }


def test_units_order_title_and_comments_do_not_change_what_is_hashed(tmp_path: Path) -> None:
    other = """\
# the same study, written by somebody else
[[constraints]]
region = "base"
name = "base"
kind = "fixed"
[[constraints]]
pressure = "0.2 kPa"
region = "tip"
kind = "contact"
profile = "uniform"
[regions]
tip.cap = { angle = "0.4 rad", direction = [-0.0, 0.0, 1.0] }
[regions.base.below]
fraction = 0.15
axis = "z"
[tissue]
density = 1060
poisson_ratio = 0.45
youngs_modulus = "0.005 MPa"
[load]
factors = [1]
[geometry]
mesh_size = "6 mm"
radius = "5 cm"
shape = "sphere"
[study]
title = "Another title"
models = ["vdm-paper", "fem"]
reference = "fem"
name = "other"
"""
    first, second = (load(tmp_path, text) for text in (SMALL, other))
    assert json.dumps(case_inputs(first)) == json.dumps(case_inputs(second))
    assert resolved(first)["study"] != resolved(second)["study"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("radius = 0.05", "radius = 0.0500001"),
        ("mesh_size = 0.006", "mesh_size = 0.007"),
        ("poisson_ratio = 0.45", "poisson_ratio = 0.46"),
        ("fraction = 0.15", "value = 0.15"),
        ("pressure = 200", "force = 200"),
        ("pressure = 200", 'pressure = 200\nprofile = "hertz"'),
        ("[tissue]", "[vdm]\npenalty = 1e6\n[tissue]"),
        ("[tissue]", '[models."vdm-paper"]\npenalty = 1e6\n[tissue]'),
        ("[tissue]", "[load]\nfactors = [0.5, 1]\n[tissue]"),
        ("[tissue]", "[gravity]\nacceleration = [0, 0, -9.81]\n[tissue]"),
        ("[tissue]", "[environment]\npressure = 1\n[tissue]"),
        ("[tissue]", "[anisotropy]\nfibre_direction = [1, 0, 0]\ncontrast = 2\n[tissue]"),
        ("[tissue]", "[uncertainty]\nlevels = 2\n[tissue]"),
    ],
)
def test_what_decides_the_numbers_is_in_what_is_hashed(tmp_path: Path, old: str, new: str) -> None:
    assert SMALL.count(old) == 1
    assert case_inputs(load(tmp_path, SMALL)) != case_inputs(load(tmp_path, SMALL.replace(old, new)))


# --- geometry ---


@pytest.mark.parametrize(
    ("shape", "keys"),
    [
        ("sphere", "radius = 0.05"),
        ("ellipsoid", "semi_axes = [0.05, 0.04, 0.03]"),
        ("box", "size = [0.05, 0.04, 0.03]"),
        ("cylinder", "radius = 0.05\nlength = 0.1"),
        ("cylinder", 'radius = 0.05\nlength = 0.1\naxis = "x"'),
        ("organ", "size = 0.2"),
        ("file", 'path = "a.stl"'),
        ("file", 'path = "a.stl"\nsize = "20 cm"'),
        ("file", 'path = "a.stl"\nscale = 0.001'),
    ],
)
def test_every_shape_is_what_the_mesher_takes(tmp_path: Path, shape: str, keys: str) -> None:
    (tmp_path / "a.stl").write_text("solid")
    text = SMALL.replace('shape = "sphere"\nradius = 0.05', f'shape = "{shape}"\n{keys}')
    spec = geometry_of(load(tmp_path, text))
    check_geometry(spec)
    assert (spec.shape, spec.mesh_size) == (shape, 0.006)
    assert set(spec.parameters) <= set().union(*SHAPE_KEYS[shape])
    if shape == "cylinder":
        assert spec.parameters["axis"] == ("x" if "axis" in keys else "z")
    if shape == "file":
        assert spec.path == (tmp_path / "a.stl").resolve()


def test_a_file_with_tetrahedra_needs_no_mesh_size(tmp_path: Path) -> None:
    text = SMALL.replace(
        'shape = "sphere"\nradius = 0.05\nmesh_size = 0.006', 'shape = "file"\npath = "a.msh"'
    )
    (tmp_path / "a.msh").write_text("")
    assert geometry_of(load(tmp_path, text)).has_own_tetrahedra
    (tmp_path / "a.stl").write_text("")
    assert [key for _, key, _ in problems(tmp_path, text.replace("a.msh", "a.stl"))] == ["geometry.mesh_size"]


def test_a_surface_given_beside_the_study_replaces_the_geometry(tmp_path: Path) -> None:
    inside, outside = tmp_path / "studies", tmp_path / "data"
    inside.mkdir()
    outside.mkdir()
    surface = outside / "liver.obj"
    surface.write_text("")
    path = inside / "study.toml"
    path.write_text(SMALL.replace('"sphere"\nradius = 0.05', '"organ"\nsize = "190 mm"'))
    study = load_study(path, surface=surface)
    expected = {"shape": "file", "mesh_size": 0.006, "size": 0.19, "path": str(surface)}
    assert resolved(study)["geometry"] == expected
    assert resolved(expand(study)[0].study)["geometry"] == expected
    link = outside / "link.obj"
    link.symlink_to(surface)
    assert resolved(expand(load_study(path, surface=link))[0].study)["geometry"] == expected
    with pytest.raises(StudyError, match=r"study.toml:4: geometry.path: .*none.obj. does not exist"):
        load_study(path, surface=outside / "none.obj")


def test_files_outside_the_directory_need_leave(tmp_path: Path) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    (tmp_path / "a.stl").write_text("")
    (inside / "link.stl").symlink_to(tmp_path / "a.stl")
    for name in ("../a.stl", str(tmp_path / "a.stl"), "link.stl"):
        text = SMALL.replace('"sphere"\nradius = 0.05', f'"file"\npath = "{name}"')
        [(line, key, message)] = problems(inside, text)
        assert (line, key) == (6, "geometry.path")
        assert "--allow-outside" in message
        assert geometry_of(load(inside, text, allow_outside=True)).path == (tmp_path / "a.stl").resolve()


# --- what is wrong ---


def test_every_problem_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = """\
[study]
name = "../x"
models = ["vdm-papr", "fem", "fem"]
reference = "fem-linear"
[geometry]
shape = "sphere"
radius = 50
semi_axes = [1, 2]
mesh_sise = 1
[tissue]
youngs_modulus = true
poisson_ratio = 0.51
density = "5 m"
[regions.a]
below = { axis = "w", fraction = 0.1 }
[regions.b]
all = [ "a",
  "c" ]
[[constraints]]
kind = "contact"
region = "d"
pressure = "1 Pa"
force = "1 N"
[[constraints]]
name = "d"
kind = "fixed"
region = "a"
profile = "hertz"
[sweep]
"tissue.poison_ratio" = [0.3]
"""
    found = problems(tmp_path, text)
    assert [(line, key) for line, key, _ in found] == [
        (2, "study.name"),
        (3, "study.models[2]"),
        (3, "study.models[0]"),
        (4, "study.reference"),
        (5, "geometry.mesh_size"),
        (8, "geometry.semi_axes"),
        (9, "geometry.mesh_sise"),
        (11, "tissue.youngs_modulus"),
        (12, "tissue.poisson_ratio"),
        (13, "tissue.density"),
        (15, "regions.a.below.axis"),
        (18, "regions.b.all[1]"),
        (19, "constraints.d"),
        (21, "constraints.d.region"),
        (25, "constraints.d.name"),
        (28, "constraints.d.profile"),
        (30, 'sweep."tissue.poison_ratio"'),
    ]
    messages = "\n".join(message for _, _, message in found)
    for hint in ("vdm-paper", "mesh_size", "tissue.poisson_ratio"):
        assert f'did you mean "{hint}"?' in messages


CASES = {
    # change of SMALL: (old, new), line start that is blamed, key, part of the message
    "unknown key": ("= 5e3", "= 5e3\ndensty = 1000", "densty", "tissue.densty", 'did you mean "density"?'),
    "unknown table": ("[tissue]", "[tisue]\n[tissue]", "[tisue]", "tisue", 'did you mean "tissue"?'),
    "unknown choice": ('"sphere"', '"spere"', "shape", "geometry.shape", 'did you mean "sphere"?'),
    "choice of a wrong type": ('"sphere"', "3", "shape", "geometry.shape", "must be one of sphere, "),
    "missing key": ('name = "small"', "", "[study]", "study.name", "is missing: names the run directory"),
    "missing for the shape": ("radius = 0.05", "", "[geometry]", "geometry.radius", "a sphere needs"),
    "unused by the shape": ("radius = 0.05", "radius = 0.05\nlength = 1", "length", "geometry.length", "has no length"),
    "text for a table": ("[load]", "load = 'x'", "load", "load", "must be a table, not a text"),
    "bool as number": ("radius = 0.05", "radius = true", "radius", "geometry.radius", "not true or false"),
    "nan": ("= 5e3", "= nan", "youngs", "tissue.youngs_modulus", "finite"),
    "overflow": ("= 5e3", "= 1e999", "youngs", "tissue.youngs_modulus", "finite"),
    "E of zero": ("= 5e3", "= 0", "youngs", "tissue.youngs_modulus", "must be positive, not 0"),
    "E in kPa": ("= 5e3", "= 5", "youngs", "tissue.youngs_modulus", "mixed-up unit"),
    "nu too large": ("= 0.45", "= 0.5000001", "poisson", "tissue.poisson_ratio", "at most 0.5"),
    "nu of -1": ("= 0.45", "= -1", "poisson", "tissue.poisson_ratio", "above -1"),
    "density in g/cm^3": ("= 0.45", "= 0.45\ndensity = 1.06", "density", "tissue.density", "mixed-up unit"),
    "radius in mm": ("radius = 0.05", "radius = 50", "radius", "geometry.radius", "100 m across"),
    "radius in km": ("radius = 0.05", "radius = 0.0004", "radius", "geometry.radius", "mixed-up unit"),
    "coarse mesh": ("= 0.006", "= 0.06", "mesh_size", "geometry.mesh_size", "too large for a body"),
    "angle in degrees": ("angle = 0.4", "angle = 25", "cap", "regions.tip.cap.angle", 'write "25 deg"'),
    "zero direction": ("[0, 0, 1]", "[0, 0, 0]", "cap", "regions.tip.cap.direction", "zero vector"),
    "vector of two": ("[0, 0, 1]", "[0, 1]", "cap", "regions.tip.cap.direction", "must have 3 numbers, not 2"),
    "item of a vector": ("[0, 0, 1]", "[0, '1 m', 1]", "cap", "regions.tip.cap.direction", "item 2: "),
    "fraction": ("= 0.15", "= 1.5", "below", "regions.base.below.fraction", "between 0 and 1"),
    "half-space twice": ("= 0.15", "= 0.15, value = 1", "below", "regions.base.below", "either fraction or value"),
    "pressure in kPa": ("pressure = 200", "pressure = 2e5", "pressure", "constraints.tip.pressure", "mixed-up unit"),
    "force": ("pressure = 200", "force = 2e5", "force", "constraints.tip.force", "mixed-up unit"),
    "region twice": ("[regions.tip]", "[regions.tip]\ngroup = 'a'", "[regions.tip]", "regions.tip", "exactly one of"),
    "region empty": ("[regions.tip]", "[regions.x]\n[regions.tip]", "[regions.x]", "regions.x", "exactly one of"),
    "empty list of regions": ("[tissue]", "[regions.x]\nany = []\n[tissue]", "any", "regions.x.any", "at least 1 item"),
    "unsafe region": ("[tissue]", "[regions.'<b>']\ngroup = 'a'\n[tissue]", "[regions.'<", 'regions."<b>"', "not a usable"),
    "unknown region": ('region = "tip"', 'region = "tp"', 'region = "tp"', "constraints.tp.region", 'mean "tip"?'),
    "contact without region": ('region = "tip"\n', "", "[[constraints]]\nkind = \"contact\"", "constraints[1].region", "is missing"),
    "contact without load": ("pressure = 200", "", "[[constraints]]\nkind = \"contact\"", "constraints.tip", "either pressure or force"),
    "load on fixed": ('"contact"', '"fixed"', "pressure", "constraints.tip.pressure", "has no pressure"),
    "unknown kind": ('"contact"', '"kontact"', 'kind = "k', "constraints.tip.kind", 'did you mean "contact"?'),
    "kind free": ('"contact"', '"free"', 'kind = "free', "constraints.tip.kind", "unknown choice"),
    "constrained without": ('kind = "fixed"', 'kind = "constrained"', "[[constraints]]", "constraints.base.displacement", "is missing"),
    "profile of a half-space": ('region = "tip"', 'region = "base"\nname = "t"\nprofile = "hertz"', "profile", "constraints.t.profile", "needs a region that is a cap or a ball"),
    "two of one name": ('region = "tip"', 'region = "tip"\nname = "base"', 'name = "base"', "constraints.base.name", "another constraint"),
    "no models": ('["vdm-paper"]', "[]", "models", "study.models", "at least one model"),
    "unknown model": ('["vdm-paper"]', '["vdm-pape"]', "models", "study.models[0]", 'did you mean "vdm-paper"?'),
    "unknown solver": ('["vdm-paper"]', '["vdm-paper:lu"]', "models", "study.models[0]", "unknown model"),
    "reference left out": ("[geometry]", 'reference = "fem"\n[geometry]', "reference", "study.reference", "not among the models"),
    "override of another": ("[tissue]", "[models.fem]\npenalty = 1\n[tissue]", "[models.fem]", "models.fem", "model of this study"),
    "negative modulus": ("[tissue]", "[vdm]\nbulk_modulus = -1\n[tissue]", "bulk", "vdm.bulk_modulus", "positive or zero"),
    "no load factors": ("[tissue]", "[load]\nfactors = []\n[tissue]", "factors", "load.factors", "at least one number"),
    "infinite factor": ("[tissue]", "[load]\nfactors = [1, inf]\n[tissue]", "factors", "load.factors", "item 2: must be a finite"),
    "levels": ("[tissue]", "[uncertainty]\nlevels = 5\n[tissue]", "levels", "uncertainty.levels", "less than or equal to 4"),
    "levels as bool": ("[tissue]", "[uncertainty]\nlevels = true\n[tissue]", "levels", "uncertainty.levels", "a whole number, not true"),
    "levels as float": ("[tissue]", "[uncertainty]\nlevels = 3.5\n[tissue]", "levels", "uncertainty.levels", "a whole number, not a number"),
    "limits along nothing": ("[tissue]", "[limits]\nalong = 'constraints.tip.presure'\n[tissue]", "along", "limits.along", 'mean "constraints.tip.pressure"?'),
    "date": ("radius = 0.05", "radius = 2020-01-02", "radius", "geometry.radius", "not a date or time"),
    "title of two lines": ('name = "small"', 'name = "small"\ntitle = "a\\nb"', "title", "study.title", "one line"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_mistake_is_told_with_its_line_and_key(tmp_path: Path, case: str) -> None:
    old, new, start, key, message = CASES[case]
    text = SMALL.replace(old, new, 1) if old in SMALL else f"{new}\n{SMALL}"
    [found] = problems(tmp_path, text)
    before, _, second = start.partition("\n")
    line = text[: text.index(start)].count("\n") + 1 if second else line_of(text, before)
    assert found[:2] == (line, key)
    assert message in found[2]


@pytest.mark.parametrize(
    "name", ["../x", "a/b", ".x", "", "a" * 65, "a\\u0000b", "<script>", "a b", "é", "a\\n"]
)
def test_unsafe_names_are_refused(tmp_path: Path, name: str) -> None:
    [(line, key, message)] = problems(tmp_path, SMALL.replace('name = "small"', f'name = "{name}"'))
    assert (line, key) == (2, "study.name")
    assert "is not a usable name" in message
    assert message.isprintable()


def test_regions_that_refer_to_themselves_or_grow_without_end_are_refused(tmp_path: Path) -> None:
    chain = "".join(f"[regions.r{n}]\nall = ['r{n + 1}', {{ not = 'r{n + 1}' }}]\n" for n in range(30))
    cycle = "[regions.p]\nnot = { any = ['q'] }\n[regions.q]\nall = ['p']\n[regions.into]\nnot = 'p'\n"
    found = problems(tmp_path, SMALL + chain + "[regions.r30]\ngroup = 'g'\n" + cycle)
    by_key = {key: message for _, key, message in found}
    assert {key for key, message in by_key.items() if "refers to itself" in message} == {
        "regions.p",
        "regions.q",
    }
    # r30 takes 1 step, r(n) takes 2 + 2 r(n+1): 1 + 3 (2^k - 1) steps, past 1,000 from k = 9 on
    too_large = {key for key, message in by_key.items() if "is made of more than" in message}
    assert {f"regions.r{n}" for n in range(22)} | {"regions.into"} == too_large


def test_known_models_can_be_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(SMALL.replace("vdm-paper", "mine:fast"))
    assert load_study(path, known_models=lambda: ["mine", "mine:fast"]).study.models == ("mine:fast",)
    with pytest.raises(StudyError, match='did you mean "mine:slow"'):
        load_study(path, known_models=["mine:slow"])


# --- the reference of keys ---


def test_the_reference_lists_every_key_with_its_help() -> None:
    rows = {row.key: row for row in field_table()}
    assert all(row.help and row.kind for row in rows.values())
    assert rows["tissue.density"].default == "1060.0"
    assert rows["tissue.density"].kind == "density [kg/m^3]"
    assert rows["geometry.semi_axes"].kind == "list of 3: length [m]"
    assert rows["regions.NAME.cap.angle"].default == "required"
    assert rows["regions.NAME.all"].kind == "list of regions"
    assert rows["models.NAME.rotation"].kind == "none | global | nodal"
    written = {
        ".".join(str(part) for part in path)
        .replace("constraints.0", "constraints[]")
        .replace("vdm-vector:nonlinear", "NAME")
        .replace("regions.finger", "regions.NAME")
        for path in _leaves(tomllib.loads(FULL))
    }
    keys = {
        key
        for key in written
        if not key.startswith(("regions.base", "regions.rest", "constraints.1", "constraints.2"))
    }
    assert keys <= set(rows)


def _leaves(data: object, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(data, dict):
        return [leaf for key, value in data.items() for leaf in _leaves(value, (*path, key))]
    if isinstance(data, list) and data and isinstance(data[0], dict) and path == ("constraints",):
        return [leaf for place, value in enumerate(data) for leaf in _leaves(value, (*path, place))]
    return [path]


def test_importing_the_study_file_loads_nothing_heavy() -> None:
    code = "import sys, studies.config; print(*sorted({m.partition('.')[0] for m in sys.modules}))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert not {"pint", "scipy", "gmsh", "h5py", "vtk", "pyvista", "meshio", "skfem"} & set(loaded)
