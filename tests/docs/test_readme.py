"""README.md is true: its commands run, its table is what they print, its links lead somewhere."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.command import vdmbench
from tests.comparing import compare
from tests.docs import marked, regenerate
from vdmbench import models
from vdmbench.body.geometry import build_mesh
from vdmbench.body.surface_measures import Surface, enclosed_volume
from vdmbench.cli.study_verbs import SHIPPED
from vdmbench.report.verdict_load import MOST_DRIFT, MOST_MOVED
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import expand, geometry_of, load_study

TEXT = regenerate.README.read_text()
ONE_LINE = " ".join(TEXT.split())


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


def test_the_result_table_is_what_the_command_prints_and_a_notebook_reads_it(tmp_path: Path) -> None:
    table = regenerate.headline_table(tmp_path)
    assert table == marked.shown(regenerate.README, regenerate.PART), "run `make docs` and look at it"
    (notebook,) = blocks("python")
    code = f"import pyvista\npyvista.OFF_SCREEN = True\n{notebook}\nprint(*error, *ratio, case.n_points)"
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    *numbers, nodes = (float(word) for word in told.stdout.split())
    assert sorted(numbers[6:]) == [0.45, 0.45, 0.49, 0.49, 0.4999, 0.4999]
    worst = next(row for row in marked.cells(table) if row[0] == "vdm-vector")[1].split("worst ")[1]
    assert f"{100 * max(numbers[:6]):.1f} %" == worst.replace("\u00a0", " ")
    assert nodes == 487
    (reading,) = re.findall(
        r"```python\n(.*?)```", (regenerate.ROOT / "results/FORMAT.md").read_text(), re.DOTALL
    )
    told = subprocess.run(
        [sys.executable, "-c", f"{reading}\nprint(*error, *u.shape)"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    )
    errors, shape = told.stdout.split()[:-3], told.stdout.split()[-3:]
    assert 0.7 < float(errors[-1]) < 0.8, "of vdm-paper, as in the table"
    assert shape == [str(len(errors)), "487", "3"]


def test_the_first_study_and_its_commands(tmp_path: Path) -> None:
    (study,) = blocks("toml")
    assert len(study.splitlines()) <= 10, "ten lines were promised"
    (tmp_path / "mine.toml").write_text(study)
    (commands,) = (block for block in blocks("sh") if "check mine.toml" in block)
    for line in commands.splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "vdmbench"
        result = vdmbench(*words[1:], cwd=tmp_path)
        assert result.returncode == 0, f"{line}\n{result.stderr}"
    assert (tmp_path / "results/runs/mine/report.html").exists()
    found = json.loads(vdmbench("report", "results/runs/mine", "--json", cwd=tmp_path).stdout)
    assert list(found["metrics"]) == [
        "vdm-paper",
        "vdm-vector",
        "vdm-boundary",
        "fem-linear",
        "fem-linear refined",
    ]
    error = found["metrics"]["vdm-boundary"]["relative_l2_displacement_error"]
    assert 0 < error["bar"] < error["value"] < 0.1, "a usable model, and an error bar that tells so"


def test_a_surface_of_ones_own(tmp_path: Path, liver: Path) -> None:
    (command,) = (block for block in blocks("sh") if "--surface" in block)
    words = shlex.split(command, comments=True)
    (tmp_path / "liver.obj").write_bytes(liver.read_bytes())
    assert vdmbench("check", *words[2:], cwd=tmp_path).returncode == 0
    plan = json.loads(vdmbench("plan", *words[2:], "--json", cwd=tmp_path).stdout)
    assert plan["cases_to_run"] == 1


def test_the_coarse_elements_on_a_ball_and_on_its_mirror_image() -> None:
    study = expand(load_study(SHIPPED / "quickstart.toml"))[0].study
    mesh = build_mesh(geometry_of(study))
    mirrored = dataclasses.replace(
        mesh,
        points=mesh.points * [-1.0, 1.0, 1.0],
        tetrahedra=mesh.tetrahedra[:, [1, 0, 2, 3]],
        triangles=mesh.triangles[:, ::-1].copy(),
    )
    told = []
    for body in (mesh, mirrored):
        scene = build_scene(study, body)
        results = {name: models.run_model(scene, name) for name in ("fem-coarse", "fem-linear")}
        series = compare(scene, results, "fem-linear")["fem-coarse"]["relative_l2_displacement_error"]
        told.append(f"{series.values[-1]:.0%}".replace("%", " %"))
    assert f"{told[0]} on the quickstart's ball and {told[1]} on its mirror image" in TEXT


def test_what_the_volume_drift_of_elements_is_made_of() -> None:
    """The tissue's compression from the mean pressure, the rest from the first order of the polyhedron's volume."""

    def parts(ratio: float, mesh_size: float) -> tuple[float, float, float, float]:
        (study,) = (
            case.study
            for case in expand(load_study(SHIPPED / "quickstart.toml"))
            if case.swept == {"constraints.finger.force": 0.4, "tissue.poisson_ratio": ratio}
        )
        geometry = study.geometry.model_copy(update={"mesh_size": mesh_size})
        study = study.model_copy(update={"geometry": geometry})
        scene = build_scene(study, build_mesh(geometry_of(study)))
        result = models.run_model(scene, "fem-linear")
        points, triangles = scene.mesh.surface_points, scene.mesh.triangles
        drift = (
            enclosed_volume(points + result.displacement[-1], triangles) / enclosed_volume(points, triangles)
            - 1
        )
        body = Surface(points, triangles)
        first = float(np.sum(body.volume_gradient * result.displacement[-1])) / body.volume
        compression = -result.fluid_pressure[-1] * 3 * (1 - 2 * ratio) / study.tissue.youngs_modulus
        return drift, compression, first - compression, drift - first

    _, compression, _, _ = parts(0.45, 0.009)
    assert f"compression at a Poisson ratio of 0.45 ({per_cent(compression, 2)})" in ONE_LINE
    drift, compression, facets, second = parts(0.4999, 0.009)
    assert f"at 0.4999 that is {per_cent(compression, 4)} of a drift of {per_cent(drift, 2)}," in ONE_LINE
    assert f"adds in second order ({per_cent(second, 2)} on the quickstart at 0.4 N)" in ONE_LINE
    coarse = parts(0.4999, 0.014)[2]
    words = f"leave out ({per_cent(facets, 2)} there, {per_cent(coarse, 2)} on a mesh of 14 mm instead of 9)"
    assert words in ONE_LINE
    assert max(compression, facets, second, coarse) < 0.0, "all of them add up"


def test_where_nothing_is_judged() -> None:
    moved, drift = (per_cent(share, 0) for share in (MOST_MOVED, MOST_DRIFT))
    words = f"more than {moved} of its smallest extent, or changes its volume by more than {drift}"
    assert words in ONE_LINE


def per_cent(share: float, digits: int) -> str:
    return f"{100 * abs(share):.{digits}f} %"


def test_make_targets_exist() -> None:
    makefile = (regenerate.ROOT / "Makefile").read_text()
    for target in re.findall(r"\bmake (\w+)", TEXT):
        if target not in {"demo", "test", "verify", "docs"}:
            continue
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
    assert "make demo" in TEXT
    assert "make test" in TEXT


@pytest.mark.parametrize("document", ["README.md", "results/FORMAT.md", "vdm/README.md"])
def test_links_lead_somewhere(document: str) -> None:
    path = regenerate.ROOT / document
    for target in re.findall(r"\]\(([^)#]+)\)", path.read_text()):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), target


def test_pictures_are_there_small_and_told_in_words() -> None:
    pictures = re.findall(r"!\[([^]]*)\]\(([^)]+)\)", TEXT)
    assert {"liver-palpation.png", "report.png", "performance.svg"} <= {Path(p).name for _, p in pictures}
    for told, target in pictures:
        path = regenerate.ROOT / target
        assert 1_000 < path.stat().st_size < 300_000, f"{target} has {path.stat().st_size} bytes"
        start = path.read_bytes()[:100]
        assert (
            start.startswith(b"\x89PNG") if path.suffix == ".png" else b"<svg" in start or b"<?xml" in start
        )
        assert len(told.split()) > 3, f"{target} is not told in words"


def test_the_key_reference_is_the_schema() -> None:
    assert regenerate.STUDY_KEYS.read_text() == regenerate.study_keys(), "run `make docs`"


def test_exit_codes_are_those_of_the_program() -> None:
    from vdmbench.cli import output as cli

    documented = {int(code) for code in re.findall(r"^\| (\d+) \|", TEXT, flags=re.MULTILINE)}
    own = {cli.OK, cli.REGRESSED, cli.USAGE, cli.FAILED, cli.MACHINE, cli.DAMAGED, cli.NOTHING_COMPARED}
    assert documented == own | {cli.BUG, cli.INTERRUPTED}


def test_every_shipped_study_is_listed_with_its_title(tmp_path: Path) -> None:
    listed = vdmbench("list", cwd=tmp_path).stdout
    for path in (regenerate.ROOT / "studies" / "cases").glob("*.toml"):
        assert path.stem in listed


def test_every_model_is_in_the_table() -> None:
    from vdmbench.models import MODELS

    assert set(re.findall(r"^\| `((?:vdm|fem|mass)[a-z0-9-]*)` \|", TEXT, flags=re.MULTILINE)) == set(MODELS)
