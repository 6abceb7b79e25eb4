"""A shell with a limit of memory, in a folder of programs; what a worker may not take is a matter of the pool."""

import resource
import subprocess
from pathlib import Path

from tests.command import SCRIPT, write_study


def test_a_limit_of_the_shell_is_told_and_no_file_of_its_folder_is_executed(tmp_path: Path) -> None:
    """OpenBLAS would ask for its buffers again, for ever; what is allowed by the sentence is enough.

    Neither the command nor a process of its own imports from the folder that it is called in.
    """
    write_study(tmp_path)
    for name in ("numpy", "json", "signal", "multiprocessing", "skfem"):
        (tmp_path / f"{name}.py").write_text("open('executed', 'w'); raise SystemExit(9)")

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
    assert not (tmp_path / "executed").exists()
