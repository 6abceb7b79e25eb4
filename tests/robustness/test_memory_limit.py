"""A case that asks for more memory than a worker may take: it fails with a remedy, the others do not notice."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.command import vdmbench, write_study

from . import processes
from .processes import RUN


def test_a_case_that_takes_too_much_costs_itself_only(tmp_path: Path) -> None:
    # at 4 mm the reference takes some 400 MB, at 20 mm the libraries of meshing take the most, some 100 MB
    write_study(tmp_path, a=("[load]", '[sweep]\n"geometry.mesh_size" = ["20 mm", "4 mm"]\n[load]'))
    arguments = ("run", "small.toml", "--jobs", "1", "--memory", "200MB")
    with processes.start(*arguments, cwd=tmp_path) as process:
        output = processes.output_of(process)
    assert process.returncode == 3, output
    assert "1 done, 1 failed, 0 missing" in output
    remedy = "out of memory; use a coarser mesh, fewer --jobs, or allow more with --memory"
    assert f"failed: mesh_size = 0.004 m: {remedy}\n" in output
    assert "Traceback" not in output
    (failure,) = (tmp_path / RUN / "failed").glob("*.json")
    assert json.loads(failure.read_text())["message"] == "out of memory"


@pytest.mark.parametrize("size", ["0GB", "lots", "-1GB", "4", "infGB", "4 gb"])
def test_a_size_that_is_none(tmp_path: Path, size: str) -> None:
    write_study(tmp_path)
    result = vdmbench("run", "small.toml", f"--memory={size}", cwd=tmp_path)
    assert result.returncode == 2
    assert "write a size such as 500MB or 4GB" in result.stderr
