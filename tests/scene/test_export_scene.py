"""A study's scene as files of other programs: each read back by a reader of its own, and held to the scene."""

import ast
import json
import resource
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.command import SMALL_STUDY, do
from vdmbench.body.geometry import build_mesh
from vdmbench.cli.arguments import parse
from vdmbench.machine import whole_directory
from vdmbench.scene.export import Handout, write_scene
from vdmbench.scene.scene import build_scene
from vdmbench.study.errors import InputError
from vdmbench.study.schema import Study

STUDY: dict[str, Any] = {
    "study": {"name": "test", "models": ["fem-linear"]},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.02},
    "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.49, "density": 1000.0},
    "regions": {
        "base": {"below": {"axis": "z", "fraction": 0.2}},
        "side": {"above": {"axis": "x", "fraction": 0.9}},
        "back": {"cap": {"direction": [-1.0, 0.0, 0.0], "angle": 0.4}},
        "finger": {"cap": {"direction": [0.0, 0.0, 1.0], "angle": 0.6}},
    },
    "constraints": [
        {"kind": "fixed", "region": "base"},
        {"kind": "constrained", "region": "side", "displacement": [0.0, 0.001, -0.002]},
        {"kind": "contact", "region": "finger", "force": 0.1},
    ],
    "gravity": {"acceleration": [0.0, 1.0, -9.81]},
    "load": {"factors": [0.5, 2.0]},
}


LUMP = {"name": "lump", "ball": {"center": [0.0, 0.0, 0.0], "radius": 0.03}, "youngs_modulus": 9e3}
SPRINGS = {"kind": "elastic", "region": "back", "stiffness": 1e5}


def handed(**tables: Any) -> Handout:
    study = Study.model_validate(STUDY | tables)
    scene = build_scene(study, build_mesh(study.geometry))
    return Handout(scene, scene.load(2.0), "ball -- a case", 2.0)


@pytest.fixture(scope="module")
def body() -> Handout:
    return handed()


@pytest.fixture(scope="module")
def out(body: Handout, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("scene")
    names, refused = write_scene(body, directory)
    assert sorted(names) == sorted(path.name for path in directory.iterdir())
    assert refused == []
    return directory


def test_what_is_handed_out_is_the_scene(body: Handout) -> None:
    n = body.mesh.surface_nodes
    scene = build_scene(Study.model_validate(STUDY), body.mesh)
    assert_allclose(body.force.sum(axis=0), 2.0 * scene.contact_force.sum(axis=0), rtol=1e-12)
    assert np.linalg.norm(body.force.sum(axis=0)) == pytest.approx(0.2, rel=0.02)
    corners = body.mesh.points[body.mesh.tetrahedra]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0
    assert_allclose(body.mass.sum(), 1000.0 * volume, rtol=1e-12)
    # the first moment too: the weight does the work that it does on a linear field
    assert_allclose(
        body.mass @ body.mesh.points,
        1000.0 / 6.0 * np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) @ corners.mean(axis=1),
        atol=1e-12,
    )
    assert_allclose(body.displacement[n][scene.constrained], [[0.0, 0.002, -0.004]] * scene.constrained.sum())
    assert not body.displacement[n][scene.fixed].any()
    facets = body.mesh.surface_points[body.mesh.triangles]
    areas = 0.5 * np.linalg.norm(np.cross(facets[:, 1] - facets[:, 0], facets[:, 2] - facets[:, 0]), axis=1)
    assert areas @ body.facet_pressure == pytest.approx(
        2.0 * scene.contact_pressure @ _node_areas(body, areas)
    )


def _node_areas(body: Handout, areas: np.ndarray) -> np.ndarray:
    return np.bincount(body.mesh.triangles.ravel(), weights=np.repeat(areas / 3.0, 3))


def test_meshes_hold_the_regions(body: Handout, out: Path) -> None:
    numbers = body.mesh.surface_nodes
    for name in ("mesh.vtu", "mesh.msh"):
        read = meshio.read(out / name)
        assert_allclose(read.points, body.mesh.points, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(read.cells_dict["tetra"], body.mesh.tetrahedra)
        np.testing.assert_array_equal(read.cells_dict["triangle"], numbers[body.mesh.triangles])
        if name == "mesh.vtu":
            for region, mask in body.scene.regions.items():
                np.testing.assert_array_equal(
                    np.flatnonzero(read.point_data[f"region.{region}"]), numbers[mask]
                )
            assert_allclose(read.point_data["force"], body.force)
            assert_allclose(read.cell_data_dict["pressure"]["triangle"], body.facet_pressure)
        else:
            parts = {number: part for part, (number, dim) in read.field_data.items() if dim == 2}
            tags = read.cell_data_dict["gmsh:physical"]["triangle"]
            for number, part in parts.items():
                inside = tags == number
                expected = ~np.any(
                    [m[body.mesh.triangles].all(axis=1) for m in body.scene.regions.values()], axis=0
                )
                if part != "surface":
                    expected = body.scene.regions[part][body.mesh.triangles].all(axis=1)
                np.testing.assert_array_equal(inside, expected, part)


def test_the_json_holds_supports_and_loads(body: Handout, out: Path) -> None:
    told = json.loads((out / "scene.json").read_text())
    assert told["tissue"] == {"youngs_modulus": 5000.0, "poisson_ratio": 0.49, "density": 1000.0}
    assert_allclose(np.sum(told["forces"]["force"], axis=0), body.force.sum(axis=0), rtol=1e-12)
    assert told["held"]["points"] == np.flatnonzero(body.held).tolist()
    assert told["gravity"] == [0.0, 1.0, -9.81]
    assert set(told["regions"]) == {"base", "side", "back", "finger"}


def floats(element: ET.Element) -> list[float]:
    assert element.text
    return [float(word) for word in element.text.split(",")]


def test_febio_scene_is_of_the_documented_format(body: Handout, out: Path) -> None:
    """Sections and their order, references and counts as in the FEBio user's manual, format 4.0."""
    root = ET.parse(out / "scene.feb").getroot()
    assert (root.tag, root.attrib) == ("febio_spec", {"version": "4.0"})
    sections = "Module Control Globals Material Mesh MeshDomains MeshData Boundary Loads LoadData Output"
    assert " ".join(part.tag for part in root) == sections
    nodes = root.findall("Mesh/Nodes/node")
    assert [int(node.attrib["id"]) for node in nodes] == list(range(1, len(nodes) + 1))
    assert_allclose([floats(node) for node in nodes], body.mesh.points, rtol=0, atol=0)
    elements = root.findall("Mesh/Elements[@type='tet4']/elem")
    assert_allclose([floats(each) for each in elements], body.mesh.tetrahedra + 1)
    domain = root.find("MeshDomains/SolidDomain")
    material = root.find("Material/material")
    assert (domain.attrib["name"], domain.attrib["mat"]) == ("part", material.attrib["name"])
    assert [float(material.findtext(key, "")) for key in ("density", "E", "v")] == [1000.0, 5000.0, 0.49]
    sets = {each.attrib["name"]: [int(x) - 1 for x in floats(each)] for each in root.findall("Mesh/NodeSet")}
    tables = {each.attrib["name"]: each for each in root.findall("MeshData/NodeData")}
    for table in tables.values():
        lids = [int(node.attrib["lid"]) for node in table]
        assert lids == list(range(1, len(sets[table.attrib["node_set"]]) + 1))
    assert sorted(sets["held"] + sets["moved"]) == np.flatnonzero(body.held).tolist()
    force = np.array([floats(node) for node in tables["force"]])
    assert_allclose(force, body.whole_force[sets["loaded"]])
    assert set(sets["loaded"]) == set(np.flatnonzero(~body.held)), "each free point has weight"
    moves = [[floats(node)[0] for node in tables[f"move_{axis}"]] for axis in "xyz"]
    assert_allclose(np.transpose(moves), body.displacement[sets["moved"]])
    curves = {each.attrib["id"] for each in root.findall("LoadData/load_controller")}
    for value in root.iter("value"):
        assert value.text in tables
        assert value.attrib == {"lc": "1", "type": "map"}
    assert curves == {"1"}


class Node:
    """As much of a node of SOFA's graph as a scene uses."""

    def __init__(self) -> None:
        self.objects: list[tuple[str, dict[str, Any]]] = []
        self.children: dict[str, Node] = {}

    def addObject(self, kind: str, **data: Any) -> None:
        self.objects.append((kind, data))

    def addChild(self, name: str):
        self.children[name] = Node()
        return self.children[name]


def test_sofa_scene_compiles_and_finds_its_mesh(body: Handout, out: Path) -> None:
    text = (out / "scene_sofa.py").read_text()
    assert "ball -- a case" in (ast.get_docstring(ast.parse(text)) or "")
    module: dict[str, Any] = {"__file__": str(out / "scene_sofa.py")}
    exec(compile(text, "scene_sofa.py", "exec"), module)
    root = Node()
    module["createScene"](root)
    objects = dict(root.children["body"].objects)
    assert len(meshio.read(objects["MeshGmshLoader"]["filename"]).points) == len(body.mesh.points)
    law = objects["TetrahedronFEMForceField"]
    assert (law["youngModulus"], law["poissonRatio"]) == (5000.0, 0.49)
    loads, moves = objects["ConstantForceField"], objects["LinearMovementProjectiveConstraint"]
    assert_allclose(loads["forces"], body.whole_force[loads["indices"]])
    assert set(loads["indices"]) == set(np.flatnonzero(~body.held))
    assert moves["movements"][1] == [0.0, 0.002, -0.004]
    held = objects["FixedProjectiveConstraint"]["indices"]
    assert sorted(held + moves["indices"]) == np.flatnonzero(body.held).tolist()


def test_mujoco_scene_holds_masses_forces_and_moves(body: Handout, out: Path) -> None:
    root = ET.parse(out / "scene_mujoco.xml").getroot()
    bodies = root.findall("worldbody/body")
    places = [[float(x) for x in each.attrib["pos"].split()] for each in bodies]
    assert_allclose(places, body.mesh.points, rtol=0, atol=0)
    resting = body.held & ~body.moved
    for k, each in enumerate(bodies):
        assert len(each.findall("joint")) == (0 if resting[k] else 3)
        inertial = each.find("inertial")
        assert (inertial is None) == resting[k]
        assert inertial is None or float(inertial.attrib["mass"]) == pytest.approx(1e6 * body.mass[k])
    force = np.zeros_like(body.force)
    for each in root.findall("actuator/general"):
        joint = each.attrib["joint"]
        force[int(joint[1:-1]), "xyz".index(joint[-1])] = float(each.attrib["biasprm"].split()[0])
    assert_allclose(force, 1e6 * body.force)
    moved = np.zeros_like(body.force)
    for each in root.findall("equality/joint"):
        joint = each.attrib["joint1"]
        moved[int(joint[1:-1]), "xyz".index(joint[-1])] = float(each.attrib["polycoef"].split()[0])
    assert_allclose(moved, body.displacement)
    law = root.find("deformable/flex/elasticity")
    assert (float(law.attrib["young"]), float(law.attrib["poisson"])) == (5e9, 0.49)
    flex = root.find("deformable/flex")
    assert flex.attrib["element"].split() == [str(k) for k in body.mesh.tetrahedra.ravel()]


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        ({"tissue": {"youngs_modulus": 5000.0, "poisson_ratio": 0.5}}, "poisson_ratio below 0.5"),
        ({"anisotropy": {"fibre_direction": [1.0, 0.0, 0.0], "contrast": 2.0}}, "not expressed here: fibres"),
        ({"inclusions": [LUMP]}, "not expressed here: inclusions"),
        ({"constraints": [*STUDY["constraints"], SPRINGS]}, "not expressed here: normal springs"),
    ],
)
def test_what_a_program_cannot_express_is_told(tmp_path: Path, tables: dict[str, Any], told: str) -> None:
    names, refused = write_scene(handed(**tables), tmp_path)
    assert not {"scene.feb", "scene_sofa.py", "scene_mujoco.xml"} & set(names)
    assert len([line for line in refused if told in line]) == 3
    found = json.loads((tmp_path / "scene.json").read_text())
    assert found["left_out"] == (["fibres"] if "anisotropy" in tables else [])
    assert [line for line in refused if told not in line] == [
        f"scene.json: leaves out {part}" for part in found["left_out"]
    ]
    assert len(found["springs"]) == ("springs" in told)
    assert all(part["stiffness"] == 1e5 and part["facets"] for part in found["springs"])
    assert len(found["inclusions"]) == ("inclusions" in told)
    assert all(part["youngs_modulus"] == 9e3 and part["tetrahedra"] for part in found["inclusions"])


def test_export_of_a_study(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("small.toml").write_text(SMALL_STUDY + '[sweep]\n"tissue.poisson_ratio" = [0.3, 0.4]\n')
    asked = ["export", "small.toml", "--to", "out", "--cache", "cache", "--case", "2", "--json"]
    assert do(parse(asked)) == 0
    told = json.loads(capsys.readouterr().out)
    assert "scene.feb" in told["files"]
    assert json.loads(Path("out/scene.json").read_text())["tissue"]["poisson_ratio"] == 0.4
    with pytest.raises(InputError, match="the study has 2 cases"):
        do(parse([*asked[:3], "other", *asked[4:7], "3"]))
    Path("folder").mkdir()
    with pytest.raises(InputError, match="not a run directory"):
        do(parse(["export", "folder", "--to", "other"]))


def test_an_export_under_a_limit_of_file_size_leaves_nothing(
    body: Handout, out: Path, tmp_path: Path
) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for name in ("mesh.vtu", "mesh.msh", "scene_mujoco.xml"):  # each in turn is the first that is too large
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, ((out / name).stat().st_size - 1, limits[1]))
            with (
                pytest.raises(OSError, match=r"too large|is cut"),
                whole_directory(tmp_path / "out") as begun,
            ):
                write_scene(body, begun)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert not list(tmp_path.iterdir())
