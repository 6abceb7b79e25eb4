"""Limits of memory that a shell or a batch system sets: what does not fit says so, and no core spins."""

from __future__ import annotations

import os
import resource
import subprocess
from pathlib import Path

import pytest

from tests.command import SCRIPT, write_study
from vdmbench.machine import memory

TOO_LITTLE = "vdmbench: too little memory to load the solvers: ulimit -{} {}; allow 3 GB or more, or no limit"


def _limited(
    directory: Path, letter: str, megabytes: int, *arguments: str
) -> subprocess.CompletedProcess[str]:
    """A command under `ulimit -v` or `-d`; one that spins is killed, which fails the test."""
    kind = {"v": resource.RLIMIT_AS, "d": resource.RLIMIT_DATA}[letter]
    size = megabytes * 1024 * 1000
    return subprocess.run(
        [SCRIPT, *arguments],
        cwd=directory,
        env={name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(kind, (size, size)),
    )


@pytest.mark.parametrize(("letter", "megabytes"), [("v", 150), ("d", 150)])
def test_where_the_solvers_cannot_be_loaded_that_is_told(tmp_path: Path, letter: str, megabytes: int) -> None:
    write_study(tmp_path)
    for arguments in (["run", "small.toml", "--jobs", "1"], ["plan", "small.toml"]):
        result = _limited(tmp_path, letter, megabytes, *arguments)
        assert result.returncode == 4
        assert result.stderr.splitlines() == [TOO_LITTLE.format(letter, f"{megabytes}000")]
    assert _limited(tmp_path, letter, megabytes, "list").returncode == 0, "it loads none"


@pytest.mark.parametrize(("letter", "megabytes"), [("v", 1300), ("d", 250)])
def test_a_limit_that_is_hardly_met_ends_the_run(tmp_path: Path, letter: str, megabytes: int) -> None:
    """What fits depends on versions and processors: done, or told with what to do."""
    write_study(tmp_path)
    result = _limited(tmp_path, letter, megabytes, "run", "small.toml", "--jobs", "1")
    assert "Traceback" not in result.stderr
    if result.returncode == 4:
        assert result.stderr.splitlines()[-1] == TOO_LITTLE.format(letter, f"{megabytes}000")
    elif result.returncode == 3:
        assert "out of memory; use a coarser mesh, fewer --jobs, or allow more with --memory" in result.stderr
        assert f"ulimit -{letter} {megabytes}000" in result.stderr
    else:
        assert result.returncode == 0


def test_nothing_is_asked_for_that_the_system_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS would ask again, for ever; the room that is needed is looked for before."""
    monkeypatch.setattr(memory, "memory_limits", lambda: "ulimit -v 1")
    monkeypatch.setattr(memory, "_BUFFER", 1 << 50)
    with pytest.raises(memory.MemoryLimitError, match="ulimit -v 1; allow 3 GB or more"):
        memory.require_room()


def test_words_of_libraries_that_found_no_memory() -> None:
    assert memory.is_lack_of_memory(ImportError("libx.so: failed to map segment from shared object"))
    assert memory.is_lack_of_memory(MemoryError())
    assert not memory.is_lack_of_memory(ImportError("No module named 'x'"))
