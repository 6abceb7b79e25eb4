"""`results/FORMAT.md` and the files hold together: each names all that the other has."""

import json
import re
from pathlib import Path

import h5py

from tests.report.runs import whole_case
from vdmbench.store import cases as store

FORMAT = Path(__file__).parents[2] / "results" / "FORMAT.md"
PLACEHOLDERS = {
    "<model>": r"[^/.]+?",
    "<region>": r"[^/]+",
}


def _documented() -> dict[str, re.Pattern[str]]:
    first = re.findall(r"^\| (`/[^|]+) \|", FORMAT.read_text(), flags=re.MULTILINE)
    rows = [path for cell in first for path in re.findall(r"`([^`]+)`", cell)]
    patterns = {}
    for row in rows:
        pattern = re.escape(row)
        for placeholder, expression in PLACEHOLDERS.items():
            pattern = pattern.replace(re.escape(placeholder), expression)
        patterns[row] = re.compile(pattern)
    return patterns


def test_every_dataset_is_documented_and_every_document_has_a_dataset(tmp_path: Path) -> None:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, whole_case())
    written: list[str] = []
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: written.append(f"/{name}") if isinstance(item, h5py.Dataset) else None
        )
    documented = _documented()
    assert len(documented) > 15
    undocumented = [name for name in written if not any(p.fullmatch(name) for p in documented.values())]
    assert undocumented == []
    unwritten = [row for row, p in documented.items() if not any(p.fullmatch(name) for name in written)]
    assert unwritten == []


def test_attributes_and_seal_are_as_documented(tmp_path: Path) -> None:
    path = tmp_path / "case.vtkhdf"
    store.write_case(path, whole_case())
    text = " ".join(FORMAT.read_text().split())
    with h5py.File(path) as file:
        for group in ("VTKHDF", "VTKHDF/Steps", "VTKHDF/Points"):
            for name in file[group].attrs:
                assert f"`{name}`" in text, f"{group} has an attribute {name} that FORMAT.md does not name"
        about = json.loads(file[store.ABOUT][()])
    assert about["schema"] == store.SCHEMA
    assert f"| `schema` | {store.SCHEMA};" in text
    (limit, *_), (quantity, *_) = (
        about["small_strain"]["vdm-paper"]["limits"],
        about["measurement"]["quantities"],
    )
    model, spread = about["small_strain"]["vdm-paper"], about["inputs"]["models"]["vdm-paper"]
    own = about["models"]["vdm-paper"]
    tables = (
        about,
        own,
        own["status"][0],
        about["definitions"]["max_nodal_error"],
        next(iter(about["arrays"].values())),
        model,
    )
    tables += (limit, quantity, about["measurement"], about["inputs"], spread)
    told = {key for table in tables for key in table}
    assert [name for name in sorted(told - set(own["scalars"])) if f"`{name}`" not in text] == []
    assert f"last {store.SEAL_BYTES} bytes" in text
