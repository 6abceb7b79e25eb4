"""The direction of imports, read from the source."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import vdmbench, write_study

ROOT = Path(__file__).parents[2]
PACKAGES = ("vdm", "fem_reference", "studies")
FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]

COMMAND_LINE = {f"studies/cli{part}.py" for part in ("", "_arguments", "_study", "_results", "_output")}

# each of these is behind one module
BEHIND = {
    "gmsh": {"studies/meshing/geometry.py"},
    "h5py": {"studies/hdf5.py"},
    "meshio": {"studies/meshing/mesh_file.py"},
    "pyvista": {"studies/meshing/remesh.py"},
    "distributed": {"studies/graph/cluster.py"},
    "pyacvd": {"studies/meshing/remesh.py"},
}


def _imports(path: Path) -> set[str]:
    """Absolute dotted names of all that a file imports, wherever in the file."""
    package = path.relative_to(ROOT).parent.parts
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            names |= {f"{module}.{alias.name}" for alias in node.names} | {module}
    return names


def _tops(path: Path) -> set[str]:
    return {name.split(".")[0] for name in _imports(path)}


def _name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _in(package: str) -> list[Path]:
    return [path for path in FILES if _name(path).startswith(f"{package}/")]


def test_there_is_something_to_check() -> None:
    assert len(FILES) > 20
    assert "studies.store" in _imports(ROOT / "studies" / "graph" / "run.py"), "relative imports are resolved"


@pytest.mark.parametrize("path", _in("vdm") + _in("fem_reference"), ids=_name)
def test_the_solver_libraries_stand_alone(path: Path) -> None:
    own = _name(path).split("/")[0]
    assert not _tops(path) & (set(PACKAGES) - {own})
    assert not _tops(path) & {"gmsh", "h5py", "meshio", "pyvista", "json", "pathlib", "pickle", "tomllib"} - (
        {"pathlib"} if _name(path).endswith("memory.py") else set()
    ), "no file I/O"


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_heavy_libraries_are_behind_one_module(path: Path) -> None:
    for library, homes in BEHIND.items():
        if library in _tops(path):
            assert _name(path) in homes, f"{library} is imported by {_name(path)}"


def test_every_home_is_lived_in() -> None:
    for library, homes in BEHIND.items():
        for home in homes:
            assert library in _tops(ROOT / home), f"{home} no longer imports {library}"


@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("metrics", {"studies.surface_measures"}),
        ("surface_measures", {"studies.nearest"}),
        ("nearest", set()),
    ],
)
def test_metrics_are_pure(name: str, own: set[str]) -> None:
    path = ROOT / "studies" / f"{name}.py"
    tops = {top for top in _tops(path) if top not in sys.stdlib_module_names}
    assert tops <= {"numpy", "scipy", "studies"}
    used = {full for full in _imports(path) if full.startswith("studies.") and full.count(".") == 1}
    assert used == own


@pytest.mark.parametrize("path", _in("studies/report"), ids=_name)
def test_the_report_reads_results_only(path: Path) -> None:
    names = _imports(path)
    assert not _tops(path) & {"vdm", "fem_reference", "gmsh", "h5py"}
    for module in ("meshing.geometry", "scene", "models", "worker", "run", "plan", "study_file.config"):
        assert not any(name == f"studies.{module}" or name.startswith(f"studies.{module}.") for name in names)


@pytest.mark.parametrize("name", ["gate", "gate_report"])
def test_the_gate_reads_results_only(name: str) -> None:
    path = ROOT / "studies" / f"{name}.py"
    assert not _tops(path) & {"vdm", "fem_reference", "gmsh", "h5py"}
    assert not {f"studies.{m}" for m in ("meshing.geometry", "scene", "models", "worker", "run")} & _imports(
        path
    )


@pytest.mark.parametrize("path", [p for p in FILES if _name(p) not in COMMAND_LINE], ids=_name)
def test_only_the_command_line_prints_and_exits(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"print", "exit", "quit", "input"}, f"line {node.lineno}"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            assert (node.value.id, node.attr) != ("sys", "exit"), f"line {node.lineno}"
    assert "argparse" not in _tops(path)


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_no_file_grows_past_500_lines(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 500


@pytest.mark.parametrize("path", FILES, ids=_name)
def test_nothing_that_runs_what_it_reads(path: Path) -> None:
    assert not _tops(path) & {"pickle", "marshal", "shelve", "yaml", "dill"}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"eval", "exec", "__import__"}, f"line {node.lineno}"


def test_the_command_heeds_ctrl_c_before_it_loads_anything() -> None:
    code = "import sys; there = set(sys.modules); import studies.cli; print(sorted({*sys.modules} - there))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(result.stdout))
    assert {name for name in loaded if name.startswith("studies")} == {"studies", "studies.cli"}
    assert not loaded & {"argparse", "pathlib", "typing", "traceback"}


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, contextlib\n"
        "from studies.cli import main\n"
        "with contextlib.suppress(SystemExit): main(['--help'])\n"
        "print(sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "verbs" in result.stdout
    heavy = {
        "numpy",
        "scipy",
        "skfem",
        "gmsh",
        "meshio",
        "pyvista",
        "vtkmodules",
        "h5py",
        "matplotlib",
        "pydantic",
        "distributed",
    }
    assert not heavy & set(ast.literal_eval(result.stderr))


def test_the_report_starts_without_solvers_and_scipy() -> None:
    code = "import sys, studies.report.page; print(sorted({name.split('.')[0] for name in sys.modules}))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"scipy", "vdm", "fem_reference", "gmsh", "vtkmodules"} & set(ast.literal_eval(result.stdout))


def test_what_only_plans_and_reports_starts_without_the_libraries_of_those_who_compute() -> None:
    """The runner of a study leaves meshing and solving to its workers; each library costs it up to a second."""
    code = (
        "import sys\n"
        "from studies.study_file.config import expand, load_study\n"
        "import studies.graph.run, studies.graph.plan, studies.report.page, pathlib, tempfile\n"
        "study = load_study(pathlib.Path('studies/cases/quickstart.toml'))\n"
        "with tempfile.TemporaryDirectory() as name:\n"
        "    where = pathlib.Path(name)\n"
        "    plan = studies.graph.plan.make_plan(study, expand(study), where, where)\n"
        "    assert studies.graph.run.summary(plan)\n"
        "print(sorted({name.split('.')[0] for name in sys.modules}))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    solving = {"scipy", "skfem", "pyamg", "vdm"}
    heavy = solving | {"gmsh", "meshio", "pyvista", "vtkmodules", "pint"}
    assert not heavy & set(ast.literal_eval(result.stdout))


def test_a_run_that_has_nothing_left_to_do_loads_no_solver_and_starts_no_process(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    assert vdmbench("run", study, "--out", "run", cwd=tmp_path).returncode == 0
    code = (
        "import sys, contextlib\n"
        "from studies.cli import main\n"
        "with contextlib.suppress(SystemExit): main(sys.argv[1:])\n"
        "print(sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code, "run", str(study), "--out", "run"],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    modules = ast.literal_eval(result.stderr)
    assert "1 done, 0 failed" in result.stdout
    assert not {"scipy", "skfem", "pyamg", "vdm", "gmsh", "rich", "pebble"} & set(modules)


def test_making_a_solid_starts_no_renderer() -> None:
    code = "import sys, studies.meshing.geometry; print(sorted({name.split('.')[0] for name in sys.modules}))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"pyvista", "vtkmodules", "pyacvd", "matplotlib", "meshio", "rich"} & set(
        ast.literal_eval(result.stdout)
    )
