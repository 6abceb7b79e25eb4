"""The house: arrows between rooms go one way, libraries stand alone, and what starts loads what it needs."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import vdm.material
import vdm.peers.mass_spring
import vdm.solution
from tests.command import vdmbench, write_study
from tests.report.runs import icosphere
from vdm.material import Parameters
from vdm.surface import SurfaceMesh
from vdmbench import models
from vdmbench.study.errors import LIBRARIES as SHARED_LIBRARIES

ROOT = Path(__file__).parents[1]
LIBRARIES = {"solver_common", "vdm", "fem_reference"}
PACKAGES = (*sorted(LIBRARIES), "studies")
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]

# in the order in which data flows: each may import those before it
ROOMS = (
    "machine",
    "study",
    "body",
    "scene",
    "models",
    "measures",
    "store",
    "work",
    "verdict",
    "report",
    "gate",
    "bench",
    "calibrate",
    "claims",
    "cli",
)
MOST_FLOORS = 8
NOT_ALLOWED = {"report": {"work"}, "gate": {"graph", "models", "scene", "report"}}
# each of these is behind one module
BEHIND = {
    "gmsh": {"studies/body/geometry.py", "studies/body/mesh_file.py"},
    "h5py": {"studies/store/hdf5.py"},
    "meshio": {"studies/body/mesh_file.py"},
    "pyvista": {"studies/body/remesh.py"},
    "distributed": {"studies/work/cluster.py"},
    "pyacvd": {"studies/body/remesh.py"},
    "trimesh": {"studies/body/mesh_file.py"},
    "vtkmodules": {"studies/body/nearest.py", "studies/body/mesh_file.py"},
}


@cache
def _nodes(path: Path) -> list[ast.AST]:
    """All of a file."""
    return list(ast.walk(ast.parse(path.read_text())))


def _told(path: Path) -> set[ast.AST]:
    """What of it is for types alone."""
    tests = [(node, node.test) for node in _nodes(path) if isinstance(node, ast.If)]
    checked = [node for node, test in tests if isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"]
    return {inner for node in checked for part in node.body for inner in ast.walk(part)}


@cache
def _imports(path: Path, *, types: bool = False) -> frozenset[str]:
    """Absolute dotted names of all that a file imports, wherever in the file: when it runs, or for `types` too."""
    package = ("vdmbench", *path.relative_to(ROOT).parent.parts[1:])
    names, left_out = set(), set() if types else _told(path)
    for node in _nodes(path):
        if node in left_out:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            names |= {f"{module}.{alias.name}" for alias in node.names} | {module}
    return frozenset(names)


def _tops(path: Path) -> set[str]:
    return {name.split(".")[0] for name in _imports(path)}


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _rooms(path: Path) -> set[str]:
    """The rooms that a file imports from, for its types too, and the libraries."""
    parts = [name.split(".") for name in _imports(path, types=True)]
    libraries = {part[0] for part in parts} & LIBRARIES
    return {part[1] for part in parts if part[0] == "vdmbench" and len(part) > 1} | libraries


def test_every_room_says_what_goes_in_and_out() -> None:
    there = {path.parent.name for path in (ROOT / "studies").glob("*/__init__.py")}
    alone = {path.stem for path in (ROOT / "studies").glob("*.py")} - {"__init__", "api"}
    assert there | alone == set(ROOMS)
    for room in ROOMS:
        first = next(path for path in _files(room) if path.name in ("__init__.py", f"{room}.py"))
        assert ast.get_docstring(ast.parse(first.read_text()))


def _files(room: str) -> list[Path]:
    """Those of a folder, or the one module that a small room is."""
    home = ROOT / (room if room in LIBRARIES else f"studies/{room}")
    return sorted(home.rglob("*.py")) or [home.with_suffix(".py")]


def test_arrows_go_one_way() -> None:
    for k, room in enumerate(ROOMS):
        before = LIBRARIES | set(ROOMS[: k + 1]) - NOT_ALLOWED.get(room, set())
        for path in _files(room):
            assert _rooms(path) <= before, _name(path)


def _floors() -> dict[str, int]:
    """Floor of each room and library: above all that it imports, the lowest 1."""
    below = {
        room: {other for path in _files(room) for other in _rooms(path) - {room}}
        for room in (*ROOMS, *LIBRARIES)
    }
    floors: dict[str, int] = {}
    for room in TopologicalSorter(below).static_order():
        floors[room] = 1 + max((floors[other] for other in below[room]), default=0)
    return floors


def test_the_house_has_no_more_floors() -> None:
    """A room that takes a small thing from its neighbour can add one: put that where both may take it."""
    floors = _floors()
    assert floors["study"] == floors["machine"] == 1 < floors["vdm"]
    assert max(floors.values()) <= MOST_FLOORS, floors


def test_the_solver_libraries_share_one_small_package_and_nothing_else() -> None:
    assert (
        sum(len(path.read_text().splitlines()) for path in FILES if path.parts[-2] == "solver_common") < 400
    )
    for path in (path for path in FILES if not _name(path).startswith("studies/")):
        own = {_name(path).split("/")[0], "solver_common"}
        assert not _tops(path) & ({"solver_common", "vdm", "fem_reference", "vdmbench"} - own), _name(path)
        files = {"gmsh", "h5py", "meshio", "pyvista", "json", "pathlib", "pickle", "tomllib"}
        assert not _tops(path) & files - ({"pathlib"} if _name(path).endswith("memory.py") else set()), path


def test_no_form_of_vdm_knows_its_peers() -> None:
    for path in sorted((ROOT / "vdm").glob("formulations/*.py")):
        assert not any(
            name.startswith(("vdm.peers", "vdm.boundary")) for name in _imports(path, types=True)
        ), path


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(("vdmbench" if parts[0] == "studies" else parts[0], *parts[1:])).removesuffix(".__init__")


def test_no_files_import_each_other_in_a_circle() -> None:
    """For their types alone either: who reads the one has to know the other."""
    files = {_module(path): path for path in FILES}
    arrows = {name: (_imports(path, types=True) & files.keys()) - {name} for name, path in files.items()}
    assert "solver_common.arrays" in arrows["fem_reference.mesh"]
    packages = {
        name for name, path in files.items() if path.name == "__init__.py"
    }  # the name before a submodule's
    TopologicalSorter({name: below - packages for name, below in arrows.items()}).prepare()


def test_heavy_libraries_are_behind_one_module() -> None:
    for library, homes in BEHIND.items():
        assert {_name(path) for path in FILES if library in _tops(path)} == homes


def test_only_the_command_line_exits() -> None:
    """That it alone prints is a rule of ruff."""
    for path in FILES:
        if not _name(path).startswith("studies/cli/"):
            assert "argparse" not in _tops(path), path
            assert "sys.exit" not in path.read_text(), path


def test_nothing_that_runs_what_it_reads() -> None:
    for path in FILES:
        assert not _tops(path) & {"pickle", "marshal", "shelve", "yaml", "dill"}, path
        for node in _nodes(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in {"eval", "exec", "__import__"}, f"{path}, line {node.lineno}"


def test_no_file_grows_past_850_lines() -> None:
    assert {_name(path) for path in FILES if len(path.read_text().splitlines()) > 850} == set()


def test_the_command_heeds_ctrl_c_before_it_loads_anything() -> None:
    code = "import sys; there = set(sys.modules); import vdmbench.cli.main; print(sorted({*sys.modules} - there))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(result.stdout))
    assert {name for name in loaded if name.startswith("vdmbench")} == {
        "vdmbench",
        "vdmbench.cli",
        "vdmbench.cli.main",
    }
    assert not loaded & {"argparse", "pathlib", "typing", "traceback"}


def _loaded(*code: str, directory: Path = ROOT) -> tuple[set[str], str]:
    """The modules that a Python program has loaded in the end, and what it prints."""
    program = "\n".join(["import contextlib, sys", *code, "print(sorted(sys.modules), file=sys.stderr)"])
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=directory
    )
    return set(ast.literal_eval(ended.stderr)), ended.stdout


def _loaded_by(*arguments: str, directory: Path = ROOT) -> tuple[set[str], str]:
    """The same of a command line."""
    run = f"with contextlib.suppress(SystemExit): main({list(arguments)!r})"
    return _loaded("from vdmbench.cli.main import main", run, directory=directory)


SOLVING = {"scipy", "skfem", "pyamg", "vdm.model"}
DRAWING = {"pyvista", "vtkmodules", "pyacvd", "matplotlib"}
PLAN = """\
import pathlib, tempfile
import vdmbench.work.run, vdmbench.work.plan, vdmbench.report.page
from vdmbench.study.config import load_study
study = load_study(pathlib.Path('studies/cases/quickstart.toml'))
with tempfile.TemporaryDirectory() as name:
    where = pathlib.Path(name)
    plan = vdmbench.work.plan.make_plan(study, where, where)
    assert vdmbench.work.run.summary(plan)"""


@pytest.mark.parametrize(
    ("code", "others"),
    [
        ("import vdmbench.body.geometry", DRAWING | {"meshio"}),
        (PLAN, SOLVING | {"gmsh", "meshio", "pyvista", "vtkmodules", "pint"}),
    ],
    ids=["body", "plan"],
)
def test_what_starts_leaves_the_libraries_of_others_alone(code: str, others: set[str]) -> None:
    """Each costs up to a second; the runner of a study leaves meshing and solving to its workers."""
    loaded = _loaded(code)[0]
    assert not others & loaded
    of_solvers = {name for name in loaded if name.split(".")[0] in ("vdm", "fem_reference")}
    assert of_solvers <= {"vdm", "vdm.solvers", "fem_reference", "fem_reference.costs"}, "names and costs"


def test_help_loads_nothing_heavy() -> None:
    modules, told = _loaded_by("--help")
    assert "verbs" in told
    heavy = DRAWING | SOLVING | {"numpy", "gmsh", "meshio", "h5py", "pydantic", "distributed"}
    assert not heavy & modules


def test_a_run_that_has_nothing_left_to_do_loads_no_solver(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    assert vdmbench("run", study, "--out", "run", cwd=tmp_path).returncode == 0
    modules, told = _loaded_by("run", str(study), "--out", "run", directory=tmp_path)
    assert "1 done, 0 failed" in told
    assert not (SOLVING | {"gmsh", "matplotlib"}) & modules


def test_check_loads_no_results_and_a_mesher_once(tmp_path: Path) -> None:
    write_study(tmp_path, a=('reference = "fem-linear"\n', ""))
    for known in (False, True):
        modules, told = _loaded_by("check", "small.toml", directory=tmp_path)
        assert told == "small.toml: ok, 1 case\n"
        assert not {"scipy", "h5py", "pint", "vdmbench.store.cases", "vdmbench.measures.case"} & modules
        assert ("gmsh" in modules) is not known


# --- what is written twice for a reason, held together ---


def test_a_registered_model_declares_what_its_library_says() -> None:
    """Without loading it: a plan has to be quick."""
    body = SurfaceMesh(*icosphere(1))
    surface = {name: model for name, model in models.all_models().items() if not model.volumetric}
    rules = {name.removeprefix("vdm-"): model.by_rule for name, model in surface.items()}
    assert rules == {name: tuple(Parameters.from_tissue(1.0, body, name).moduli()) for name in rules}
    assert {name.removeprefix("vdm-") for name, m in surface.items() if "fibres" not in m.takes} == set(
        vdm.material.ISOTROPIC
    )
    assert models.find("mass-spring")[0].most_nodes["linear"] == vdm.peers.mass_spring.MAX_NODES


def test_make_installs_the_libraries_that_an_error_names() -> None:
    """`make` looks for them before there is a Python environment to ask."""
    makefile = (ROOT / "Makefile").read_text()
    assert tuple(re.findall(r'"lib[^"]+\.so\.\d+": "([^"]+)"', makefile)) == SHARED_LIBRARIES


def test_what_is_required_is_pinned() -> None:
    pinned = set(
        re.findall(r"^([A-Za-z0-9_.-]+)==", (ROOT / "constraints.txt").read_text(), flags=re.MULTILINE)
    )
    normal = {name.lower().replace("_", "-") for name in pinned}
    wanted = re.findall(r'^ +"([A-Za-z0-9-]+)>=', (ROOT / "pyproject.toml").read_text(), flags=re.MULTILINE)
    assert len(wanted) > 15
    assert {name.lower() for name in wanted} <= normal


def test_only_dates_that_are_shown_come_from_the_clock() -> None:
    """No module asks a clock that can jump, nor the age of a file, but for the date of a result or a baseline."""
    asks = re.compile(r"\btime\.(time|ctime|localtime|gmtime)(_ns)?\(|st_[mca]time|getmtime|\.now\(|today\(")
    found = {
        str(path.relative_to(ROOT)): asks.findall(path.read_text())
        for package in ("studies", "vdm", "fem_reference", "solver_common")
        for path in (ROOT / package).rglob("*.py")
        if asks.search(path.read_text())
    }
    assert {name: len(hits) for name, hits in found.items()} == {
        "studies/work/provenance.py": 1,
        "studies/gate.py": 1,
    }
