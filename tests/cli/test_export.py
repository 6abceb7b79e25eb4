"""`vdmbench export`: tables, figures and meshes that other programs read; a mesh lies on the scan it came from."""

import csv
import dataclasses
import json
import xml.etree.ElementTree as ET
from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista
from numpy.testing import assert_allclose

from tests.command import do
from tests.report.runs import asked, make_case, sweep_run
from vdmbench.cli.arguments import parse
from vdmbench.measures.case import CaseResult
from vdmbench.report.blocks import Cell, Field, Table
from vdmbench.report.export import surface_fields, table_csv, unit_of


def test_every_file_is_read_by_another_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = sweep_run(), tmp_path / "out"
    (tmp_path / "run" / "cases").mkdir(parents=True)
    monkeypatch.setattr("vdmbench.store.cases.read_run", lambda _: run)
    assert do(parse(["export", f"{tmp_path}/run", "--to", f"{out}", "--json"])) == 0
    told = json.loads(capsys.readouterr().out)
    assert sorted(told["files"]) == sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    drawings = sorted((out / "figures").glob("*.svg"))
    assert {"scene.svg", "parameters-1.svg", "force-1.svg"} <= {path.name for path in drawings}
    for path in drawings:
        root = ET.fromstring(path.read_text())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert "var(" not in path.read_text(), "a colour of the page, which is not there"
    words = "".join(ET.fromstring((out / "figures/force-1.svg").read_text()).itertext())
    assert "vdm-vector" in words, "a legend"
    rows = list(csv.DictReader((out / "tables/headline.csv").read_text().splitlines()))
    assert [row["Model"].split()[0] for row in rows] == ["vdm-paper", "vdm-vector", "fem-linear"]
    assert float(rows[0]["Displacement error [1]"]) == pytest.approx(0.66, rel=1e-9)
    assert float(rows[0]["Displacement error ± [1]"]) == pytest.approx(0.0068, rel=1e-9)
    assert rows[2]["Displacement error [1]"] == rows[2]["Displacement error ± [1]"] == ""
    assert "Set-up ± [s]" not in rows[0], "no time has a bar"
    meshes = sorted((out / "meshes").glob("*.vtu"))
    assert len(meshes) == len(run.cases)
    assert "poisson_ratio_=_0.45_pressure_=_200_Pa.vtu" in {path.name for path in meshes}
    found = pyvista.read(out / "meshes/poisson_ratio_=_0.45_pressure_=_200_Pa.vtu")
    case = next(c for c in run.cases if c.label == "poisson_ratio = 0.45, pressure = 200 Pa")
    assert_allclose(found.points, case.points, rtol=0, atol=1e-15)
    displacement = case.models["vdm-vector"].displacement[-1]
    assert_allclose(found["vdm-vector.displacement"], displacement, rtol=0, atol=1e-15)
    exact = case.models["fem-linear"].displacement[-1]
    assert_allclose(found["vdm-vector.difference"], displacement - exact, rtol=0, atol=1e-15)


def test_a_mesh_lies_on_the_scan_it_came_from(tmp_path: Path) -> None:
    """The scan is in millimetres, far from the origin; a case of it is in metres, as is all that is computed."""
    case = make_case({"vdm-vector": 0.1})
    scan = 1e3 * (case.points + np.array([0.4, -0.2, 1.5]))
    meshio.write_points_cells(tmp_path / "scan.stl", scan, [("triangle", case.triangles)])
    points = 1e-3 * scan
    of_file: CaseResult = dataclasses.replace(
        case,
        points=points,
        mesh_quality={**case.mesh_quality, "scale": 1e-3},
        study=asked(case, geometry={"shape": "file", "path": "scan.stl"}).study,
    )
    points, fields = surface_fields(of_file)
    bounds = pyvista.read(tmp_path / "scan.stl").bounds
    assert_allclose([points.min(axis=0), points.max(axis=0)], np.reshape(bounds, (3, 2)).T, rtol=0, atol=1e-3)
    largest = np.linalg.norm(fields["vdm-vector.displacement"], axis=1).max()
    in_metres = np.linalg.norm(case.models["vdm-vector"].displacement[-1], axis=1).max()
    assert largest == pytest.approx(1e3 * in_metres, rel=1e-12), "so that a warp has the scale of the scan"
    assert unit_of(of_file) == "the unit of scan.stl (0.001 m)"
    assert unit_of(case) == "metres"


def test_what_a_spreadsheet_would_run_is_made_safe() -> None:
    columns = [Field("=cmd()", str), Field("Error", str, "1", "worst")]
    table = Table("t", "", columns, [[Cell("50 % of_a & b"), Cell("−1.2×10⁻³ %", "± 1 %", value=-1.2e-5)]])
    assert table_csv(table) == "'=cmd(),Error worst [1]\n50 % of_a & b,-1.2e-05\n"
