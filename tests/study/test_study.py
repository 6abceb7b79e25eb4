"""A study file becomes one typed study in SI values, and stays it as JSON."""

import json
import math
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vdmbench.study import units
from vdmbench.study.config import Study, case_inputs, expand, load_study, resolved
from vdmbench.study.errors import StudyError
from vdmbench.study.files import shipped_studies
from vdmbench.study.units import DIMENSIONS, QuantityError, to_si

from .study_texts import FULL, SMALL, load

# --- what is read ---


def test_every_value_is_in_si(tmp_path: Path) -> None:
    study = load(tmp_path, FULL)
    assert study.geometry.radius == 0.05
    assert study.tissue.youngs_modulus == 5000.0
    assert study.tissue.density == 1060.0
    assert study.vdm.given() == {
        "bulk_modulus": 10.0,
        "foundation": 1e6,
        "surface_tension": 58.0,
        "rotation": "global",
    }
    assert study.model_parameters() == {"vdm-vector:nonlinear": {"surface_tension": 60.0}}
    cap = study.regions["finger"].cap
    assert cap.angle == pytest.approx(math.radians(25), rel=1e-15)
    base, tip, moved = study.constraints
    assert (base.name, tip.name, moved.name) == ("base", "tip", "rest")
    assert (tip.pressure, tip.force, tip.profile) == (200.0, None, "hertz")
    assert moved.displacement == (0.0, 0.0, -0.005)
    assert study.load.factors == (0.25, 1.0)
    assert study.gravity.acceleration == (0.0, 0.0, -9.81)
    assert study.environment.pressure == 100.0
    assert study.limits.thresholds == (0.05, 0.10)
    rest = study.regions["rest"]
    assert rest.box.max == (0.01, 1.0, 1.0)


def test_what_is_left_out_has_its_default(tmp_path: Path) -> None:
    study = load(tmp_path, SMALL)
    assert study.study.title == "small"
    assert study.study.reference is None
    assert study.tissue.density == 1060.0
    assert study.load.factors == (1.0,)
    assert study.constraints[1].profile == "uniform"
    assert study.constraints[0].profile is None
    assert (study.gravity, study.environment, study.anisotropy, study.uncertainty) == (None, None, None, None)
    assert study.vdm.given() == {}


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.3mm", "m", 0.0003),
        ("-5e-1 cm", "m", -0.005),
        ("120 mmHg", "Pa", 15998.6864898),
        ("2 N/mm^2", "Pa", 2e6),
        ("180°", "rad", math.pi),
        ("1.06 g/cm³", "kg/m^3", 1060.0),
        ("1 kPa/mm", "Pa/m", 1e6),
        ("9.81 m/s**2", "m/s^2", 9.81),
    ],
)
def test_a_text_with_a_unit_is_the_same_float_as_the_number(text: str, unit: str, value: float) -> None:
    assert to_si(text, unit) == value  # exactly: the case hash is taken over it


@given(st.decimals(-1000, 1000, places=6, allow_nan=False))
def test_no_digit_is_lost_by_a_unit(number: Decimal) -> None:
    for text, factor in (
        ("mm", Decimal("1e-3")),
        ("km", 1000),
        ("um", Decimal("1e-6")),
        ("cm", Decimal("0.01")),
    ):
        assert to_si(f"{number} {text}", "m") == float(number * factor)


def test_every_documented_example_of_a_quantity_converts() -> None:
    for unit, (_, example) in DIMENSIONS.items():
        assert to_si(float(example) if unit == "1" else example, unit) > 0


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("5 kPa", "m", '"kPa" is not a unit of a length; write it as in "50 mm"'),
        ("5 %", "rad", '"%" is not a unit of an angle'),
        ("5 s", "rad", '"s" is not a unit of an angle'),
        ("20 degC", "Pa", '"degC" is not a unit of a pressure'),
        ("5", "m", '"5" has no unit; write a length with one, such as "50 mm", or a bare number in m'),
        ("5 furlongz", "m", 'unknown unit "furlongz"'),
        ("fifty mm", "m", '"fifty mm" is not a length'),
        ("9**9**9 m", "m", "is not a length"),
        ("1 m" + " " * 100, "m", "is not a length"),
        ("1e98 km", "m", "must be at most 1e+100 in size"),
        ("1e99999999999999999999 m", "m", "must be a finite number"),
        (float("nan"), "Pa", "must be a finite number"),
        (10**400, "Pa", "must be a finite number"),
        (True, "Pa", 'must be a pressure or modulus, such as "5 kPa" or a number in Pa, not true or false'),
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
models = ["vdm-paper"]
name = "other"
"""
    first, second = (load(tmp_path, text) for text in (SMALL, other))
    inputs = [json.dumps(case_inputs(study), sort_keys=True) for study in (first, second)]
    assert inputs[0] == inputs[1]
    assert resolved(first)["study"] != resolved(second)["study"]


# --- geometry ---


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
    assert study.study.name == expand(study)[0].study.study.name == "small-liver"
    path.write_text(path.read_text().replace('name = "small"', f'name = "{63 * "n"}"'))
    assert load_study(path, surface=surface).study.name == f"{58 * 'n'}-liver"
    asked = load_study(path, surface=surface, changes=[{"geometry": {"size": None, "scale": 0.01}}])
    assert resolved(asked)["geometry"] == {key: value for key, value in expected.items() if key != "size"} | {
        "scale": 0.01
    }
    with pytest.raises(StudyError, match="give size or scale, not both"):
        load_study(path, surface=surface, changes=[{"geometry": {"scale": 0.01}}])
    for key, value, told in (
        ("shape", "box", "geometry.shape: is that of the surface given; leave the change or"),
        ("path", "other.obj", "geometry.path: is that of the surface given"),
        ("size", [0.1, 0.1, 0.1], "geometry.size: "),
    ):
        with pytest.raises(StudyError, match=told):
            load_study(path, surface=surface, changes=[{"geometry": {key: value}}])
    with pytest.raises(StudyError, match="is swept, so that a change decides nothing"):
        load_study(path, surface=surface, changes=[{"sweep": {"geometry.path": [str(surface)]}}])
    link = outside / "link.obj"
    link.symlink_to(surface)
    assert resolved(expand(load_study(path, surface=link))[0].study)["geometry"] == expected


@pytest.mark.parametrize(
    ("unit", "text"), [(unit, text) for unit in units._COMMON for text in units._COMMON[unit]]
)
def test_common_units_are_those_of_the_library_of_all_units(unit: str, text: str) -> None:
    """What is converted without pint is converted alike, to the last digit: a hash must not know the difference."""
    registry = units._registry()
    one = registry.Quantity(Decimal(1), registry.parse_units(text))
    assert one.to(unit).magnitude == Decimal(units._COMMON[unit][text])


# --- as JSON ---


def _comes_back(study: Study) -> None:
    again = Study.model_validate_json(study.model_dump_json())
    assert again == study
    assert resolved(again) == resolved(study)
    assert [case.study for case in expand(again)] == [case.study for case in expand(study)]


@pytest.mark.parametrize("path", shipped_studies().values(), ids=list(shipped_studies()))
def test_a_shipped_study_comes_back_from_json(path: Path) -> None:
    _comes_back(load_study(path))


def test_any_study_comes_back_from_json(tmp_path: Path) -> None:
    (tmp_path / "a.stl").touch()
    _comes_back(load(tmp_path, FULL))
    text = SMALL.replace('"sphere"\nradius = 0.05', '"file"\npath = "a.stl"')
    _comes_back(
        load(tmp_path, text + '[sweep]\n"tissue.poisson_ratio" = { start = 0.3, stop = 0.4, num = 3 }\n')
    )
