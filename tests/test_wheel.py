"""The wheel holds all that the command needs: installed alone, away from this checkout, it runs a study."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest

from tests.command import write_study

ROOT = Path(__file__).parents[1]
SOURCES = (
    "pyproject.toml",
    "README.md",
    "CHANGELOG.md",
    "LICENSE",
    "vdm",
    "fem_reference",
    "solver_common",
    "studies",
    "docs",
    "results",
)


def _has_backend() -> bool:
    """Whether the build backend is installed, so that building needs no network."""
    try:
        return int(version("setuptools").split(".")[0]) >= 77
    except PackageNotFoundError:
        return False


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy: what an earlier build left in a checkout would be packed too."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("runs", "cache", "bench"))
        else:
            shutil.copy(path, source)
    alone = ["--no-build-isolation"] if _has_backend() else []
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        *alone,
        "--wheel-dir",
        out,
        source,
    ]
    subprocess.run(command, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


def test_every_package_and_its_data_is_declared() -> None:
    own = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    homes = {name: ROOT / folder for name, folder in own["package-dir"].items()}
    files = [
        (name, path)
        for name, home in homes.items()
        for path in home.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    ]
    packages = {
        ".".join((name, *path.parent.relative_to(homes[name]).parts))
        for name, path in files
        if path.name == "__init__.py"
    }
    assert set(own["packages"]) == packages
    declared = {
        path
        for package, patterns in own["package-data"].items()
        for pattern in patterns
        for path in homes[package.split(".")[0]].joinpath(*package.split(".")[1:]).glob(pattern)
    }
    assert declared == {path for _, path in files if path.suffix != ".py" and path.name != "README.md"}


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_packages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    about = {name.partition(".dist-info/")[2] for name in names if ".dist-info/" in name}
    documents = {name.partition("share/doc/vdmbench/")[2] for name in names if ".data/data/share/" in name}
    packed = {name for name in names if ".dist-info/" not in name and ".data/" not in name}
    homes = {name: name for name in ("vdm", "fem_reference", "solver_common")} | {"studies": "vdmbench"}
    wanted = {
        f"{package}/{path.relative_to(ROOT / folder).as_posix()}"
        for folder, package in homes.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.name != "README.md"
    }
    assert {"vdmbench/cases/quickstart.toml", "vdmbench/report/templates/page.html", "vdm/py.typed"} <= wanted
    assert packed == wanted
    assert {name.split("/")[0] for name in packed} == set(homes.values()), "nothing called `studies`"
    assert "licenses/LICENSE" in about
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    assert pages | {"README.md", "CHANGELOG.md", "FORMAT.md"} <= documents


@pytest.mark.slow
def test_the_installed_wheel_runs_a_study_away_from_the_checkout(wheel: Path, tmp_path: Path) -> None:
    home, work = tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    venv.create(home, symlinks=True)
    binaries = home / "bin"
    packages = next((home / "lib").glob("python*/site-packages"))
    install = ["install", "--quiet", "--no-deps", "--no-index", wheel]
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def run(*command: str | Path) -> str:
        result = subprocess.run(
            list(map(str, command)), cwd=work, env=environment, capture_output=True, text=True, check=False
        )
        assert result.returncode == 0, f"{command}\n{result.stdout}{result.stderr}"
        return result.stdout

    run(sys.executable, "-m", "pip", "--python", binaries / "python", *install)
    # the other packages; the .pth of an editable vdmbench in there is not followed
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    own = Path(run(binaries / "python", "-c", "import vdmbench; print(vdmbench.__file__)").strip())
    assert own.is_relative_to(packages)
    number = wheel.name.split("-")[1]
    told = run(binaries / "python", "-c", "import vdmbench; print(vdmbench.__version__)")
    assert told == f"{number}\n"
    assert run(binaries / "vdmbench", "--version") == f"vdmbench {number}\n"
    assert "quickstart" in run(binaries / "vdmbench", "list")
    run(binaries / "vdmbench", "check", "quickstart")
    assert "1 done, 0 failed" in run(binaries / "vdmbench", "run", write_study(work))
    assert (work / "results/runs/small/report.html").stat().st_size > 10_000
