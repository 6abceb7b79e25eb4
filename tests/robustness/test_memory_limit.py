"""A case that asks for more memory than a worker may take: it fails with a remedy, the others do not notice."""

from __future__ import annotations

import json
import resource
import subprocess
from pathlib import Path

from tests.command import SCRIPT, write_study

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


def test_a_limit_of_the_shell_in_which_nothing_can_be_loaded_is_told(tmp_path: Path) -> None:
    """OpenBLAS would ask for its buffers again, for ever; what is allowed by the sentence is enough."""
    write_study(tmp_path)

    def under(kilobytes: int, kind: int) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [SCRIPT, "run", "small.toml", "--jobs", "1"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
            preexec_fn=lambda: resource.setrlimit(kind, (1024 * kilobytes, 1024 * kilobytes)),
        )

    for letter, kind in (("v", resource.RLIMIT_AS), ("d", resource.RLIMIT_DATA)):
        result = under(1_300_000, kind)
        assert result.returncode == 4
        told = f"too little memory for the solvers: ulimit -{letter} 1300000; allow 3 GB or more, or no limit"
        assert result.stderr.splitlines() == [f"vdmbench: {told}"]
    assert under(3_000_000, resource.RLIMIT_AS).returncode == 0
