"""There and back: a study exported, solved by another program from the files alone, and judged by `compare`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest

from tests.command import SMALL_STUDY, vdmbench
from vdmbench.measures.metrics import VECTOR

# a pressure that is the same on every facet that it loads: its mean over a facet is all that there is to tell
STUDY = SMALL_STUDY.replace('["vdm-paper", "fem-linear"]', '["fem-p1", "fem-linear"]')
STUDY = STUDY.replace('"hertz"', '"uniform"')


@pytest.fixture(scope="module")
def ngs() -> Any:
    return pytest.importorskip("ngsolve", reason="needs NGSolve: pip install ./docs/examples")


@pytest.fixture(scope="module")
def mujoco() -> Any:
    return pytest.importorskip("mujoco", reason="needs MuJoCo: pip install ./docs/examples")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the study and its export in `out`."""
    place = tmp_path_factory.mktemp("round")
    (place / "small.toml").write_text(STUDY)
    told = vdmbench("export", "small.toml", "--to", "out", cwd=place)
    assert told.returncode == 0, told.stderr
    return place


def judged(place: Path, result: str, name: str) -> dict[str, float]:
    """The displacement error of a result, and those of our models beside it."""
    told = vdmbench(
        "compare", "small.toml", "--result", result, "--name", name, "--jobs", "1", "--json", cwd=place
    )
    assert told.returncode == 0, told.stderr
    assert (place / "results" / "runs" / "small" / f"report-{name}.html").exists()
    metrics: dict[str, Any] = json.loads(told.stdout)["metrics"]
    return {model: row[VECTOR]["value"] for model, row in metrics.items() if VECTOR in row}


def test_ngsolve_from_the_files_alone_is_the_reference(ngs: Any, place: Path) -> None:
    """Quadratic elements of its own, pressure integrated by itself: a constant on each facet."""
    import netgen.meshing as netgen

    scene = json.loads((place / "out" / "scene.json").read_text())
    read = meshio.read(place / "out" / scene["mesh"])
    held, pressed = set(scene["held"]["points"]), scene["pressures"]
    pressure = dict(zip(map(frozenset, pressed["facets"]), pressed["pressure"], strict=True))
    made = netgen.Mesh(dim=3)
    for point in read.points.tolist():
        made.Add(netgen.MeshPoint(netgen.Pnt(*point)))
    facets = (read.cells_dict["triangle"]).tolist()
    kinds = [pressure.get(frozenset(f), -1.0 if held.issuperset(f) else 0.0) for f in facets]
    values = sorted(set(kinds))  # a boundary number for each: -1 is held, 0 is free
    for number in range(len(values)):
        made.Add(netgen.FaceDescriptor(surfnr=number + 1, domin=1, bc=number + 1))
    made.SetMaterial(1, "tissue")
    for nodes in (read.cells_dict["tetra"] + 1).tolist():
        made.Add(netgen.Element3D(1, nodes))
    for nodes, kind in zip(facets, kinds, strict=True):
        made.Add(netgen.Element2D(values.index(kind) + 1, [node + 1 for node in nodes]))
    for number, value in enumerate(values):
        made.SetBCName(number, "held" if value == -1.0 else f"p{number}")
    mesh = ngs.Mesh(made)
    young, nu = scene["tissue"]["youngs_modulus"], scene["tissue"]["poisson_ratio"]
    mu = young / (2.0 * (1.0 + nu))
    space = ngs.VectorH1(mesh, order=2, dirichlet="held") * ngs.H1(mesh, order=1)
    (u, p), (v, q) = space.TnT()
    strain = 0.5 * (ngs.Grad(u) + ngs.Grad(u).trans)
    form = ngs.BilinearForm(space)
    form += (2.0 * mu * ngs.InnerProduct(strain, ngs.Grad(v)) - p * ngs.div(v) - q * ngs.div(u)) * ngs.dx
    form += -(1.0 - 2.0 * nu) / (2.0 * mu * nu) * p * q * ngs.dx
    load = ngs.LinearForm(space)
    push = mesh.BoundaryCF({f"p{k}": value for k, value in enumerate(values) if value > 0.0}, default=0.0)
    load += -push * ngs.InnerProduct(ngs.specialcf.normal(3), v) * ngs.ds
    form.Assemble()
    load.Assemble()
    found = ngs.GridFunction(space)
    found.vec.data = form.mat.Inverse(space.FreeDofs(), inverse="umfpack") * load.vec
    n = len(read.points)
    displacement = np.array([np.asarray(c.vec)[:n] for c in found.components[0].components]).T
    meshio.Mesh(read.points, [("tetra", read.cells_dict["tetra"])], {"displacement": displacement}).write(
        place / "ngsolve.vtu"
    )
    error = judged(place, "ngsolve.vtu", "ngsolve")
    assert error["ngsolve"] < 1e-8, "both solve one system directly"
    assert error["fem-p1"] > 0.1


def test_mujoco_from_its_scene_is_linear_elasticity_on_its_tetrahedra(
    mujoco: Any, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)  # where it logs its warnings
    model = mujoco.MjModel.from_xml_path(str(place / "out" / "scene_mujoco.xml"))
    data = mujoco.MjData(model)
    for _ in range(60):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)
    places = np.array([data.body(f"p{k}").xpos for k in range(model.nbody - 1)])
    rest = meshio.read(place / "out" / "mesh.vtu").points
    rows = np.column_stack([rest, places])
    head = "x,y,z,deformed_x,deformed_y,deformed_z"
    np.savetxt(place / "mujoco.csv", rows, fmt="%.17g", delimiter=",", header=head, comments="")
    error = judged(place, "mujoco.csv", "mujoco")
    assert error["mujoco"] > 0.1
    assert error["mujoco"] == pytest.approx(error["fem-p1"], rel=0.05), "they lock alike"
