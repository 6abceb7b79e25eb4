"""Every shipped study is sound and can be planned; the small ones run to the end."""

import json
from pathlib import Path

import pytest

from tests.command import vdmbench
from vdmbench.study.config import Study, load_study
from vdmbench.work.explain import summary
from vdmbench.work.plan import make_plan

SHIPPED = Path(__file__).parents[2] / "studies" / "cases"

NAMES = sorted(path.stem for path in SHIPPED.glob("*.toml"))


def shipped(name: str) -> Study:
    return load_study(SHIPPED / f"{name}.toml")


@pytest.mark.parametrize("name", NAMES)
def test_check_and_plan(name: str, tmp_path: Path) -> None:
    study = shipped(name)
    planned = summary(make_plan(study, tmp_path / "run", tmp_path / "cache"))
    assert len(planned["cases"]) == planned["cases_to_run"] >= 1, "no case repeats another"
    assert study.study.name == name
    assert study.study.title != name
    assert (SHIPPED / f"{name}.toml").read_text().startswith("# "), "a study says what it is for"


# about a minute each at most on two idle cores; of the others some take several
QUICK = (
    "anisotropy",
    "blood",
    "gravity",
    "large-strain",
    "liver-palpation",
    "stability",
    "thigh-probe",
    "tumour",
    "warm-start",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_study_runs_to_the_end(name: str, tmp_path: Path) -> None:
    done = vdmbench("run", name, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    report = tmp_path / "results" / "runs" / name / "report.html"
    assert shipped(name).study.title in report.read_text(encoding="utf-8")
    assert json.loads(done.stdout)["metrics"]
