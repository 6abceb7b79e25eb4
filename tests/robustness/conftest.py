"""A run that nothing disturbed, for the tests that disturb others."""

import time
from pathlib import Path

import pytest

from tests.command import write_study

from . import processes


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """A directory with six cases in two groups, run in peace; and the seconds that it took. Not to be changed."""
    directory = tmp_path_factory.mktemp("undisturbed")
    sweep = (
        '[sweep]\n"tissue.poisson_ratio" = [0.45, 0.49]\n"constraints.finger.force" = [0.1, 0.2, 0.3]\n[load]'
    )
    write_study(directory, a=('"16 mm"', '"20 mm"'), b=("[load]", sweep))
    began = time.monotonic()
    process = processes.start("run", "small.toml", "--jobs", "2", cwd=directory)
    output = processes.output_of(process)
    assert process.returncode == 0, output
    return directory, time.monotonic() - began
