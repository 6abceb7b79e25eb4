"""Every mistake in a study file is told with its line, its key and a sentence that helps."""

from __future__ import annotations

from pathlib import Path

import pytest

from vdmbench.models import model_names
from vdmbench.study.config import geometry_error, load_study
from vdmbench.study.errors import MeshError

from .study_texts import SMALL, problems


@pytest.mark.parametrize(
    "more", ['[sweep]\n"constraints.tip.presure" = [1]\n', '[limits]\nalong = "constraints.tip.presure"\n']
)
def test_constraints_as_a_table_are_told_whatever_else_is_wrong(tmp_path: Path, more: str) -> None:
    text = SMALL.split("[[constraints]]")[0] + '[constraints]\nkind = "fixed"\nregion = "base"\n' + more
    assert ("constraints", "must be a list, not a table") in {
        (key, what[:27]) for _, key, what in problems(tmp_path, text)
    }


def test_every_faulty_key_at_once_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = """\
[study]
name = "../x"
models = ["vdm-paper"]
[geometry]
shape = "sphere"
radius = "50"
semi_axes = [1, 2]
mesh_sise = 1
[tissue]
youngs_modulus = true
poisson_ratio = 0.51
density = "5 m"
[regions.a]
below = { axis = "w", fraction = 0.1 }
[[constraints]]
name = "d"
kind = "fixed"
region = "a"
profil = "hertz"
[sweep]
"tissue.poison_ratio" = [0.3]
"""
    found = problems(tmp_path, text)
    assert [(line, key) for line, key, _ in found] == [
        (2, "study.name"),
        (6, "geometry.radius"),
        (7, "geometry.semi_axes"),
        (8, "geometry.mesh_sise"),
        (10, "tissue.youngs_modulus"),
        (11, "tissue.poisson_ratio"),
        (12, "tissue.density"),
        (14, "regions.a.below.axis"),
        (19, "constraints.d.profil"),
        (21, 'sweep."tissue.poison_ratio"'),
    ]
    messages = "\n".join(message for _, _, message in found)
    for hint in ("mesh_size", "profile", "tissue.poisson_ratio"):
        assert f'did you mean "{hint}"?' in messages


def test_all_that_keys_say_wrongly_together_at_once(tmp_path: Path) -> None:
    text = """\
[study]
name = "x"
models = ["vdm-papr", "fem-linear", "fem-linear"]
reference = "fem"
[geometry]
shape = "sphere"
radius = 0.05
semi_axes = [0.1, 0.2, 0.1]
mesh_size = 0.01
[tissue]
youngs_modulus = 1e3
poisson_ratio = 0.4
[regions.b]
all = [ "b2",
  "c" ]
[regions.b2]
below = { axis = "z" }
[[constraints]]
kind = "contact"
region = "d"
pressure = "1 Pa"
force = "1 N"
[[constraints]]
name = "d"
kind = "fixed"
region = "b"
"""
    found = problems(tmp_path, text)
    assert [(line, key) for line, key, _ in found] == [
        (3, "study.models[0]"),
        (3, "study.models[2]"),
        (4, "study.reference"),
        (8, "geometry.semi_axes"),
        (15, "regions.b.all[1]"),
        (17, "regions.b2.below"),
        (18, "constraints.d"),
        (20, "constraints.d.region"),
        (24, "constraints.d.name"),
    ]
    assert any('did you mean "vdm-paper"?' in message for _, _, message in found)


def line_of(text: str, start: str) -> int:
    return next(n for n, line in enumerate(text.split("\n"), start=1) if line.startswith(start))


CASES = {
    # change of SMALL: (old, new), line start that is blamed, key, part of the message
    "unknown key": ("= 5e3", "= 5e3\ndensty = 1000", "densty", "tissue.densty", 'did you mean "density"?'),
    "unknown table": ("[tissue]", "[tisue]\n[tissue]", "[tisue]", "tisue", 'did you mean "tissue"?'),
    "unknown choice": ('"sphere"', '"spere"', "shape", "geometry.shape", 'did you mean "sphere"?'),
    "choice of a wrong type": ('"sphere"', "3", "shape", "geometry.shape", "must be one of sphere, "),
    "missing key": ('name = "small"', "", "[study]", "study.name", "is missing: names the run directory"),
    "missing for the shape": ("radius = 0.05", "", "[geometry]", "geometry.radius", "a sphere needs"),
    "missing tetrahedra": (
        '"sphere"\nradius = 0.05\nmesh_size = 0.006',
        '"file"\npath = "none.vtu"',
        "path",
        "geometry.path",
        "does not exist",
    ),
    "unused by the shape": (
        "radius = 0.05",
        "radius = 0.05\nlength = 1",
        "length",
        "geometry.length",
        "has no length",
    ),
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
    "text for true or false": (
        "[geometry]",
        'condition = "yes"\n[geometry]',
        "condition",
        "study.condition",
        "must be true or false, not a text",
    ),
    "slivers of a good mesh": (
        "= 0.006",
        "= 0.006\nslivers = 1.2",
        "slivers",
        "geometry.slivers",
        "must be at least 2",
    ),
    "perturbation too large": (
        "= 0.006",
        "= 0.006\nperturbation = 0.6",
        "perturbation",
        "geometry.perturbation",
        "must be at most 0.5",
    ),
    "seed alone": ("= 0.006", "= 0.006\nseed = 3", "seed = 3", "geometry.seed", "decides nothing without"),
    "seed as text": (
        "= 0.006",
        '= 0.006\nperturbation = 0.1\nseed = "a"',
        'seed = "a"',
        "geometry.seed",
        "must be a whole number",
    ),
    "coarse mesh": ("= 0.006", "= 0.06", "mesh_size", "geometry.mesh_size", "too large for a body"),
    "angle in degrees": ("angle = 0.4", "angle = 25", "cap", "regions.tip.cap.angle", 'write "25 deg"'),
    "zero direction": ("[0, 0, 1]", "[0, 0, 0]", "cap", "regions.tip.cap.direction", "zero vector"),
    "vector of two": (
        "[0, 0, 1]",
        "[0, 1]",
        "cap",
        "regions.tip.cap.direction",
        "must have 3 numbers, not 2",
    ),
    "item of a vector": ("[0, 0, 1]", "[0, '1 m', 1]", "cap", "regions.tip.cap.direction", "item 2: "),
    "fraction": ("= 0.15", "= 1.5", "below", "regions.base.below.fraction", "between 0 and 1"),
    "half-space twice": (
        "= 0.15",
        "= 0.15, value = 1",
        "below",
        "regions.base.below",
        "either fraction or value",
    ),
    "pressure in kPa": (
        "pressure = 200",
        "pressure = 2e5",
        "pressure",
        "constraints.tip.pressure",
        "mixed-up unit",
    ),
    "force": ("pressure = 200", "force = 2e5", "force", "constraints.tip.force", "mixed-up unit"),
    "load factor": (
        "[tissue]",
        "[load]\nfactors = [1, -1e99]\n[tissue]",
        "pressure = 200",
        "constraints.tip.pressure",
        "mixed-up unit",
    ),
    "gravity": (
        "[tissue]",
        "[gravity]\nacceleration = [0, 0, -9.81e4]\n[tissue]",
        "acceleration",
        "gravity.acceleration",
        "mixed-up unit",
    ),
    "group of no file": (
        "[tissue]",
        "[regions.x]\nany = ['tip', { group = 'left' }]\n[tissue]",
        "any",
        "regions.x.any[1].group",
        "only a MSH file has named groups",
    ),
    "region twice": (
        "[regions.tip]",
        "[regions.tip]\nbox = { min = [0, 0, 0], max = [1, 1, 1] }",
        "[regions.tip]",
        "regions.tip",
        "exactly one of",
    ),
    "region empty": (
        "[regions.tip]",
        "[regions.x]\n[regions.tip]",
        "[regions.x]",
        "regions.x",
        "exactly one of",
    ),
    "empty list of regions": (
        "[tissue]",
        "[regions.x]\nany = []\n[tissue]",
        "any",
        "regions.x.any",
        "at least 1 item",
    ),
    "unsafe region": (
        "[tissue]",
        "[regions.'<b>']\nbelow = { axis = 'z', fraction = 0.1 }\n[tissue]",
        "[regions.'<",
        'regions."<b>"',
        "not a usable",
    ),
    "unknown region": (
        'region = "tip"',
        'region = "tp"',
        'region = "tp"',
        "constraints.tp.region",
        'mean "tip"?',
    ),
    "contact without region": (
        'region = "tip"\n',
        "",
        '[[constraints]]\nkind = "contact"',
        "constraints[1].region",
        "is missing",
    ),
    "contact without load": (
        "pressure = 200",
        "",
        '[[constraints]]\nkind = "contact"',
        "constraints.tip",
        "either pressure or force",
    ),
    "contact with two loads": (
        "pressure = 200",
        'pressure = 200\nforce = "1 N"',
        '[[constraints]]\nkind = "contact"',
        "constraints.tip",
        "has both pressure and force; keep one",
    ),
    "load on fixed": ('"contact"', '"fixed"', "pressure", "constraints.tip.pressure", "has no pressure"),
    "unknown kind": (
        '"contact"',
        '"kontact"',
        'kind = "k',
        "constraints.tip.kind",
        'did you mean "contact"?',
    ),
    "kind free": ('"contact"', '"free"', 'kind = "free', "constraints.tip.kind", "unknown choice"),
    "constrained without": (
        'kind = "fixed"',
        'kind = "constrained"',
        "[[constraints]]",
        "constraints.base.displacement",
        "is missing",
    ),
    "profile of a half-space": (
        'region = "tip"',
        'region = "base"\nname = "t"\nprofile = "hertz"',
        "profile",
        "constraints.t.profile",
        "needs a region that is a cap or a ball",
    ),
    "two of one name": (
        'region = "tip"',
        'region = "tip"\nname = "base"',
        'name = "base"',
        "constraints.base.name",
        "another constraint",
    ),
    "no models": ('["vdm-paper"]', "[]", "models", "study.models", "at least one model"),
    "unknown model": (
        '["vdm-paper"]',
        '["vdm-pape"]',
        "models",
        "study.models[0]",
        'did you mean "vdm-paper"?',
    ),
    "former model": (
        '["vdm-paper"]',
        '["vdm-boundary:nonlinear"]',
        "models",
        "study.models[0]",
        "is now bem:nonlinear",
    ),
    "unknown solver": ('["vdm-paper"]', '["vdm-paper:minres"]', "models", "study.models[0]", "unknown model"),
    "reference left out": (
        "[geometry]",
        'reference = "fem"\n[geometry]',
        "reference",
        "study.reference",
        "not among the models",
    ),
    "penalty for solvers that have none": (
        '["vdm-paper"]\n',
        '["vdm-paper:lu", "vdm-paper", "vdm-paper:nonlinear", "vdm-vector:bicg"]\n[vdm]\npenalty = 1e8\n',
        "penalty",
        "vdm.penalty",
        "is solved by lu alone, not by vdm-paper:nonlinear and vdm-vector:bicg; give it in "
        "[models.vdm-paper] or leave it out",
    ),
    "penalty of a solver that has none": (
        '["vdm-paper"]\n',
        '["vdm-paper:nonlinear"]\n[models."vdm-paper:nonlinear"]\npenalty = 1e8\n',
        "penalty",
        'models."vdm-paper:nonlinear".penalty',
        "is solved by lu alone",
    ),
    "parameter that a model does not read": (
        "[tissue]",
        '[models."vdm-paper"]\nshear_modulus = 1e3\nbulk_modulus = 1\n[tissue]',
        "shear",
        "models.vdm-paper.shear_modulus",
        "vdm-paper does not read it; leave it out. Read here: bulk_modulus, connectivity_modulus, penalty",
    ),
    "parameter that no model reads": (
        '["vdm-paper"]\n',
        '["vdm-paper", "fem"]\n[vdm]\nrotation = "none"\n',
        "rotation",
        "vdm.rotation",
        "no model of this study reads it; leave it out. Read here: bulk_modulus, connectivity_modulus, penalty",
    ),
    "fit of what no model reads": (
        '["vdm-paper"]\n',
        '["vdm-paper"]\n[calibration]\nparameters = [\n"bulk_modulus",\n"surface_tension"]\n',
        '"surface_tension"',
        "calibration.parameters[1]",
        "no VDM model of this study reads surface_tension; leave it out",
    ),
    "a rotation that is gone": (
        '["vdm-paper"]\n',
        '["vdm-vector"]\n[vdm]\nrotation = "nodal"\n',
        "rotation",
        "vdm.rotation",
        'is gone, as its answer grows without limit on finer meshes; write rotation = "global"',
    ),
    "fit of nothing in a model": (
        '["vdm-paper"]\n',
        '["vdm-paper", "vdm-vector"]\n[calibration]\nparameters = ["surface_tension"]\n',
        "parameters",
        "calibration.parameters",
        "vdm-paper reads none of them; add one that it reads, or leave parameters out to fit all",
    ),
    "fit of one parameter twice": (
        "[tissue]",
        '[calibration]\nparameters = ["bulk_modulus",\n"bulk_modulus"]\n[tissue]',
        '"bulk_modulus"]',
        "calibration.parameters[1]",
        "bulk_modulus is listed twice",
    ),
    "fit of no parameter": (
        "[tissue]",
        "[calibration]\nparameters = []\n[tissue]",
        "parameters",
        "calibration.parameters",
        "must have at least",
    ),
    "parameter of elements": (
        '["vdm-paper"]\n',
        '["vdm-paper", "fem"]\n[models.fem]\nbulk_modulus = 1\n',
        "bulk",
        "models.fem.bulk_modulus",
        "fem does not read it; leave it out. Read here: none",
    ),
    "sweep of what no model reads": (
        "[tissue]",
        "[sweep]\n'vdm.foundation' = [1, 2]\n[tissue]",
        "'vdm.f",
        'sweep."vdm.foundation"',
        "no model of this study reads it",
    ),
    "override of another": (
        "[tissue]",
        "[models.fem]\npenalty = 1\n[tissue]",
        "[models.fem]",
        "models.fem",
        "model of this study",
    ),
    "negative modulus": (
        "[tissue]",
        "[vdm]\nbulk_modulus = -1\n[tissue]",
        "bulk",
        "vdm.bulk_modulus",
        "positive or zero",
    ),
    "no load factors": (
        "[tissue]",
        "[load]\nfactors = []\n[tissue]",
        "factors",
        "load.factors",
        "at least one number",
    ),
    "infinite factor": (
        "[tissue]",
        "[load]\nfactors = [1, inf]\n[tissue]",
        "factors",
        "load.factors",
        "item 2: must be a finite",
    ),
    "levels": (
        "[tissue]",
        "[uncertainty]\nlevels = 5\n[tissue]",
        "levels",
        "uncertainty.levels",
        "less than or equal to 4",
    ),
    "levels as bool": (
        "[tissue]",
        "[uncertainty]\nlevels = true\n[tissue]",
        "levels",
        "uncertainty.levels",
        "a whole number, not true",
    ),
    "levels as float": (
        "[tissue]",
        "[uncertainty]\nlevels = 3.5\n[tissue]",
        "levels",
        "uncertainty.levels",
        "a whole number, not a number",
    ),
    "claim of another paper": (
        'name = "small"',
        'name = "small"\nclaims = [2, 10]',
        "claims",
        "study.claims",
        "must be 1 to 9, not 10",
    ),
    "no step": (
        "[tissue]",
        "[load]\nsteps = 0\n[tissue]",
        "steps",
        "load.steps",
        "greater than or equal to 1",
    ),
    "limits along nothing": (
        "[tissue]",
        "[limits]\nalong = 'constraints.tip.presure'\n[tissue]",
        "along",
        "limits.along",
        'mean "constraints.tip.pressure"?',
    ),
    "limits along a load of another kind of constraint": (
        "[tissue]",
        "[limits]\nalong = 'constraints.baze.pressure'\n[tissue]",
        "along",
        "limits.along",
        'mean "constraints.tip.pressure"?',
    ),
    "limits along what is no load": (
        "[tissue]",
        "[limits]\nalong = 'tissue.youngs_modulus'\n[tissue]",
        "along",
        "limits.along",
        "unknown load",
    ),
    "limits without a finite-strain reference": (
        "[tissue]",
        "[limits]\nalong = 'constraints.tip.pressure'\n[tissue]",
        "[limits]",
        "limits",
        'need study.reference = "fem"',
    ),
    "date": ("radius = 0.05", "radius = 2020-01-02", "radius", "geometry.radius", "not a date or time"),
    "title of two lines": (
        'name = "small"',
        'name = "small"\ntitle = "a\\nb"',
        "title",
        "study.title",
        "one line",
    ),
}


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
    chain = "".join(f"[regions.r{n}]\nall = ['r{n + 1}', {{ not = 'r{n + 1}' }}]\n" for n in range(20))
    cycle = "[regions.p]\nnot = { any = ['q'] }\n[regions.q]\nall = ['p']\n[regions.into]\nnot = 'p'\n"
    found = problems(
        tmp_path, SMALL + chain + "[regions.r20]\nbelow = { axis = 'z', fraction = 0.1 }\n" + cycle
    )
    by_key = {key: message for _, key, message in found}
    assert {key for key, message in by_key.items() if "refers to itself" in message} == {
        "regions.p",
        "regions.q",
    }
    # r20 takes 1 step, r(n) takes 2 + 2 r(n+1): 1 + 3 (2^k - 1) steps, past 1,000 from k = 9 on
    too_large = {key for key, message in by_key.items() if "is made of more than" in message}
    assert {f"regions.r{n}" for n in range(12)} | {"regions.into"} == too_large


@pytest.mark.parametrize(
    ("body", "key", "message"),
    [
        ('"cylinder"\nlength = "50 m"\nradius = "50 mm"', "length", "a mixed-up unit"),
        ('"cylinder"\nlength = "50 mm"\nradius = "50 m"', "radius", "a mixed-up unit"),
        ('"cylinder"\nlength = 0.05\nradius = 0.05\naxis = "w"', "axis", "unknown choice"),
        ('"box"\nsize = 0.1', "size", "a box takes 3 lengths"),
        ('"organ"\nsize = [0.1, 0.1, 0.1]', "size", "an organ takes one length"),
        ('"file"\npath = "a.geo"', "path", "scripts and are not run"),
        ('"file"\npath = "a.step"', "path", "unknown kind of file"),
        ('"file"\npath = "a.stl"\nsize = 0.1\nscale = 1', "scale", "size or scale, not both"),
    ],
)
def test_a_body_that_cannot_be_is_told_at_the_key_that_makes_it_so(
    tmp_path: Path, body: str, key: str, message: str
) -> None:
    for name in ("a.geo", "a.step", "a.stl"):
        (tmp_path / name).touch()
    [(_, found, told)] = problems(tmp_path, SMALL.replace('"sphere"\nradius = 0.05', body))
    assert found == f"geometry.{key}"
    assert message in told


def test_what_only_the_mesher_finds_is_told_of_a_solid_at_its_shape(tmp_path: Path) -> None:
    """A solid has no path."""
    path = tmp_path / "study.toml"
    path.write_text(SMALL)
    [problem] = geometry_error(load_study(path), MeshError("gmsh cannot mesh this geometry")).problems
    assert problem.key == "geometry.shape"
    assert 'shape = "sphere"' in SMALL.splitlines()[problem.line - 1]


def test_models_are_those_of_the_registry(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    for name in model_names():
        path.write_text(SMALL.replace("vdm-paper", name))
        assert load_study(path).study.models == (name,)
