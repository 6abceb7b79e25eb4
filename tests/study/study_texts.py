"""Sound study files, and what reads them: for the tests of the study file."""

from pathlib import Path

import pytest

from vdmbench.study.config import ResolvedCase, Study, StudyError, expand, load_study

FULL = """\
[study]
name = "palpation"
title = "A fingertip on a sphere"
models = ["vdm-paper", "vdm-vector:nonlinear", "fem"]
reference = "fem"

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
above = { axis = "z", fraction = 0.15 }
box = { min = [0, 0, 0], max = ["1 cm", 1, 1] }

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

SWEPT = """\
[study]
name = "swept"
models = ["vdm-paper", "vdm-vector:lu"]
[geometry]
shape = "ellipsoid"
semi_axes = [0.05, 0.04, 0.03]
mesh_size = 0.006
[tissue]
youngs_modulus = 5e3
poisson_ratio = 0.45
[models."vdm-paper"]
penalty = 1e6
[regions."left.base"]
below = { axis = "z", fraction = 0.15 }
[regions.tip]
cap = { direction = [0, 0, 1], angle = 0.4 }
[[constraints]]
kind = "constrained"
region = "left.base"
displacement = [0, 0, 0]
[[constraints]]
name = "finger"
kind = "contact"
region = "tip"
pressure = 200
"""

TIPS = (
    SMALL.replace("pressure = 200", "force = 8")
    + """\
[load]
factors = [0.25, 0.5, 1]
[[measured]]
path = "tips.csv"
"""
)

POINTS = """\
# who, when
point, x [mm], y, z [m], displacement_z [mm], displacement_x, uncertainty [um], load_factor, COMSOL.displacement_z
top, 0, 0, 1, -2, , 100, 1, -0.0021
side, 1000, 0, 0, 0.5, 0.001, 200, 0.5,
"""
CURVE = "depth [mm], force [mN], uncertainty [mN]\n50, 3000, 100\n100, 9000, 200\n"


def load(directory: Path, text: str) -> Study:
    path = directory / "study.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(path)


def problems(directory: Path, text: str) -> list[tuple[int, str, str]]:
    with pytest.raises(StudyError) as caught:
        load(directory, text)
    return [(problem.line, problem.key, problem.message) for problem in caught.value.problems]


def swept(directory: Path, sweep: str, base: str = SWEPT) -> list[ResolvedCase]:
    return expand(load(directory, f"{base}[sweep]\n{sweep}"))


def sweep_problems(directory: Path, sweep: str, base: str = SWEPT) -> list[tuple[str, str]]:
    with pytest.raises(StudyError) as caught:
        swept(directory, sweep, base)
    first = base.count("\n") + 2  # the line after [sweep]
    return [(f"{p.line - first}: {p.key}", p.message) for p in caught.value.problems]
