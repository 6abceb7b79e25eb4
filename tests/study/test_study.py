"""A study file becomes one typed study, and stays it as JSON."""

from __future__ import annotations

from pathlib import Path

import pytest

from vdmbench.study.config import Study, expand, load_study, resolved
from vdmbench.study.files import shipped_studies

from ..unit.study_texts import FULL, SMALL, load


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
    text = SMALL.replace('"sphere"\nradius = 0.05', '"file"\npath = "a.stl"\ncoordinates = "file"')
    _comes_back(
        load(tmp_path, text + '[sweep]\n"tissue.poisson_ratio" = { start = 0.3, stop = 0.4, num = 3 }\n')
    )
