"""What an addition costs: one file each, on a copy of the package, and no edit of another."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.command import SMALL_STUDY

ROOT = Path(__file__).parents[2]
# the manual's own example: what it shows is what runs
OWN_ENGINE = (ROOT / "docs" / "howto" / "own-engine.md").read_text()
SPRINGS, ENTRY = (
    re.findall(rf"```{kind}\n(.*?)```", OWN_ENGINE, flags=re.DOTALL)[0] for kind in ("python", "toml")
)
COMMAND = "from vdmbench.cli.main import main; main()"
STUDY = SMALL_STUDY.replace('"vdm-paper"', '"springs"')
GAINS = STUDY + '[sweep]\n"models.springs.gain" = [1.0, 2.0, 4.0]\n'


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with a copy of the package, named vdmbench, and nothing else of this repository."""
    caches = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "studies", tmp_path / "vdmbench", ignore=caches)
    for library in ("vdm", "fem_reference", "solver_common"):
        (tmp_path / library).symlink_to(ROOT / library)
    return tmp_path


@pytest.fixture
def springs(place: Path) -> Path:
    """The copy, and beside it a package that brings a model by the entry point."""
    (place / "springs_model.py").write_text(SPRINGS)
    about = place / "springs_model-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: springs-model\nVersion: 1.0\n")
    ((group, names),) = tomllib.loads(ENTRY)["project"]["entry-points"].items()
    lines = [f"{name} = {module}" for name, module in names.items()]
    (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
    return place


def python(place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Python in the folder, which finds the copy there."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(place), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )


def command(place: Path, *arguments: str) -> str:
    """What a verb of the copy prints; it succeeds."""
    result = python(place, "-c", COMMAND, *arguments)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def study(place: Path, text: str) -> str:
    (place / "study.toml").write_text(text)
    return "study.toml"


def run(place: Path, text: str) -> dict[str, Any]:
    """The JSON of a run of the study in one process; its page is `page`."""
    return json.loads(command(place, "run", study(place, text), "--jobs", "1", "--out", "out", "--json"))


CHECKS = """
import contextlib, sys
from vdmbench.cli.main import main

for name in sys.argv[1:]:
    with contextlib.suppress(SystemExit):
        main(["check", name])
"""


def assert_told(place: Path, mistakes: Sequence[tuple[str, str]]) -> None:
    """Of each study `check` says its words, with the study's name."""
    names = [f"mistake-{number}.toml" for number in range(len(mistakes))]
    for name, (text, _) in zip(names, mistakes, strict=True):
        (place / name).write_text(text)
    told = python(place, "-c", CHECKS, *names).stderr
    for name, (_, said) in zip(names, mistakes, strict=True):
        assert any(said in line and name in line for line in told.splitlines()), told


def page(place: Path) -> str:
    return (place / "out" / "report.html").read_text()


def test_a_model_of_another_package(springs: Path) -> None:
    assert "gain" in json.loads(command(springs, "list", "--models", "--json"))["springs"]
    command(springs, "check", study(springs, GAINS))
    planned = json.loads(command(springs, "plan", "study.toml", "--json"))
    assert len(planned["cases"]) == 3
    assert planned["refused"] == []
    run(springs, GAINS)
    assert_gains_differ(springs)
    assert "springs" in page(springs)
    assert "springs.gain" in page(springs)


def test_a_benchmark_without_a_study_measures_it_too(springs: Path) -> None:
    told = python(springs, "-c", "from vdmbench.models import benched_names; print(*benched_names())")
    names = told.stdout.split()
    assert names.count("springs") == names.count("vdm-paper:bicg") == 1, told.stderr


def assert_gains_differ(place: Path) -> None:
    """Three answers under three keys, each as stiff as its gain."""
    told = python(
        place,
        "-c",
        "from pathlib import Path\n"
        "from vdmbench.work.keys import wanted\n"
        "from vdmbench.store.cases import read_run\n"
        "from vdmbench.study.config import expand, load_study\n"
        "keys = [wanted(case.study, 'mesh')[0].body for case in expand(load_study(Path('study.toml')))]\n"
        "for key, case in zip(keys, read_run(Path('out')).cases, strict=True):\n"
        "    print(key, abs(case.models['springs'].displacement).max())",
    )
    rows = [line.split() for line in told.stdout.splitlines()]
    assert len({key for key, _ in rows}) == len(rows) == 3, told
    values = sorted(float(value) for _, value in rows)
    assert values == pytest.approx([values[2] / 4, values[2] / 2, values[2]])


def test_a_model_of_another_package_is_refused_fibres(springs: Path) -> None:
    fibres = "[anisotropy]\nfibre_direction = [1, 0, 0]\ncontrast = 2.0\n"
    told = command(springs, "plan", study(springs, STUDY + fibres))
    assert "springs: it is isotropic; use another model for fibres" in told


def test_mistakes_in_a_table_of_its_own(springs: Path) -> None:
    tables = (
        ('[models.springs]\ngain = "3 mm"\n', "models.springs.gain: "),
        ("[models.springs]\ngian = 3.0\n", 'did you mean "gain"'),
        ("[models.fem-linear]\ngain = 3.0\n", "fem-linear does not read it"),
        ("[vdm]\ngain = 3.0\n", "vdm.gain"),
    )
    assert_told(springs, [(STUDY + table, said) for table, said in tables])


@pytest.mark.slow
def test_a_model_of_another_package_is_benchmarked(springs: Path) -> None:
    told = json.loads(command(springs, "bench", study(springs, STUDY), "--out", "bench", "--json"))
    assert "springs" in {row["model"] for row in told["rows"]}


BENCH = """
from pathlib import Path
from vdmbench import bench
from vdmbench.study.config import load_study

study = load_study(Path("study.toml"))
found = bench.measure({"it": study}, Path("cache"), sizes=(1.0,), rounds=1, watch=lambda _: None)
for e in found.entries:
    print(e.model, e.status, e.error, float(e.frame_all[0] * e.frame_local[0]))
"""


def error_in_benchmark(place: Path, text: str) -> float:
    """Relative error of the study's only model beside the refined reference, as `vdmbench bench` has it."""
    study(place, text)
    told = python(place, "-c", BENCH)
    assert told.returncode == 0, told.stderr
    ((_, status, error, times),) = (line.split() for line in told.stdout.splitlines())
    assert status == "converged"
    assert float(times) > 0.0
    return float(error)


METRIC = """
import numpy as np
from .metrics import metric


@metric("m", "largest displacement of the model, twice", degree=1, needs_reference=False, sense="descriptive")
def twice_the_largest(surface, model):
    return 2.0 * np.linalg.norm(model.displacement, axis=2).max(axis=1)
"""
VDM = SMALL_STUDY.replace('["vdm-paper", "fem-linear"]', '["vdm-paper"]').replace(
    'reference = "fem-linear"\n', ""
)


def test_a_metric(place: Path) -> None:
    (place / "vdmbench" / "measures" / "metric_twice.py").write_text(METRIC)
    run(place, SMALL_STUDY)
    assert "twice_the_largest" in (place / "out" / "metrics.csv").read_text()
    assert "Twice the largest" in page(place)


SECTION = """
from .blocks import Section, Text


def colophon(digest):
    return Section("colophon", "A new section", [Text(f"cases: {len(digest.cases)}")])


SECTIONS = (colophon,)
"""


def test_a_report_section(place: Path) -> None:
    (place / "vdmbench" / "report" / "section_colophon.py").write_text(SECTION)
    run(place, VDM)
    text = page(place)
    assert "A new section" in text
    assert "cases: 1" in text
    assert text.index("A new section") < text.index("How to reproduce")


PROFILE = """
from .loads import profile


@profile
def parabola(rho):
    return (1.0 - rho**2) * (rho < 1.0)
"""


def test_a_load_profile(place: Path) -> None:
    (place / "vdmbench" / "study" / "profile_parabola.py").write_text(PROFILE)
    swept = VDM.replace("force = ", "pressure = ").replace("0.1 N", "100 Pa")
    swept += '[sweep]\n"constraints.finger.profile" = ["parabola", "gaussian", "hertz"]\n'
    command(place, "check", study(place, swept))
    assert len(json.loads(command(place, "plan", "study.toml", "--json"))["cases"]) == 3
    run(place, swept)
    told = python(
        place,
        "-c",
        "from pathlib import Path\n"
        "from vdmbench.store.cases import read_run\n"
        "for case in read_run(Path('out')).cases:\n"
        "    print(-case.models['vdm-paper'].reaction_force[-1].sum(axis=0)[2])",
    )
    parabola, gaussian, hertz = map(float, told.stdout.split())
    # resultants of a peak of 1 on a flat disc of area 1: 1/2, 2/9 (1 - exp(-9/2)), 2/3
    assert abs(parabola) == pytest.approx(0.75 * abs(hertz), rel=0.03)
    assert abs(gaussian) < abs(parabola) < abs(hertz)
    assert "parabola" in page(place)
    assert_told(place, [(swept.replace('"parabola"', '"parabole"'), "parabola")])


SHAPE = """
import math
from typing import Literal
from pydantic import Field
from .kinds import Length
from .shapes import Solid


class Ring(Solid):
    shape: Literal["ring"]
    radius: Length = Field(description="of its middle line")
    tube: Length = Field(description="of its tube")

    def extents(self):
        across = 2.0 * (self.radius + self.tube)
        return across, across, 2.0 * self.tube

    def area_and_volume(self):
        around = 2.0 * math.pi * self.radius
        return around * 2.0 * math.pi * self.tube, around * math.pi * self.tube**2

    def add(self, occ, unit):
        occ.addTorus(0, 0, 0, self.radius / unit, self.tube / unit)
"""
RING = VDM.replace('shape = "sphere"', 'shape = "ring"\ntube = "12 mm"').replace("16 mm", "9 mm")
RING = RING.replace("[0, 0, 1]", "[1, 0, 0]").replace('axis = "z"', 'axis = "x"')
TUBES = RING + '[sweep]\n"geometry.tube" = ["12 mm", "15 mm"]\n'


def test_a_shape(place: Path) -> None:
    (place / "vdmbench" / "study" / "shape_ring.py").write_text(SHAPE)
    command(place, "check", study(place, TUBES))
    planned = json.loads(command(place, "plan", "study.toml", "--json"))
    assert len({case["mesh"] for case in planned["cases"]}) == 2
    run(place, TUBES)
    told = python(
        place,
        "-c",
        "from pathlib import Path\n"
        "from vdmbench.store.cases import read_run\n"
        "from vdmbench.study.fields import field_table\n"
        "for case in read_run(Path('out')).cases:\n"
        "    print(case.swept['geometry.tube'], case.mesh_quality['volume'])\n"
        "print(next(row.help for row in field_table() if row.key == 'geometry.tube'))",
    )
    assert told.stderr == ""
    *rows, help_text = told.stdout.splitlines()
    assert help_text == "ring: of its tube"
    for row in rows:
        tube, volume = map(float, row.split())
        # facets cut the tube's circle: 9 mm of a circumference of 75 or 94 mm
        assert volume == pytest.approx(2.0 * np.pi**2 * 0.05 * tube**2, rel=0.1)
    assert "ring" in page(place)
    assert error_in_benchmark(place, RING.replace("vdm-paper", "fem-linear")) < 0.5
    mistakes = (
        ('tube = "12 mm"\n', "", "geometry.tube: is missing; a ring needs mesh_size, radius, tube"),
        ('"ring"', '"rings"', 'did you mean "ring"'),
    )
    assert_told(place, [(RING.replace(old, new), said) for old, new, said in mistakes])


LOAD = """
from typing import Annotated, Literal
from pydantic import Field
from .kinds import SI
from .loads import Acts, Constraint


class Hydrostatic(Constraint):
    '''under a liquid'''

    kind: Literal["hydrostatic"]
    loads = ("gradient",)
    gradient: Annotated[float, SI("Pa/m")] = Field(description="growth of the pressure with depth")

    def act(self, on):
        height = on.points[:, 2]
        return Acts(pressure=self.gradient * on.at_quadrature(height[on.nodes].max() - height))
"""
LIQUID = VDM.replace("vdm-paper", "fem-linear").replace('kind = "contact"', 'kind = "hydrostatic"')
LIQUID = LIQUID.replace('force = "0.1 N"', 'gradient = "9810 Pa/m"')
LIQUID = LIQUID.replace('profile = "hertz"\n', "").replace("factors = [0.5, 1.0]", "factors = [0.01]")
GRADIENTS = LIQUID + '[sweep]\n"constraints.finger.gradient" = ["9810 Pa/m", "19620 Pa/m"]\n'


def test_a_kind_of_load(place: Path) -> None:
    (place / "vdmbench" / "study" / "load_hydrostatic.py").write_text(LOAD)
    command(place, "check", study(place, GRADIENTS))
    planned = json.loads(command(place, "plan", "study.toml", "--json"))
    assert len(planned["cases"]) == 2
    assert [work["solves"] for work in planned["work"]] == [1], "one is twice the other"
    run(place, GRADIENTS)
    told = python(
        place,
        "-c",
        "from pathlib import Path\n"
        "import numpy as np\n"
        "from vdmbench.store.cases import read_run\n"
        "for case in read_run(Path('out')).cases:\n"
        "    print(-case.models['fem-linear'].reaction_force[-1].sum(axis=0)[2])\n"
        "    corners = case.points[case.triangles[case.regions['finger'][case.triangles].all(axis=1)]]\n"
        "    up = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]\n"
        "    depth = case.points[case.regions['finger'], 2].max() - corners[:, :, 2].mean(axis=1)\n"
        "    print(-0.01 * 9810.0 * up @ depth)\n",
    )
    once, weight, twice, _ = map(float, told.stdout.split())
    assert weight < 0.0
    assert once == pytest.approx(weight, rel=1e-9), "of the liquid above its facets"
    assert twice == pytest.approx(2.0 * once, rel=1e-9)
    assert "hydrostatic" in page(place).lower()
    assert error_in_benchmark(place, LIQUID) < 0.1, "under the same load as its reference"
    mistakes = (
        ('gradient = "9810 Pa/m"', "", "gradient: is missing"),
        ('"9810 Pa/m"', '"3 mm"', "constraints.finger.gradient"),
        (
            'gradient = "9810 Pa/m"',
            'force = "1 N"',
            "a hydrostatic constraint has no force; it takes gradient",
        ),
        ('"hydrostatic"', '"hydrostatics"', 'did you mean "hydrostatic"'),
    )
    assert_told(place, [(LIQUID.replace(old, new), said) for old, new, said in mistakes])
