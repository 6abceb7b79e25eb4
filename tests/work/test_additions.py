"""What an addition costs: one file each, in a copy of the package, and no edit of another.

All are made in one copy, and `additions` looks at what they do in one process of their own.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
# the manual's own example: what it shows is what runs
OWN_ENGINE = (ROOT / "docs" / "howto" / "own-engine.md").read_text()
SPRINGS, ENTRY = (
    re.findall(rf"```{kind}\n(.*?)```", OWN_ENGINE, flags=re.DOTALL)[0] for kind in ("python", "toml")
)
METRIC = """
import numpy as np
from .metrics import metric


@metric("m", "largest displacement of the model, twice", degree=1, needs_reference=False, sense="descriptive")
def twice_the_largest(surface, model):
    return 2.0 * np.linalg.norm(model.displacement, axis=2).max(axis=1)
"""

SECTION = """
from .blocks import Section, Text


def colophon(digest):
    return Section("colophon", "A new section", [Text(f"cases: {len(digest.cases)}")])


SECTIONS = (colophon,)
"""

PROFILE = """
from .loads import profile


@profile
def parabola(rho):
    return (1.0 - rho**2) * (rho < 1.0)
"""

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

LOAD = """
from typing import Annotated, Literal
from pydantic import Field
from solver_common.quadrature import facet_quadrature
from .kinds import SI
from .loads import Acts, Constraint


class Hydrostatic(Constraint):
    '''under a liquid'''

    kind: Literal["hydrostatic"]
    loads = ("gradient",)
    gradient: Annotated[float, SI("Pa/m")] = Field(description="growth of the pressure with depth")

    def act(self, on):
        height = on.points[:, 2]
        depth = (height[on.nodes].max() - height)[on.triangles] @ facet_quadrature()[0].T
        return Acts(pressure=self.gradient * depth * on.pressure("uniform"))
"""
ADDED = {
    "measures/metric_twice.py": METRIC,
    "report/section_colophon.py": SECTION,
    "study/profile_parabola.py": PROFILE,
    "study/shape_ring.py": SHAPE,
    "study/load_hydrostatic.py": LOAD,
}


def test_each_is_one_file(tmp_path: Path) -> None:
    place = tmp_path / "vdmbench"
    shutil.copytree(ROOT / "studies", place)  # with its bytecode
    for name, text in ADDED.items():
        assert not (place / name).exists()
        (place / name).write_text(text)
    # a package beside it, which brings a model by the entry point
    (tmp_path / "springs_model.py").write_text(SPRINGS)
    about = tmp_path / "springs_model-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: springs-model\nVersion: 1.0\n")
    ((group, names),) = tomllib.loads(ENTRY)["project"]["entry-points"].items()
    lines = [f"{name} = {module}" for name, module in names.items()]
    (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))

    options = ("-q", "--noconftest", "-p", "no:cacheprovider", "--basetemp", str(tmp_path / "runs"))
    looked = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "-m", "not slow", ROOT / "tests/work/additions.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert looked.returncode == 0, looked.stdout + looked.stderr
    assert "6 passed" in looked.stdout
