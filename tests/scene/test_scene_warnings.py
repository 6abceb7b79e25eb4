"""Doubts about scenes: supports without an area, contacts on both faces, forces beyond the body; none elsewhere."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.report.runs import icosphere, make_case, make_run
from vdmbench.scene.warnings import indentation, meshing_warnings, scene_warnings
from vdmbench.study.loads import Constraint
from vdmbench.study.schema import Tissue
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import verdicts

TISSUE = Tissue(youngs_modulus=5000.0, poisson_ratio=0.5)


def plate(thickness: float = 0.01, cells: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """The two faces of a square plate, 0.1 m wide: points and outward facets; its rim is left out."""
    x, y = np.meshgrid(*[np.linspace(-0.05, 0.05, cells + 1)] * 2, indexing="ij")
    face = np.stack([x.ravel(), y.ravel(), np.full(x.size, thickness / 2)], axis=1)
    corner = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (
        part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    top = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.concatenate([face, face * [1, 1, -1]]), np.concatenate([top, top[:, ::-1] + x.size])


POINTS, TRIANGLES = plate()
TOP = POINTS[:, 2] > 0
NEAR = np.hypot(*POINTS[:, :2].T)
SUPPORT = POINTS[:, 0] < -0.042


def constraints(*entries: dict[str, Any]) -> list[Constraint]:
    return [Constraint.model_validate(entry) for entry in entries]


def found(kind: str, mask: np.ndarray, **keys: Any) -> list[str]:
    """The sentences about one constraint on `mask` beside a sound support."""
    keys = {"displacement": [0.0, 0.0, 0.0]} | keys if kind == "constrained" else keys
    entries = [{"kind": "fixed", "region": "base"}, {"kind": kind, "region": "here", **keys}]
    masks = {"base": SUPPORT, "here": mask}
    doubts = list(scene_warnings(constraints(*entries), TISSUE, masks, POINTS, TRIANGLES))
    assert all(loc[:2] == ("constraints", 1) for loc, _ in doubts)
    return [text for _, text in doubts]


def test_a_pressure_all_round_is_meant_so() -> None:
    """As the wall of a cavity has it; a Hertz contact around a body and a wall with a hole press opposite sides."""
    points, triangles = icosphere(2)
    there = np.ones(len(points), dtype=bool)
    parts = constraints({"kind": "contact", "region": "wall", "pressure": 100.0})
    assert not list(scene_warnings(parts, TISSUE, {"wall": there}, points, triangles))
    hertz = constraints({"kind": "contact", "region": "wall", "pressure": 100.0, "profile": "hertz"})
    ((_, text),) = scene_warnings(hertz, TISSUE, {"wall": there}, points, triangles)
    assert "opposite sides" in text
    there[0] = False
    ((_, text),) = scene_warnings(parts, TISSUE, {"wall": there}, points, triangles)
    assert "opposite sides" in text


@pytest.mark.parametrize("kind", ["fixed", "constrained"])
def test_a_support_of_lone_nodes_has_no_limit(kind: str) -> None:
    middle = np.argmin(NEAR)
    assert "holds 1 lone node and no facet" in found(kind, np.arange(len(POINTS)) == middle)[0]
    line = TOP & (np.abs(POINTS[:, 0]) < 1e-9)
    assert "holds 21 lone nodes and no facet" in found(kind, line)[0]
    assert not found(kind, TOP & (NEAR < 0.02))


@pytest.mark.parametrize("kind", ["fixed", "constrained"])
def test_lone_nodes_besides_an_area_are_told_and_those_at_its_rim_are_not(kind: str) -> None:
    area = TOP & (NEAR < 0.02)
    assert not found(kind, area)
    corner = np.argmax(POINTS[:, 0] + POINTS[:, 1])
    far = area | (np.arange(len(POINTS)) == corner)
    assert "holds 1 lone node apart from its facets" in found(kind, far)[0]
    # a node that hangs on the area by an edge, and no facet
    x, y = POINTS[:, 0], POINTS[:, 1]
    rim = x[area].max()
    hanging = area | (TOP & (np.abs(x - rim - 0.005) < 1e-9) & (np.abs(y) < 1e-9))
    assert hanging.sum() == area.sum() + 1
    assert not found(kind, hanging)
    # beside the area that another constraint holds it is no lone node
    assert not found(kind, TOP & (np.abs(POINTS[:, 0] + 0.04) < 1e-9))


def test_a_ball_through_a_thin_body_presses_both_its_faces() -> None:
    assert not found("contact", TOP & (NEAR < 0.03), force=0.01)
    assert "touches 1 node" in found("contact", np.arange(len(POINTS)) == np.argmin(NEAR), pressure=1.0)[0]
    upper, lower = TOP & (NEAR < 0.03), ~TOP & (NEAR < 0.02)
    [told] = found("contact", upper | lower, force=0.01)
    above, below = (mask[TRIANGLES].all(axis=1).sum() for mask in (upper, lower))
    times = (above + below) / (above - below)
    assert f"its facets carry {times:.3g} times its resultant" in told


def test_a_cap_on_a_ball_presses_from_one_side_up_to_a_hemisphere() -> None:
    points, triangles = icosphere(4)
    for angle, doubtful in ((25, False), (85, False), (120, True)):
        masks = {"finger": points[:, 2] > np.cos(np.radians(angle))}
        entries = [{"kind": "contact", "region": "finger", "pressure": 1.0}]
        assert (
            bool(list(scene_warnings(constraints(*entries), TISSUE, masks, points, triangles))) == doubtful
        ), angle


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_that_moves_the_body_by_its_own_size(sign: float) -> None:
    pressed = TOP & (NEAR < 0.02)
    area = 0.005**2 / 2 * pressed[TRIANGLES].all(axis=1).sum()
    limit = 0.01 / indentation(
        1.0, area, TISSUE.youngs_modulus, TISSUE.poisson_ratio
    )  # N: the plate is 0.01 m thick
    assert not found("contact", pressed, force=sign * 0.99 * limit)
    [told] = found("contact", pressed, force=sign * 1.01 * limit)
    assert "more than the body's smallest extent (0.01 m); a mixed-up unit?" in told
    assert not found("contact", pressed, pressure=sign * 0.99 * limit / area)
    assert found("contact", pressed, pressure=sign * 1.01 * limit / area)


# --- where they are told; `vdmbench check` is in tests/robustness/test_check_scene.py ---


def test_the_verdict_tells_them_too() -> None:
    case = make_case({"vdm-paper": 0.05})
    assert verdicts(Digest(make_run([case]))).doubts == ()
    lone = {**case.regions, "base": np.arange(len(case.points)) == 0}
    (doubt,) = verdicts(Digest(make_run([dataclasses.replace(case, regions=lone)]))).doubts
    assert doubt.about == "base"
    assert doubt.text.startswith("holds 1 lone node and no facet")


def test_a_mesh_that_changes_the_volume_by_more_than_is_accepted_is_doubtful() -> None:
    assert not list(meshing_warnings({}, 0.1))
    assert not list(meshing_warnings({"volume_change": -0.09}, 0.1))
    ((loc, text),) = meshing_warnings({"volume_change": -0.143}, 0.1)
    assert loc == ("geometry", "mesh_size")
    assert text.startswith("changes the volume of the file's surface by -14.3 %")
