"""What no run could make right is told before there is one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command import vdmbench
from vdmbench.evidence.calibrate import check, check_fit
from vdmbench.evidence.search import CalibrationError
from vdmbench.study.config import expand, load_study
from vdmbench.work.plan import make_plan

from .test_calibrate import STUDY


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.toml"], "needs study.reference"),
        (["one.toml"], "3 of 1 would train; sweep more loads"),
        (["set.toml"], "vdm-vector has no parameter left to fit: the study sets all of them"),
        (["own.toml"], "vdm-vector has no parameter left to fit: the study sets all of them"),
        (["swept.toml"], "vdm-vector has no parameter left to fit: the study sets all of them"),
        (["fit.toml", "--transfer", "nothing"], "no shipped study of that name"),
        (["fit.toml", "--transfer", "none.toml"], "needs study.reference"),
        (["fit.toml", "--transfer", "one.toml"], "3 of 1 would train; sweep more loads"),
    ],
)
def test_mistakes_of_the_command_are_told_before_anything_is_run(
    tmp_path: Path, words: list[str], said: str
) -> None:
    (tmp_path / "fit.toml").write_text(STUDY)
    (tmp_path / "none.toml").write_text(STUDY.replace('reference = "fem-linear"', ""))
    (tmp_path / "one.toml").write_text(STUDY.partition("[sweep]")[0])
    (tmp_path / "set.toml").write_text(STUDY + "[vdm]\nsurface_tension = 20.0\n")
    (tmp_path / "own.toml").write_text(STUDY + '[models."vdm-vector"]\nsurface_tension = 20.0\n')
    (tmp_path / "swept.toml").write_text(STUDY + '"vdm.surface_tension" = [10.0, 20.0]\n')
    result = vdmbench("calibrate", *words, cwd=tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert said in line
    assert not (tmp_path / "results").exists()


def test_a_study_that_sets_all_parameters_still_tries_the_fits_of_others(tmp_path: Path) -> None:
    (tmp_path / "set.toml").write_text(STUDY + "[vdm]\nsurface_tension = 20.0\n")
    study = load_study(tmp_path / "set.toml")
    plan = make_plan(study, expand(study), tmp_path / "run", tmp_path / "cache")
    check(plan)
    with pytest.raises(CalibrationError, match="sets all of them"):
        check_fit(plan)
