"""The command line on good days and bad ones: exit codes, one clear line, nothing lost."""

import fcntl
import json
import shutil
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.command import heed_ctrl_c, vdmbench, write_study
from tests.report.runs import icosphere
from vdmbench.measures.metrics import METRICS
from vdmbench.store import cases as store

pytestmark = pytest.mark.usefixtures("read_here")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a study of two cases, run once."""
    directory = tmp_path_factory.mktemp("finished")
    write_study(directory, sweep=("[load]", '[sweep]\n"tissue.poisson_ratio" = [0.45, 0.49]\n[load]'))
    result = vdmbench("run", "small.toml", cwd=directory)
    assert result.returncode == 0, result.stderr
    return directory


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """The same, to be broken."""
    return Path(shutil.copytree(finished, tmp_path / "copy"))


RUN = Path("results/runs/small")


def test_a_run_leaves_all_that_the_contract_names(finished: Path) -> None:
    run = finished / RUN
    for name in ("study.toml", "resolved.toml", "plan.json", "metrics.csv", "report.html"):
        assert (run / name).stat().st_size > 0, name
    assert len(list((run / "cases").glob("*.vtkhdf"))) == 2
    assert len(list((finished / "results/cache/meshes").glob("*.npz"))) == 1, "both cases share a mesh"
    assert (run / "study.toml").read_text() == (finished / "small.toml").read_text()


def test_only_what_is_missing_is_run(copy: Path) -> None:
    cases = sorted((copy / RUN / "cases").iterdir())
    kept = cases[1].stat().st_mtime_ns
    cases[0].unlink()
    assert "results/runs/small: 1 missing, 1 done\n" in vdmbench("plan", "small.toml", cwd=copy).stdout
    assert vdmbench("run", "small.toml", cwd=copy).returncode == 0
    assert cases[0].exists()
    assert cases[1].stat().st_mtime_ns == kept
    assert "to run: 0 cases, 0 meshes" in vdmbench("plan", "small.toml", cwd=copy).stdout
    assert "done " not in vdmbench("run", "small.toml", cwd=copy).stderr, "no case is run again"


def test_fresh_runs_everything_again_as_planned(copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (copy / RUN / "cases").iterdir()}
    first = json.loads((copy / RUN / "plan.json").read_text())
    assert json.loads(vdmbench("plan", "small.toml", "--json", cwd=copy).stdout)["work"] == []
    plan = json.loads(vdmbench("plan", "small.toml", "--fresh", "--json", cwd=copy).stdout)
    assert (plan["cases_to_run"], plan["meshes_to_make"]) == (2, 0)
    told = vdmbench("plan", "small.toml", "--fresh", cwd=copy).stdout.partition("still to solve")[2]
    assert [line.split()[0] for line in told.splitlines()[1:]] == ["vdm-paper", "fem-linear"]
    assert vdmbench("run", "small.toml", "--fresh", cwd=copy).returncode == 0
    assert json.loads((copy / RUN / "plan.json").read_text())["work"] == plan["work"] == first["work"]
    after = {path: path.stat().st_mtime_ns for path in (copy / RUN / "cases").iterdir()}
    assert after.keys() == before.keys()
    assert all(after[path] > before[path] for path in before)


def test_the_report_is_rebuilt_from_a_copied_directory(copy: Path, tmp_path: Path) -> None:
    elsewhere = Path(shutil.copytree(copy / RUN, tmp_path / "elsewhere"))
    (elsewhere / "report.html").unlink()
    result = vdmbench("report", "elsewhere", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert (elsewhere / "report.html").stat().st_size > 10_000
    rows = json.loads(vdmbench("report", "elsewhere", "--json", cwd=tmp_path).stdout)
    verdict = rows["verdicts"]["vdm-printed"]
    assert verdict["word"] in ("yes", "no")
    assert f"VDM as printed: {verdict['word']}. vdm-paper: " in result.stdout
    assert verdict["limits"][0]["key"] == "displacement_error"
    assert list(rows["metrics"]) == ["vdm-paper", "fem-linear"]
    errors = [
        case.metrics["vdm-paper"]["relative_l2_displacement_error"][-1]
        for case in store.read_run(elsewhere).cases
    ]
    told = rows["metrics"]["vdm-paper"]["relative_l2_displacement_error"]
    assert told["value"] == pytest.approx(np.mean(errors), rel=1e-12), "which is the median of two"
    assert (told["worst"], told["unit"]) == (max(errors), "1")


def balls(directory: Path, **radii: float) -> None:
    """A study without a reference, and folders with a surface `ball.obj` of these radii [m]."""
    models = ('["vdm-paper", "fem-linear"]', '["vdm-paper"]')
    write_study(directory, a=models, b=('reference = "fem-linear"\n', ""))
    points, triangles = icosphere(3)
    for name, radius in radii.items():
        (directory / name).mkdir()
        meshio.Mesh(radius * points, [("triangle", triangles)]).write(directory / name / "ball.obj")


def test_a_surface_has_a_directory_of_its_own_and_its_report_says_how_to_get_it_again(tmp_path: Path) -> None:
    balls(tmp_path, scans=0.05)
    command = "vdmbench run small.toml --surface scans/ball.obj"
    for extra, place in (("", "results/runs/small-ball"), (" --out elsewhere", "elsewhere")):
        result = vdmbench(*f"{command}{extra}".split()[1:], cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        page = (tmp_path / place / "report.html").read_text()
        assert f"vdmbench run small.toml --surface ball.obj{extra}\nvdmbench report {place}<" in page
        assert "geometry file: ball.obj\n" in page
        assert str(tmp_path) not in page
    plan = vdmbench("plan", *command.split()[2:], "--json", cwd=tmp_path)
    assert json.loads(plan.stdout)["cases_to_run"] == 0, "the same command finds its results"
    assert not (tmp_path / RUN).exists(), "the study's own results are not touched"
    accepted = vdmbench("accept", "results/runs/small-ball", "--reason", "first", cwd=tmp_path)
    assert accepted.stdout == "accepted 1 case: results/baselines/small-ball.json\n"
    assert " unchanged " in vdmbench("gate", "elsewhere", cwd=tmp_path).stdout


def test_a_surface_of_the_same_file_name_does_not_overwrite_the_results_of_another(tmp_path: Path) -> None:
    balls(tmp_path, a=0.05, b=0.06)
    shutil.copytree(tmp_path / "a", tmp_path / "copy")
    command = ("small.toml", "--surface")
    assert vdmbench("run", *command, "a/ball.obj", cwd=tmp_path).returncode == 0
    first = (tmp_path / "results/runs/small-ball/report.html").read_bytes()
    for verb in ("plan", "run", "calibrate"):
        refused = vdmbench(verb, *command, "b/ball.obj", cwd=tmp_path)
        assert refused.returncode == 2
        assert "holds the results of another surface of that name; choose another --out" in refused.stderr
    assert (tmp_path / "results/runs/small-ball/report.html").read_bytes() == first
    assert vdmbench("run", *command, "b/ball.obj", "--out", "other", cwd=tmp_path).returncode == 0
    moved = vdmbench("plan", *command, "copy/ball.obj", "--json", cwd=tmp_path)
    assert json.loads(moved.stdout)["cases_to_run"] == 0, "a copy of it is the same surface"


# --- mistakes ---


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "required"),
        (["fly"], "invalid choice"),
        (["run"], "required"),
        (["run", "small.toml", "--jobs", "0"], "1 or more"),
        (["run", "small.toml", "--jobs", "many"], "--jobs: must be a whole number of 1 or more, not 'many'"),
        (["run", "small.toml", "--shard", "3/2"], "1 <= I <= N"),
        (["run", "small.toml", "--timeout", "-1"], "more than 0"),
        (["run", "small.toml", "--timeout", "nan"], "must be a number of seconds of more than 0, not 'nan'"),
        (["run", "sphere"], 'unknown study "sphere"; known: '),
        (["export", "results/runs/nope", "--to", "out"], '"results/runs/nope": there is no such file or dir'),
        (["run", "none/small.toml"], '"none/small.toml": there is no such file or directory\n'),
        (["check", "small.toml", "--surface", "none.stl"], "small.toml:8: geometry.path: "),
    ],
)
def test_usage_mistakes(tmp_path: Path, arguments: list[str], words: str) -> None:
    write_study(tmp_path)
    result = vdmbench(*arguments, cwd=tmp_path)
    assert result.returncode == 2
    assert words in result.stderr
    assert not (tmp_path / "results").exists(), "nothing was begun"


def test_a_mesh_that_cannot_be_made_is_found_before_the_run(tmp_path: Path) -> None:
    write_study(tmp_path, a=('"16 mm"', '"0.05 mm"'))
    for verb in ("check", "plan", "run", "bench"):
        result = vdmbench(verb, "small.toml", cwd=tmp_path)
        assert result.returncode == 2, verb
        assert result.stderr.startswith("vdmbench: small.toml:11: geometry.mesh_size: ")
        assert "nodes" in result.stderr


def test_a_bad_case_costs_itself_only(tmp_path: Path) -> None:
    # at 3 degrees no facet of the coarse mesh lies in the cap
    write_study(tmp_path, a=("[load]", '[sweep]\n"regions.finger.cap.angle" = ["2 deg", "30 deg"]\n[load]'),
                b=('profile = "hertz"', 'profile = "uniform"'))  # fmt: skip
    result = vdmbench("run", "small.toml", cwd=tmp_path)
    assert result.returncode == 3
    assert "1 done, 1 failed, 0 missing" in result.stdout
    assert "finger" in result.stderr
    assert (tmp_path / RUN / "report.html").exists()
    assert "small: 1 failed, 1 done\n" in vdmbench("plan", "small.toml", cwd=tmp_path).stdout
    # the failure is tried again, the success is not
    again = vdmbench("run", "small.toml", cwd=tmp_path)
    assert again.returncode == 3
    assert again.stderr.count("failed angle") == 1
    assert "done angle" not in again.stderr


def test_damage_is_named_and_mended(copy: Path) -> None:
    case = sorted((copy / RUN / "cases").iterdir())[0]
    case.write_bytes(case.read_bytes()[:5000])
    assert "small: 1 damaged, 1 done\n" in vdmbench("plan", "small.toml", cwd=copy).stdout
    report = vdmbench("report", RUN, cwd=copy)
    assert report.returncode == 5
    assert case.name in report.stderr
    assert "1 damaged" in report.stdout, "the others are reported"
    page = (copy / RUN / "report.html").read_text()
    assert "1 damaged" in page
    assert case.name in page
    assert vdmbench("run", "small.toml", cwd=copy).returncode == 0, "run makes it anew"


def test_a_directory_without_a_run(tmp_path: Path) -> None:
    for directory in (tmp_path, tmp_path / "mistyped", "x" * 300):
        result = vdmbench("report", directory, cwd=tmp_path)
        assert result.returncode == 2, "the command is wrong, no result is damaged"
        assert "not a run directory" in result.stderr
        assert "Traceback" not in result.stderr


def test_a_shard_and_a_run_of_the_whole_exclude_each_other(copy: Path) -> None:
    with (copy / RUN / ".lock").open("a+") as file:
        fcntl.flock(file, fcntl.LOCK_SH)  # as a shard holds it
        assert vdmbench("run", "small.toml", "--shard", "2/2", cwd=copy).returncode == 0
        whole = vdmbench("run", "small.toml", cwd=copy)
        assert whole.returncode == 2
        assert "another run is at work here" in whole.stderr
        fcntl.flock(file, fcntl.LOCK_EX)  # as a run of the whole study holds it
        shard = vdmbench("run", "small.toml", "--shard", "1/2", cwd=copy)
        assert shard.returncode == 2
        assert "another run is at work here" in shard.stderr


def test_results_that_cannot_be_written(tmp_path: Path) -> None:
    write_study(tmp_path)
    (tmp_path / "results").write_text("a file where a directory should be")
    result = vdmbench("run", "small.toml", cwd=tmp_path)
    assert result.returncode == 4
    assert "results" in result.stderr
    result = vdmbench("run", "small.toml", "--out", "results", cwd=tmp_path)
    assert result.returncode == 4
    assert result.stderr == "vdmbench: results: is not a directory; remove it, or choose another\n"


def interruptible(program: str, directory: Path) -> subprocess.CompletedProcess[str]:
    """A Python program that heeds Ctrl-C, run to its end."""
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=directory,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=heed_ctrl_c,
    )


@pytest.mark.parametrize(
    ("module", "error"),
    [("argparse", "SyntaxError"), ("numpy", "ImportError")],
)
def test_ctrl_c_in_an_import(tmp_path: Path, module: str, error: str) -> None:
    """Whatever it comes out as: Python makes another error of it where it falls into the reading of a module."""
    write_study(tmp_path)
    program = (
        "import signal, sys\n"
        "class Importer:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            sys.meta_path.remove(self)\n"
        "            try:\n"
        "                signal.raise_signal(signal.SIGINT)\n"
        "            except KeyboardInterrupt:\n"
        f"                raise {error}('no') from None\n"
        "from vdmbench.cli.main import main\n"
        "sys.meta_path.insert(0, Importer())\n"
        "main(['check', 'small.toml'])"
    )
    result = interruptible(program, tmp_path)
    assert result.returncode == 130, result.stderr
    assert result.stderr.startswith("vdmbench: interrupted; ")
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "interrupted",
    [
        # twice, the second time while the command ends
        "atexit.register(signal.raise_signal, signal.SIGINT); signal.raise_signal(signal.SIGINT)",
        # what tidies up is left to do so
        "try: signal.raise_signal(signal.SIGINT)\n    finally: print('tidy')",
    ],
)
def test_ctrl_c_at_an_awkward_moment(tmp_path: Path, interrupted: str) -> None:
    program = (
        "import atexit, signal\n"
        "from vdmbench.cli import main as cli\n"
        "from vdmbench.cli.arguments import verbs\n"
        f"def verb(options):\n    {interrupted}\n"
        "verbs()['run'] = verbs()['run']._replace(do=verb)\n"
        "cli.main(['run', 'small.toml'])"
    )
    result = interruptible(program, tmp_path)
    assert result.returncode == 130
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == "tidy\n" * ("tidy" in interrupted)


def test_no_reference_no_volume(tmp_path: Path) -> None:
    write_study(
        tmp_path, a=('["vdm-paper", "fem-linear"]', '["vdm-paper"]'), b=('reference = "fem-linear"\n', "")
    )
    result = vdmbench("run", "small.toml", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    case = store.read_run(tmp_path / RUN).cases[0]
    assert case.reference is None
    assert case.mesh_quality["tetrahedra"] == 0
    alone = {m.name for m in METRICS.values() if not (m.needs_reference or m.needs_measurement)}
    assert {"volume_drift", "mean_strain_x"} <= alone
    assert set(case.metrics["vdm-paper"]) == alone


def test_a_surface_that_bounds_nothing_is_a_mistake_of_the_input(tmp_path: Path) -> None:
    write_study(tmp_path, a=('shape = "sphere"\nradius = "50 mm"', 'shape = "file"\npath = "open.obj"'))
    facets = ["v 0 0 0", "v 0.1 0 0", "v 0 0.1 0", "v 0 0 0.1", "f 1 3 2", "f 1 2 4", "f 1 4 3"]
    (tmp_path / "open.obj").write_text("\n".join(facets))
    for verb in ("check", "plan", "run"):
        result = vdmbench(verb, "small.toml", cwd=tmp_path)
        assert result.returncode == 2, verb
        (complaint,) = (line for line in result.stderr.splitlines() if line.startswith("vdmbench:"))
        assert "open.obj: the surface is open" in complaint
        if verb != "run":
            assert "small.toml:10: geometry.path: " in complaint
    (problem,) = json.loads(vdmbench("check", "small.toml", "--json", cwd=tmp_path).stdout)["problems"]
    assert (problem["line"], problem["key"]) == (10, "geometry.path")


def test_a_model_that_refuses_a_case_says_why(tmp_path: Path) -> None:
    # the printed form of VDM stands on its own foundation, elements do not
    write_study(tmp_path, a=('kind = "fixed"\nregion = "base"\n[[constraints]]\n', ""),
                b=('reference = "fem-linear"', 'reference = "vdm-paper"'))  # fmt: skip
    result = vdmbench("check", "small.toml", cwd=tmp_path)
    assert result.returncode == 0
    assert "will be refused: fem-linear: nothing is held" in result.stdout
    result = vdmbench("run", "small.toml", cwd=tmp_path)
    assert result.returncode == 0
    assert "done small (" in result.stderr, "the only case goes by the study's name"
    told = (
        "stopped: fem-linear (the only case, load factor 0.5): nothing is held, so the body can move freely; "
    )
    assert told in " ".join(result.stdout.split())
    assert "\n1 done, 0 failed" in result.stdout
