"""The benchmark's machine-independent figures, held against those accepted; wall times are never gated.

Accuracy, iterations, unknowns, sizes of dense matrices. Where a change is meant to
move them: `make baselines`, and look at the difference.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from numpy.testing import assert_allclose

from vdmbench import bench
from vdmbench.bench import Bench, machine_independent
from vdmbench.models import model_names
from vdmbench.study.config import load_study

ROOT = Path(__file__).parents[2]
BASELINE = ROOT / "results" / "baselines" / "bench.json"
SIZE = 2.0  # mesh size over that of the quickstart


def trial(directory: Path) -> Bench:
    """One round of every model on a coarse sphere."""
    study = load_study(ROOT / "studies" / "cases" / "quickstart.toml")
    return bench.measure(
        {"sphere": study}, directory, names=model_names(benched=True), sizes=(SIZE,), rounds=1, watch=str
    )


def test_figures_are_what_was_accepted_and_the_file_keeps_them(tmp_path: Path) -> None:
    found = trial(tmp_path)
    figures = machine_independent(found)
    accepted = json.loads(BASELINE.read_bytes())["figures"]
    assert figures.keys() == accepted.keys(), "a model or figure has come or gone: make baselines"
    for name, value in accepted.items():
        counted = name.endswith("/iterations")
        # where rounding differs, BiCG needed 57 iterations on one kind of processor and 60 on another
        bound = {"rtol": 0.05, "atol": 2.0} if counted else {"rtol": 1e-3, "atol": 1e-9}
        assert_allclose(figures[name], value, **bound, err_msg=name)
    assert {e.model for e in found.entries} == set(model_names(benched=True))

    bench.write_bench(tmp_path / "bench.json", found)
    read = bench.read_bench(tmp_path / "bench.json")
    assert machine_independent(read) == figures
    assert read.machine == found.machine
    assert bench.rows(read) == bench.rows(found)


def main() -> None:
    """Accept the figures of this program."""
    with tempfile.TemporaryDirectory() as name:
        figures = machine_independent(trial(Path(name)))
    BASELINE.write_text(json.dumps({"figures": figures}, indent=1) + "\n")


if __name__ == "__main__":
    main()
