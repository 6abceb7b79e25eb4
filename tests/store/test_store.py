"""What is written is what is read, by us and by VTK; what is damaged is refused."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tomli_w
from numpy.testing import assert_array_equal

from tests.command import strict_json
from tests.report.runs import whole_case
from vdmbench.measures import uncertainty
from vdmbench.store import cases as store
from vdmbench.store.plain import StoreError
from vdmbench.store.run_directory import RESOLVED, STUDY, case_path, failure_path, write_failure, write_plan
from vdmbench.study.config import resolved


def assert_same(a: Any, b: Any, where: str = "") -> None:
    """Equal to the bit, through dataclasses, mappings and arrays."""
    if dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, dict):
        assert list(a) == list(b) if where.endswith("models") else set(a) == set(b), where
        for key in a:
            assert_same(a[key], b[key], f"{where}[{key}]")
    elif isinstance(a, tuple | list):
        assert len(a) == len(b), where
        for x, y in zip(a, b, strict=True):
            assert_same(x, y, where)
    else:
        assert_array_equal(a, b, err_msg=where)


def test_round_trip(tmp_path: Path) -> None:
    case = whole_case()
    store.write_case(tmp_path / "case.vtkhdf", case)
    assert_same(case, store.read_case(tmp_path / "case.vtkhdf"))
    assert [path.name for path in tmp_path.iterdir()] == ["case.vtkhdf"], "no temporary file is left"


def _about(path: Path) -> str:
    with h5py.File(path) as file:
        return file[store.ABOUT][()].decode()


def test_numbers_that_are_not_there_are_null_to_others_and_nan_to_us(tmp_path: Path) -> None:
    case = whole_case()
    result = dataclasses.replace(
        case.models["vdm-paper"],
        seconds_setup=np.nan,
        parameters={"condition": np.float64("nan"), "solver": "x"},
    )
    case = dataclasses.replace(
        case,
        models={**case.models, "vdm-paper": result},
        reference_error={
            "difference_01": 0.03,
            "observed_order": np.nan,
            "gci:max_nodal_error": np.float32("nan"),
        },
        mesh_quality={"worst_sicn": np.nan},
    )
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, case)
    about = strict_json(_about(path))
    assert about["reference_error"] == {
        "difference_01": 0.03,
        "observed_order": None,
        "gci:max_nodal_error": None,
    }
    assert about["models"]["vdm-paper"]["seconds_setup"] is None
    assert about["models"]["vdm-paper"]["parameters"] == {"condition": None, "solver": "x"}
    read = store.read_case(path)
    assert_same(case, read)
    assert np.isnan(uncertainty.reference_bar(read.reference_error, "max_nodal_error"))
    assert uncertainty.stored_estimate(read.reference_error) == uncertainty.stored_estimate(
        case.reference_error
    )


def test_a_models_own_output_cannot_take_the_place_of_what_every_model_has() -> None:
    """`volume` is one of the reference's further outputs: of the curved body, not of the polyhedron."""
    result = whole_case().models["vdm-paper"]
    with pytest.raises(ValueError, match="cannot be called 'volume'"):
        dataclasses.replace(result, scalars={**result.scalars, "volume": result.energy})


def test_vtk_reads_surface_fields_and_steps(tmp_path: Path) -> None:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    case = whole_case()
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, case)
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == len(case.load_factors)
    for step in range(len(case.load_factors)):
        reader.SetStep(step)
        reader.Update()
        assert reader.GetTimeValue() == case.load_factors[step]
        grid = reader.GetOutputDataObject(0)
        assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), case.points)
        cells = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
        assert_array_equal(cells.reshape(-1, 3), case.triangles)
        data = grid.GetPointData()
        for name, model in case.models.items():
            for field in ("displacement", "reaction_force"):
                values = vtk_to_numpy(data.GetArray(f"{name}.{field}"))
                assert_array_equal(values, getattr(model, field)[step], err_msg=f"{name} {step}")
            assert_array_equal(vtk_to_numpy(data.GetArray(f"{name}.part_of_node")), model.part_of_node)
        assert_array_equal(vtk_to_numpy(data.GetArray("region.base")), case.regions["base"])


def _reseal(path: Path, edit: Any) -> None:
    """Tamper with the text of a case file and seal it anew, as somebody with this program's source could."""
    about = json.loads(_about(path))
    changed = edit(about)
    text = changed if isinstance(changed, bytes) else json.dumps(about).encode()
    image = path.read_bytes()
    place = store._PLACE.format(slice(len(image), len(image) + len(text)))
    content = image + text + place.encode()
    path.write_bytes(content + store._seal(content))


def test_a_file_is_named_by_its_label_and_found_by_its_hash(tmp_path: Path) -> None:
    case = whole_case()
    path = case_path(tmp_path, case.hash, "force = 0.1 N, poisson_ratio = -0.45")
    assert path.name == f"force-0.1-N-poisson_ratio--0.45-{case.hash[:12]}.vtkhdf"
    path.parent.mkdir()
    store.write_case(path, case)
    assert case_path(tmp_path, case.hash, "another study's label") == path
    assert case_path(tmp_path, "b" * 64, "../../é of\nsomebody" * 99).parent == path.parent
    assert len(case_path(tmp_path, "b" * 64, "é word " * 99).name.encode()) < 130
    assert store.case_state(tmp_path, case.hash, "force = 0.1 N") == "done"


def test_a_case_of_an_older_program_is_made_anew(tmp_path: Path) -> None:
    case = whole_case()
    path = case_path(tmp_path, case.hash)
    path.parent.mkdir()
    store.write_case(path, case)
    assert store.case_state(tmp_path, case.hash) == "done"
    _reseal(path, lambda about: about.update(schema=1))
    assert store.case_state(tmp_path, case.hash) == "missing"
    _reseal(path, lambda about: about.update(schema=store.SCHEMA, hash="0" * 64))
    assert store.case_state(tmp_path, case.hash) == "damaged"


FIELD = "VTKHDF/PointData/vdm-paper.displacement"


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda about: about.update(schema=99), "newer"),
        (lambda about: about.update(schema=1), "older version of the program; run again"),
        (lambda _: b"{", "older"),
        (lambda about: about.__delitem__("study"), "'study' is not there"),
        (lambda about: about.update(models=[]), "not readable"),
        (lambda about: about.update(label=3), "'label' is not of type str"),
        (
            lambda about: about.update(small_strain={"x": {}}),
            "'small_strain.x.structural_error' is not there",
        ),
        (
            lambda about: about.update(measurement={"quantities": 3}),
            "'measurement.quantities' is not a list",
        ),
        (
            lambda about: about.update(reference_error={"levels": "two"}),
            "'reference_error.levels' is not a num",
        ),
        (lambda about: about["arrays"].pop(FIELD), "not readable"),
        (lambda about: about["arrays"][FIELD].update(offset=10**6), "not readable"),
        (lambda about: about["arrays"][FIELD].update(shape=[5, 3]), "not readable"),
        (lambda about: about["arrays"][FIELD].update(dtype="strange"), "not readable"),
    ],
)
def test_a_tampered_file_is_refused(tmp_path: Path, edit: Any, message: str) -> None:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, whole_case())
    _reseal(path, edit)
    with pytest.raises(StoreError, match=message):
        store.read_case(path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "case.vtkhdf"
    with pytest.raises(StoreError, match="no such file"):
        store.read_case(path)
    path.write_text("not HDF5")
    with pytest.raises(StoreError, match="damaged"):
        store.read_case(path)


def test_run_directory(tmp_path: Path) -> None:
    """Three planned cases: one done, one failed, one missing."""
    done, failed, swept = whole_case("a1" * 32), "b2" * 32, {"tissue.poisson_ratio": 0.45}
    store.write_case(case_path(tmp_path, done.hash), done)
    reason = {"hash": failed, "label": "x", "code": "error", "message": "too coarse", "remedy": "refine"}
    write_failure(failure_path(tmp_path, failed), reason, "")
    planned = [
        {"hash": h, "label": f"case {h[:2]}", "swept": swept, "swept_units": dict.fromkeys(swept, "1")}
        for h in (done.hash, failed, "c3" * 32)
    ]
    write_plan(tmp_path, {"study": {"name": "s"}, "cases": planned})
    (tmp_path / STUDY).write_text("[study]")
    (tmp_path / RESOLVED).write_text(tomli_w.dumps(resolved(done.study)))
    run = store.read_run(tmp_path)
    assert [case.label for case in run.cases] == ["case a1"], "label and swept values are the plan's"
    assert run.cases[0].swept == swept
    assert [failure["message"] for failure in run.failed] == ["too coarse"]
    assert run.missing == ["case c3"]
    path = case_path(tmp_path, "a1" * 32)
    path.write_bytes(path.read_bytes()[:-1])
    assert store.case_state(tmp_path, "a1" * 32) == "damaged"
    with pytest.raises(StoreError, match="damaged"):
        store.read_run(tmp_path)
    rest = store.read_run(tmp_path, damaged=True)
    assert (len(rest.cases), rest.damaged, len(rest.failed)) == (0, 1, 2)
    assert path.name in rest.failed[0]["message"]


@pytest.mark.parametrize("text", ["", "[]", "{", '{"cases": [{}]}', '{"cases": 3}'])
def test_a_damaged_plan_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(StoreError, match="damaged"):
        store.read_run(tmp_path)


def test_a_case_that_would_not_be_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "MAX_BYTES", 100)
    with pytest.raises(ValueError, match="more than a case file holds; use fewer load steps"):
        store.write_case(tmp_path / "case.vtkhdf", whole_case())
    assert list(tmp_path.iterdir()) == []
