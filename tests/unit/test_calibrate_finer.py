"""Where a fit was tried on no finer mesh, that and why is said: on the terminal, in the table to paste, in JSON."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import meshio
import pytest

from tests.command import strict_json, vdmbench
from vdmbench.body.geometry import build_mesh
from vdmbench.cli import main as cli
from vdmbench.evidence.calibrate import Body, Calibration, as_json, as_toml, body, calibrate
from vdmbench.evidence.calibration_table import table
from vdmbench.evidence.fit import Sample
from vdmbench.machine.files import json_text
from vdmbench.measures.case import Run
from vdmbench.study.config import load_study, with_mesh_size
from vdmbench.study.shapes import Geometry

from . import test_calibrate
from .test_calibrate import STUDY, answered, finished

four_loads = test_calibrate.samples  # the fixture
TEXT = STUDY.replace('"vdm-paper", ', "").replace('"fem-linear"', '"bem"')
SWEPT = '"geometry.mesh_size" = ["16 mm", "18 mm"]\n'
OWN = TEXT.replace(
    'shape = "ellipsoid"\nsemi_axes = ["40 mm", "30 mm", "25 mm"]', 'shape = "file"\npath = "own.vtu"'
)


def assert_told(entry: Calibration, reason: str) -> None:
    told = f"# mesh independence: not measured, because {reason}"
    assert as_toml([entry]).splitlines()[0] == told
    (row,) = table([entry])
    assert row["fit of a finer mesh"] == row["there, this fit"] == "not measured"
    assert strict_json(json_text(as_json([entry])))[entry.fit.model]["no_finer"] == reason


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TEXT + SWEPT, "the study sweeps geometry.mesh_size"),
        (OWN, 'the tetrahedra of "own.vtu" are used as they are'),  # whatever mesh_size says
        (OWN.replace('mesh_size = "16 mm"\n', ""), 'the tetrahedra of "own.vtu" are used as they are'),
    ],
)
def test_a_study_without_a_finer_mesh_says_so(tmp_path: Path, text: str, reason: str) -> None:
    ball = build_mesh(Geometry("ellipsoid", 0.016, {"semi_axes": (0.04, 0.03, 0.025)}))
    meshio.write_points_cells(tmp_path / "own.vtu", ball.points, [("tetra", ball.tetrahedra)])
    (tmp_path / "fit.toml").write_text(text)
    assert with_mesh_size(load_study(tmp_path / "fit.toml"), 0.5) is None
    result = vdmbench("calibrate", "fit.toml", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    told = f"# mesh independence: not measured, because {reason}"
    assert told in result.stdout.splitlines()
    directory = tmp_path / "results/runs/fit"
    assert told in (directory / "calibration.toml").read_text().splitlines()
    entry = strict_json((directory / "calibration.json").read_text())["fit"]["vdm-vector"]
    assert (entry["finer"], entry["on_finer"], entry["no_finer"]) == (None, None, reason)
    assert not (directory / "finer").exists()


def test_a_finer_mesh_of_too_many_nodes_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mesh_size that is refused is none that the study's author wrote."""
    (tmp_path / "fit.toml").write_text(TEXT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("vdmbench.study.shapes.MAX_NODES", 100)
    with pytest.raises(SystemExit) as ended:
        cli.main(["calibrate", "fit.toml"])
    assert ended.value.code == 0
    told = "# mesh independence: not measured, because mesh_size 0.012 m would give about"
    assert any(line.startswith(told) for line in capsys.readouterr().out.splitlines())


@pytest.mark.parametrize(
    ("done", "reason"),
    [
        (0, "no case of this study is finished, so there is nothing to fit to"),
        (3, "none of the loads held out is finished: put right what failed, or sweep others"),
    ],
)
def test_a_finer_mesh_whose_loads_fail_says_so(tmp_path: Path, done: int, reason: str) -> None:
    run, plan = finished(TEXT, tmp_path)
    finer = Run(run.study, "", run.cases[:done], [], [], {})
    entry = calibrate(body(plan, run, (plan, finer)))[0]
    assert_told(entry, f"on the finer mesh {reason}")
    entry = calibrate(body(plan, run, (plan, run)))[0]
    assert entry.finer == entry.fit.multiples
    assert "mesh independence" not in as_toml([entry])
    assert entry.no_finer == ""


def test_a_model_that_cannot_be_fitted_on_a_finer_mesh_says_so(four_loads: list[Sample]) -> None:
    def negative(loads: Sequence[Sample]) -> tuple[Sample, ...]:
        return tuple(dataclasses.replace(load, reference=-load.reference) for load in loads)

    known = tuple(answered(four_loads, "vdm-vector", [1.3], ["surface_tension"]))
    own = Body("own", ("vdm-vector",), None, known[:2], known[2:], negative(known[:2]), negative(known[2:]))
    (entry,) = calibrate(own)
    reason = "on the finer mesh vdm-vector moves against the reference on the training loads: no fit"
    assert_told(entry, reason)
