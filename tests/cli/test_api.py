"""The workbench from Python: one run with changes to its study, and all that its results give."""

import ast
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from numpy.testing import assert_allclose

import vdmbench
from tests.command import pool_here, write_study
from tests.report.runs import make_run, sweep_run
from vdmbench.api import Results
from vdmbench.study.files import merged


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    where = tmp_path_factory.mktemp("api")
    changes: dict[str, Any] = {
        "tissue": {"youngs_modulus": "10 kPa"},
        "constraints": {"finger": {"force": "0.2 N"}},
        "geometry": {"mesh_size": "20 mm"},
        "load": None,
    }
    study = write_study(where)
    with mock.patch("vdmbench.work.run._pool", pool_here):
        return vdmbench.run(study, out=where / "run", cache=where / "cache", jobs=1, **changes)


def test_a_study_is_run_with_changes(results: Results) -> None:
    assert repr(results).endswith("run': 1 cases, 0 failed)")
    (case,) = results.cases
    assert case.study.tissue.youngs_modulus == 10e3
    assert case.study.constraints[1].force == 0.2
    assert case.load_factors.tolist() == [1.0]
    assert results.report.stat().st_size > 10_000
    again = vdmbench.read(results.directory)
    displacement = again.cases[0].models["fem-linear"].displacement
    assert_allclose(displacement, case.models["fem-linear"].displacement, rtol=0, atol=0)
    assert "10 kPa" in (results.directory / "study.toml").read_text(), "the run tells what it ran"


def test_a_script_needs_no_guard_around_its_main_part(tmp_path: Path) -> None:
    """Workers that imported it would start runs of their own."""
    study = write_study(
        tmp_path, a=('["vdm-paper", "fem-linear"]', '["vdm-paper"]'), b=('reference = "fem-linear"', "")
    )
    script = tmp_path / "script.py"
    script.write_text(
        f"import vdmbench\nprint(vdmbench.run({str(study)!r}, out='run', cache='cache'), __file__)\n"
    )
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == f"Results('run': 1 cases, 0 failed) {script}\n"
    assert done.stderr == ""


def test_meshes_carry_the_answers(results: Results) -> None:
    (case,) = results.cases
    (mesh,) = results.meshes.values()
    assert mesh.n_cells == len(case.triangles)
    expected = case.points + case.models["fem-linear"].displacement[-1]
    warped = mesh.warp_by_vector("fem-linear.displacement")
    assert_allclose(warped.points, expected, rtol=0, atol=1e-12)


def test_a_notebook_shows_the_headline_and_no_markup_of_a_study() -> None:
    run = make_run(sweep_run().cases, title="<script>")
    html = Results(Path("run"), run, Path("run/report.html"))._repr_html_()
    assert "<td>vdm-paper</td>" in html
    assert "72.0 %" in html
    assert "<script>" not in html
    assert "run/report.html" in html


def test_what_cannot_be_changed_is_told(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    with pytest.raises(ValueError, match='unknown entry of constraints "thumb"; known: base, finger'):
        vdmbench.run(study, constraints={"thumb": {"force": "1 N"}})
    with pytest.raises(ValueError, match=r"small.toml:15: tissue.poisson_ratio: must be above -1"):
        vdmbench.run(study, tissue={"poisson_ratio": 2.0})
    with pytest.raises(ValueError, match='did you mean "quickstart"'):
        vdmbench.run("quikstart")
    changed = merged({"a": 1, "t": {"b": 2, "c": 3}}, {"t": {"b": None, "d": [1]}, "a": 5})
    assert changed == {"a": 5, "t": {"c": 3, "d": [1]}}


def test_the_package_is_cheap_to_import() -> None:
    code = (
        "import sys; import vdmbench; print([n for n in sys.modules if n in {'numpy', 'pydantic', 'typing'}])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ast.literal_eval(result.stdout) == []
    assert {"run", "read", "Results", "__version__"} <= set(dir(vdmbench))
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        _ = vdmbench.walk  # type: ignore[attr-defined]
