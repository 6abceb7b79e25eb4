"""Where things are, and the command `vdmbench` as the programs of this folder call it."""

from __future__ import annotations

from pathlib import Path

from tests.command import vdmbench_process

ROOT = Path(__file__).parents[1]
CASES = ROOT / "studies" / "cases"
RUNS = ROOT / "results" / "runs"


def finished(*words: str | Path, cwd: Path = ROOT, codes: tuple[int, ...] = (0,), **environment: str) -> str:
    """What a command prints that may take two hours. Raises RuntimeError for another exit code."""
    result = vdmbench_process(*words, cwd=cwd, seconds=7200, **environment)
    if result.returncode not in codes:
        raise RuntimeError(f"{' '.join(map(str, words[:2]))}: {result.stderr}")
    return result.stdout
