"""Mesh files changed at random: each is read, or refused in one line that names no wrong thing; nobody is harmed.

The changes come from a seeded generator, so that a failure is found again by its number.
"""

from __future__ import annotations

import faulthandler
import os
import resource
from pathlib import Path

import numpy as np
import pytest

from tests.bodies import shaped
from vdmbench.body.geometry import build_mesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.read_apart import read_clean
from vdmbench.body.topology import mesh_from_tetrahedra, mesh_from_triangles
from vdmbench.study.errors import MeshError

from .test_mesh_files import SUFFIXES, VOLUMES, write_named

WORDS = (b"-1", b"0", b"9999999999", b"nan", b"1e999", b"4294967296", b"-9223372036854775808", b"\xff" * 8)


@pytest.fixture(scope="module")
def ball() -> Mesh:
    return build_mesh(shaped("sphere", 0.025, {"radius": 0.05}))


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


def read(path: Path) -> str:
    """ "sound" where the file is read, and then checked, else the sentence that refuses it."""
    try:
        body = read_clean(path)
        if body.cells.shape[1] == 4:
            mesh = mesh_from_tetrahedra(body.points, body.cells, groups=body.groups)
        else:
            mesh = mesh_from_triangles(body.points, body.cells)
    except MeshError as error:
        return str(error)
    except MemoryError:
        return "takes more memory than it may"
    sound = np.isfinite(mesh.points).all() and mesh.quality["volume"] > 0
    return "sound" if sound else "neither read nor refused\n"


def read_apart(path: Path) -> str:
    """The same in a process of its own, which a reader may end."""
    answer, told = os.pipe()
    child = os.fork()
    if not child:
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (8_000_000_000,) * 2)
        resource.setrlimit(resource.RLIMIT_DATA, (3_000_000_000,) * 2)
        resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            os.write(told, read(path).encode())
        except BaseException as error:  # noqa: BLE001
            os.write(told, f"neither read nor refused\n{error!r}".encode())
        os._exit(0)
    os.close(told)
    with os.fdopen(answer, "rb") as file:
        data = file.read()
    _, status = os.waitpid(child, 0)
    return f"ends its reader with signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else data.decode()


@pytest.mark.parametrize("name", SUFFIXES + VOLUMES)
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork")
def test_a_changed_mesh_file_is_read_or_refused(tmp_path: Path, ball: Mesh, name: str) -> None:
    whole = write_named(tmp_path / name, ball)
    data = whole.read_bytes()
    assert read(whole) == read_apart(whole) == "sound"  # here too, so that its readers are loaded once
    answers = []
    for number in range(8):
        path = tmp_path / f"changed-{name}"
        path.write_bytes(changed(data, np.random.default_rng(number)))
        answer = read_apart(path)
        assert answer.isprintable(), (number, answer)
        assert 0 < len(answer) < 300, number
        answers.append(answer)
    assert any(answer != "sound" for answer in answers)
    assert sum("signal" in answer for answer in answers) < 5, answers
