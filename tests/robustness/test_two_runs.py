"""Runs at the same time, as processes: on one directory, and on one cache."""

import shutil
from pathlib import Path

import pandas as pd

from tests.command import vdmbench
from vdmbench.store.run_directory import METRICS_FILE

from . import processes
from .processes import CACHE, RUN, assert_same_results, check_what_is_there, half_written


def _together(*runs: list[str], cwd: Path) -> list[tuple[int, str]]:
    """Run them side by side; exit codes and outputs."""
    started = [processes.start("run", "small.toml", "--jobs", "1", *extra, cwd=cwd) for extra in runs]
    found = []
    for process in started:
        output = processes.output_of(process)
        assert "Traceback" not in output
        found.append((process.returncode, output))
    return found


def test_shards_of_one_directory_and_another_run_on_one_cache(
    undisturbed: tuple[Path, float], tmp_path: Path
) -> None:
    """All mesh and solve the same at the same time; each takes what is whole, or makes its own."""
    shutil.copy(undisturbed[0] / "small.toml", tmp_path)
    shards, other = (["--shard", "1/2"], ["--shard", "2/2"]), ["--out", "other"]
    for code, output in _together(*shards, other, cwd=tmp_path):
        assert code == 0, output
    for place in (RUN, Path("other")):
        assert_same_results(tmp_path / place, undisturbed[0] / RUN)
    check_what_is_there(tmp_path)
    assert half_written(tmp_path) == []
    # the last shard to finish has seen all
    assert pd.read_csv(tmp_path / RUN / METRICS_FILE)["case"].nunique() == 6
    ours, theirs = (
        {path.relative_to(place) for path in (place / CACHE).rglob("*.npz")}
        for place in (tmp_path, undisturbed[0])
    )
    assert ours == theirs


def test_a_directory_of_another_study_is_left_alone(undisturbed: tuple[Path, float], tmp_path: Path) -> None:
    shutil.copytree(undisturbed[0] / RUN, tmp_path / "run")
    study = (undisturbed[0] / "small.toml").read_text()
    (tmp_path / "small.toml").write_text(study.replace('name = "small"', 'name = "other"'))
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("[!.]*") if path.is_file()}
    result = vdmbench("run", "small.toml", "--out", "run", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr == 'vdmbench: run: holds the study "small", not "other"; choose another --out\n'
    assert {path: path.read_bytes() for path in before} == before
