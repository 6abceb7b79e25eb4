"""What additions do, in a process where the package is a copy that has them all: see `test_additions`."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.command import SMALL_STUDY, vdmbench
from vdmbench.measures.case import CaseResult
from vdmbench.models import model_names
from vdmbench.store.cases import read_run
from vdmbench.study.config import expand, load_study
from vdmbench.study.fields import study_schema
from vdmbench.work.keys import wanted

SPRINGS = SMALL_STUDY.replace('"vdm-paper"', '"springs"')
VDM = SMALL_STUDY.replace('["vdm-paper", "fem-linear"]', '["vdm-paper"]').replace(
    'reference = "fem-linear"\n', ""
)


@pytest.fixture(autouse=True)
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def command(*arguments: str) -> str:
    """What a verb prints; it succeeds."""
    result = vdmbench(*arguments, cwd=Path.cwd())
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def planned(text: str) -> dict[str, Any]:
    """The JSON of the plan of `study.toml`, which is sound and gets this text."""
    Path("study.toml").write_text(text)
    command("check", "study.toml")
    return json.loads(command("plan", "study.toml", "--json"))  # type: ignore[no-any-return]


def ran(text: str) -> tuple[list[CaseResult], str]:
    """The cases of its run, and its page."""
    Path("study.toml").write_text(text)
    command("run", "study.toml", "--out", "out", "--json")
    return list(read_run(Path("out")).cases), Path("out/report.html").read_text()


def assert_told(mistakes: dict[str, str]) -> None:
    """Of each study `check` says its words, with the study's name."""
    for text, said in mistakes.items():
        Path("mistake.toml").write_text(text)
        told = vdmbench("check", "mistake.toml", cwd=Path.cwd()).stderr
        assert any(said in line and "mistake.toml" in line for line in told.splitlines()), told


def test_a_model_of_another_package() -> None:
    assert "gain" in json.loads(command("list", "--models", "--json"))["springs"]
    assert model_names().count("springs") == 1
    gains = SPRINGS + '[sweep]\n"models.springs.gain" = [1.0, 2.0, 4.0]\n'
    plan = planned(gains)
    assert len(plan["cases"]) == 3
    assert plan["refused"] == []
    cases, page = ran(gains)
    # three answers under three keys, each as stiff as its gain
    assert (
        len({wanted(case.study, "mesh")[0].body for case in expand(load_study(Path("study.toml")))})
        == len(cases)
        == 3
    )
    largest = sorted(abs(case.models["springs"].displacement).max() for case in cases)
    assert largest == pytest.approx([largest[2] / 4, largest[2] / 2, largest[2]])
    assert "springs.gain" in page


def test_a_model_of_another_package_is_refused_fibres_and_has_a_table_of_its_own() -> None:
    fibres = "[anisotropy]\nfibre_direction = [1, 0, 0]\ncontrast = 2.0\n"
    assert planned(SPRINGS + fibres)["refused"]
    assert "springs is isotropic; use another model for fibres" in command("plan", "study.toml")
    assert_told(
        {
            SPRINGS + '[models.springs]\ngain = "3 mm"\n': "models.springs.gain: ",
            SPRINGS + "[models.springs]\ngian = 3.0\n": 'did you mean "gain"',
            SPRINGS + "[models.fem-linear]\ngain = 3.0\n": "fem-linear does not read it",
            SPRINGS + "[vdm]\ngain = 3.0\n": "vdm.gain",
        }
    )


@pytest.mark.slow
def test_a_model_of_another_package_is_benchmarked() -> None:
    planned(SPRINGS)
    told = json.loads(command("bench", "study.toml", "--out", "bench", "--json"))
    assert "springs" in {row["model"] for row in told["rows"]}


def test_a_metric_and_a_section_of_the_report() -> None:
    _, page = ran(SMALL_STUDY)
    assert "twice_the_largest" in Path("out/metrics.csv").read_text()
    assert "Twice the largest" in page
    assert "A new section" in page
    assert "cases: 1" in page
    assert page.index("A new section") < page.index("How to reproduce")


def test_a_load_profile() -> None:
    swept = VDM.replace("force = ", "pressure = ").replace("0.1 N", "100 Pa")
    swept += '[sweep]\n"constraints.finger.profile" = ["parabola", "gaussian", "hertz"]\n'
    assert len(planned(swept)["cases"]) == 3
    cases, page = ran(swept)
    parabola, gaussian, hertz = (
        -case.models["vdm-paper"].reaction_force[-1].sum(axis=0)[2] for case in cases
    )
    # resultants of a peak of 1 on a flat disc of area 1: 1/2, 2/9 (1 - exp(-9/2)), 2/3
    assert abs(parabola) == pytest.approx(0.75 * abs(hertz), rel=0.03)
    assert abs(gaussian) < abs(parabola) < abs(hertz)
    assert "parabola" in page
    assert_told({swept.replace('"parabola"', '"parabole"'): "parabola"})


def test_a_shape() -> None:
    ring = VDM.replace('shape = "sphere"', 'shape = "ring"\ntube = "12 mm"').replace("16 mm", "9 mm")
    ring = ring.replace("[0, 0, 1]", "[1, 0, 0]").replace('axis = "z"', 'axis = "x"')
    tubes = ring + '[sweep]\n"geometry.tube" = ["12 mm", "15 mm"]\n'
    assert len({case["mesh"] for case in planned(tubes)["cases"]}) == 2
    cases, page = ran(tubes)
    assert '"description": "of its tube"' in json.dumps(study_schema())
    for case in cases:
        # facets cut the tube's circle: 9 mm of a circumference of 75 or 94 mm
        volume = 2.0 * np.pi**2 * 0.05 * float(case.swept["geometry.tube"]) ** 2
        assert case.mesh_quality["volume"] == pytest.approx(volume, rel=0.1)
    assert "ring" in page
    assert_told(
        {
            ring.replace('tube = "12 mm"\n', ""): "geometry.tube: is missing: of its tube",
            ring.replace('"ring"', '"rings"'): 'did you mean "ring"',
        }
    )


def test_a_kind_of_load() -> None:
    liquid = VDM.replace("vdm-paper", "fem-linear").replace('kind = "contact"', 'kind = "hydrostatic"')
    gradient = 'gradient = "9810 Pa/m"'
    liquid = liquid.replace('force = "0.1 N"', gradient)
    liquid = liquid.replace('profile = "hertz"\n', "").replace("factors = [0.5, 1.0]", "factors = [0.01]")
    gradients = liquid + '[sweep]\n"constraints.finger.gradient" = ["9810 Pa/m", "19620 Pa/m"]\n'
    plan = planned(gradients)
    assert len(plan["cases"]) == 2
    assert [work["solves"] for work in plan["work"]] == [1], "one is twice the other"
    cases, page = ran(gradients)
    once, twice = (-case.models["fem-linear"].reaction_force[-1].sum(axis=0)[2] for case in cases)
    finger = cases[0].regions["finger"]
    corners = cases[0].points[cases[0].triangles[finger[cases[0].triangles].all(axis=1)]]
    up = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    depth = cases[0].points[finger, 2].max() - corners[:, :, 2].mean(axis=1)
    weight = -0.01 * 9810.0 * up @ depth
    assert weight < 0.0
    assert once == pytest.approx(weight, rel=1e-9), "of the liquid above its facets"
    assert twice == pytest.approx(2.0 * once, rel=1e-9)
    assert "hydrostatic" in page.lower()
    assert_told(
        {
            liquid.replace(gradient, ""): "gradient: is missing",
            liquid.replace('"9810 Pa/m"', '"3 mm"'): "constraints.finger.gradient",
            liquid.replace(gradient, 'force = "1 N"'): "known: kind, region, name, gradient",
            liquid.replace('"hydrostatic"', '"hydrostatics"'): 'did you mean "hydrostatic"',
        }
    )
