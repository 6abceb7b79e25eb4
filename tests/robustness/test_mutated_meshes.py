"""Mesh files changed at random: each is read, or refused in one line that names no wrong thing; nobody is harmed.

The changes come from a seeded generator, so that a failure is found again by its number.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.read_apart import clean_of, read_clean
from vdmbench.body.repair import CleanSurface, CleanTetrahedra
from vdmbench.body.topology import mesh_from_tetrahedra, mesh_from_triangles
from vdmbench.study.errors import MeshError
from vdmbench.study.shapes import Geometry

from .test_mesh_files import SUFFIXES, VOLUMES, write_named

WORDS = (b"-1", b"0", b"9999999999", b"nan", b"1e999", b"4294967296", b"-9223372036854775808", b"\xff" * 8)


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(Geometry("sphere", 0.025, {"radius": 0.05}))


def changed(data: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes, half of them in the first 400 bytes, where the counts and kinds stand."""
    for _ in range(rng.integers(1, 5)):
        end = len(data) if rng.random() < 0.5 else min(400, len(data))
        at, length = int(rng.integers(0, end)), int(rng.choice([1, 4, 8, 100]))
        words = [at for at in range(min(end, 2000)) if data[at : at + 1].isdigit()]
        match rng.choice(["flip", "cut", "double", "word", "number"]):
            case "flip":
                data = data[:at] + rng.bytes(1) + data[at + 1 :]
            case "cut":
                data = data[:at] + data[at + length :]
            case "double":
                data = data[:at] + data[at : at + length] * int(rng.choice([2, 1000])) + data[at + length :]
            case "number" if words:
                at = int(rng.choice(words))
                data = data[:at] + rng.choice(np.array(WORDS, dtype=object)) + data[at + 1 :]
            case _:
                data = data[:at] + rng.choice(np.array(WORDS, dtype=object)) + data[at + length :]
    return data


def read(path: Path, clean: Callable[[Path], CleanSurface | CleanTetrahedra]) -> str:
    """ "sound" where the file is read, and then checked, else the sentence that refuses it."""
    try:
        body = clean(path)
        if isinstance(body, CleanTetrahedra):
            mesh = mesh_from_tetrahedra(body.points, body.tetrahedra, groups=body.groups)
        else:
            mesh = mesh_from_triangles(body.points, body.triangles)
    except MeshError as error:
        return str(error)
    assert np.isfinite(mesh.points).all()
    assert mesh.quality["volume"] > 0
    return "sound"


@pytest.mark.parametrize(
    ("clean", "count"),
    [(read_clean, 40), pytest.param(clean_of, 25, marks=pytest.mark.slow)],
    ids=["here", "apart"],
)
@pytest.mark.parametrize("name", SUFFIXES + VOLUMES)
@pytest.mark.filterwarnings(
    "ignore:invalid value encountered in cast"
)  # of a number that is none, and is refused
def test_a_changed_mesh_file_is_read_or_refused(
    tmp_path: Path,
    ball: Mesh,
    name: str,
    clean: Callable[[Path], CleanSurface | CleanTetrahedra],
    count: int,
) -> None:
    whole = write_named(tmp_path / name, ball)
    data = whole.read_bytes()
    assert read(whole, clean) == "sound"
    answers = []
    for number in range(count):
        path = tmp_path / f"changed-{name}"
        path.write_bytes(changed(data, np.random.default_rng(number)))
        answer = read(path, clean)
        assert answer.isprintable(), number
        assert len(answer) < 300, number
        assert "takes more than" not in answer, number  # what a count asks for is known before it is taken
        answers.append(answer)
    assert any(answer != "sound" for answer in answers)
