"""How a study is found by its name, and where the cache is kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command import write_study
from vdmbench.cli.arguments import parse
from vdmbench.cli.studies import make_plan
from vdmbench.study.config import load_study
from vdmbench.study.errors import InputError
from vdmbench.study.files import shipped_studies, study_path


def test_a_name_that_is_nearly_right_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_study(tmp_path)
    assert study_path("quickstart") == shipped_studies()["quickstart"]
    assert study_path("small.toml") == Path("small.toml")
    for wrong, told in [
        ("quikstart", 'did you mean "quickstart"'),
        ("smal.toml", 'did you mean "small.toml"'),
        ("small", 'did you mean "small.toml"'),
        ("zzz", "known: small.toml, accuracy-box, "),
        ("../cases/quickstart", 'did you mean "quickstart"'),
    ]:
        with pytest.raises(InputError, match=told):
            study_path(wrong)


def test_the_cache_is_where_it_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = str(write_study(tmp_path))
    study = load_study(Path(path))
    monkeypatch.delenv("VDMBENCH_RESULTS", raising=False)
    monkeypatch.delenv("VDMBENCH_CACHE", raising=False)
    assert make_plan(study, parse(["plan", path])).cache == Path("results/cache")
    monkeypatch.setenv("VDMBENCH_RESULTS", "elsewhere")
    assert make_plan(study, parse(["plan", path])).cache == Path("elsewhere/cache")
    monkeypatch.setenv("VDMBENCH_CACHE", "shared")
    assert make_plan(study, parse(["plan", path])).cache == Path("shared")
    assert make_plan(study, parse(["plan", path, "--cache", "mine"])).cache == Path("mine")
