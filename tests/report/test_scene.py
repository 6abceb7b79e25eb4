"""The scene on the page: what was computed, in words with their ranges, and in a picture below the verdict."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from tests.report.runs import asked, make_case, make_run, of_model
from vdmbench.body.surface_measures import enclosed_volume
from vdmbench.measures.case import CaseResult
from vdmbench.report.section_scene import parts_of, scene, scene_words
from vdmbench.verdict.digest import Digest


def told(label: str, nu: float, force: float, **more: Any) -> CaseResult:
    case = make_case({"m": 0.1}, label=label, contact={"force": force, "profile": "hertz"}, steps=(0.5, 2.0))
    inputs = {
        "tissue": {"youngs_modulus": 5000.0, "poisson_ratio": nu, "density": 1060.0},
        "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.009},
        **more,
    }
    return asked(case, **inputs)


def test_a_cut_body_is_drawn_with_the_rotation_and_strain_of_each_part() -> None:
    """And nothing where no model cut it, or where the parts of the state are not those of the nodes."""
    case = told("a", 0.45, 0.05)
    each = {"rotation_of_part_1": 0.0, "rotation_of_part_2": np.pi / 6, "strain_of_part_1": 0.12}
    scalars = {"parts": 2.0, "part_strain": 0.12, **each, "strain_of_part_2": 0.034}
    at_steps = {name: np.full(len(case.load_factors), value) for name, value in scalars.items()}
    of_node = np.where(case.points[:, 2] > 0, 2, 1)

    def pictures(part_of_node: np.ndarray | None) -> list[str]:
        drawn = scene(Digest(make_run([of_model(case, "m", scalars=at_steps, part_of_node=part_of_node)])))
        return list(drawn.cut)

    (picture,) = pictures(of_node)
    for words in ("part 1: turned 0°, strain 12 %", "part 2: turned 30°, strain 3.4 %"):
        assert words in picture
    assert pictures(None) == pictures(of_node + 1) == []
    for bar, words in ((0.029, "change the answer by 2.9 %"), (np.nan, "would change is not known")):
        error = {"parts_error": np.full(len(case.load_factors), bar)}
        assert words in dict(scene_words(of_model(case, "m", scalars=at_steps | error), [case]))["Parts"]


def test_words_have_the_ranges_of_all_cases_at_full_load() -> None:
    """What is not in the page that was looked at: `test_page`."""
    cases = [told("a", 0.45, 0.05), told("b", 0.4999, 0.2)]
    words = dict(scene_words(cases[0], cases))
    assert words["Tissue"] == "Young's modulus 5 kPa, Poisson ratio 0.45 to 0.4999"
    assert words["Contact"].startswith("finger, 0.1 to 0.4 N, hertz pressure, ")
    file = {"shape": "file", "path": "/of/a/patient.obj", "mesh_size": 0.009}
    scan = told("d", 0.45, 0.05, geometry=file)
    assert dict(scene_words(scan, [scan]))["Body"] == "from a file, 100 × 100 × 100 mm"
    points, inner = scan.points, 0.5 * scan.points
    hollow = dataclasses.replace(
        told("e", 0.45, 0.05, geometry={**file, "cavities": "fluid"}),
        points=np.concatenate([points, inner]),
        triangles=np.concatenate([scan.triangles, scan.triangles[:, ::-1] + len(points)]),
        regions={name: np.append(mask, 0 * mask) for name, mask in scan.regions.items()},
    )
    volume = 1e6 * enclosed_volume(inner, scan.triangles)
    filled = f"1 cavity of {volume:.2g} ml, filled with an incompressible fluid"
    assert dict(scene_words(hollow, [hollow]))["Cavities"] == filled
    fibres = {"contrast": 3.0, "fibre_direction": [1.0, 0.0, 0.0]}
    heavy = told("c", 0.45, 0.05, gravity={"acceleration": [0, 0, -9.81]}, anisotropy=fibres)
    assert dict(scene_words(heavy, [heavy]))["Tissue"].endswith(
        "3 times as stiff along its fibres, with weight, density 1060 kg/m³"
    )


@pytest.mark.parametrize(
    ("contact", "label", "down"),
    [
        ({"force": 0.05}, "0.05 N", True),
        ({"force": -0.05}, "0.05 N", False),
        ({"force": None, "pressure": 800.0}, "800 Pa", True),
        ({"force": None, "pressure": 800.0, "profile": "hertz"}, "peak 800 Pa", True),
    ],
)
def test_the_arrow_of_a_contact(contact: dict[str, object], label: str, down: bool) -> None:
    case = make_case({"m": 0.1}, contact=contact)
    support, finger = parts_of(case, [case])
    assert (support.kind, support.name, support.vector) == ("fixed", "base", None)
    assert finger.label.replace("−", "") == label
    direction = finger.vector / np.linalg.norm(finger.vector)
    np.testing.assert_allclose(direction, [0, 0, -1 if down else 1], atol=1e-6)  # the mesh is symmetric


def test_a_contact_of_one_node_has_an_arrow_too() -> None:
    case = make_case({"m": 0.1})
    top = np.arange(len(case.points)) == case.points[:, 2].argmax()
    case = dataclasses.replace(case, regions={**case.regions, "finger": top})
    _, pin = parts_of(case, [case])
    normal = case.points[top][0] / np.linalg.norm(case.points[top])
    assert pin.vector @ -normal == pytest.approx(np.linalg.norm(pin.vector), rel=1e-3)


def test_a_moved_region_a_thread_and_a_contact_all_round() -> None:
    case = make_case({"m": 0.1})
    everywhere = np.ones(len(case.points), dtype=bool)
    moved = {"kind": "constrained", "region": "finger", "name": "jaw", "displacement": [0.002, 0.0, 0.0]}
    squeezed = {"kind": "contact", "region": "all", "name": "air", "pressure": 100.0}
    pulled = {"kind": "line", "region": "finger", "name": "thread", "resultant": [0.0, 0.015, 0.02]}
    case = asked(case, constraints=[moved, squeezed, pulled])
    case = dataclasses.replace(case, regions={**case.regions, "all": everywhere})
    jaw, air, thread = parts_of(case, [case])
    assert (jaw.label, list(jaw.vector)) == ("2 mm", [0.002, 0.0, 0.0])
    assert air.vector is None, "it presses from all sides"
    assert (thread.label, list(thread.vector)) == ("0.025 N", [0.0, 0.015, 0.02])
