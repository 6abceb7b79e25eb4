"""Force against indentation, for contacts under a pressure and for regions that are moved."""

import math
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.report.runs import AMPLITUDE, REFERENCE, asked, make_case, make_run, of_model
from vdmbench.measures.case import CaseResult
from vdmbench.measures.pushed import Answer
from vdmbench.report.blocks import Figures
from vdmbench.report.section_charts import force_against_indentation
from vdmbench.verdict.acceptance import pushes
from vdmbench.verdict.digest import Digest

FINGER = {"kind": "contact", "region": "finger", "name": "finger"}
RTOL, ATOL = 1e-9, 1e-12  # the runs are exact but for rounding


def curve(case: CaseResult, model: str = REFERENCE) -> tuple[np.ndarray, np.ndarray]:
    """(S,) depths and loads of what pushes the case, as a model answers."""
    (pushed,) = pushes(case, Digest(make_run([case])).surfaces[case.hash])
    return pushed.curve(Answer.of(case.models[model]))


def test_a_pressure_is_told_as_such_and_measured_as_its_resultant() -> None:
    """Meshes differ in the area of a region: of a sweep over them the pressure is the one load."""
    assert curve(make_case({"m": 0.1}, contact={"force": 0.4}, subdivisions=1))[1][-1] == 0.4
    case = make_case({"m": 0.1}, contact={"force": None, "pressure": 300.0}, subdivisions=3)
    coarse = make_case({"m": 0.1}, contact={"force": None, "pressure": 300.0}, subdivisions=2, label="b")
    known = Digest(make_run([case, coarse])).known_loads
    assert known.unit == "Pa"
    assert set(known.loads.tolist()) == {75.0, 150.0, 225.0, 300.0}
    (pushed,) = pushes(case, Digest(make_run([case])).surfaces[case.hash])
    answer = Answer.of(case.models[REFERENCE])
    found = pushed.force_at(pushed.curve(answer)[0][-1], answer)
    loaded = case.regions["finger"][case.triangles].all(axis=1)
    a, b, c = (case.points[case.triangles[loaded, k]] for k in range(3))
    expected = 300.0 * np.linalg.norm(0.5 * np.cross(b - a, c - a).sum(axis=0))
    assert_allclose(found, expected, rtol=RTOL, atol=ATOL)
    whole = 300.0 * math.pi * (0.05 * math.sin(math.radians(25))) ** 2
    assert 0.2 < found < whole  # below pressure x whole cap


def test_what_is_held_does_not_push() -> None:
    case = make_case({"m": 0.1}, contact={"kind": "fixed"}, subdivisions=1)
    assert pushes(case, Digest(make_run([case])).surfaces[case.hash]) == []


def test_indentation_is_the_deepest_node_of_the_contact() -> None:
    case = make_case({"m": 0.5}, steps=(0.5, 1.0), subdivisions=3)
    # no node of this ball sits on the pole: the deepest is the nearest one, pushed in by P_2 of its angle
    top = case.points[:, 2].max() / np.linalg.norm(case.points[0])
    depth = AMPLITUDE * (1.5 * top**2 - 0.5)
    found = curve(case)[0]
    assert_allclose(found, [0.5 * depth, depth], rtol=2e-3, atol=ATOL)  # facet normals
    assert_allclose(curve(case, "m")[0], 1.5 * found, rtol=RTOL, atol=ATOL)


def test_force_of_a_movement_is_the_reaction_along_it() -> None:
    """The base is moved; model m pulls at it with 1 N along z at full load."""
    tool = {"kind": "constrained", "region": "base", "displacement": (0.0, 0.003, 0.004), "name": "tool"}
    length, force = curve(make_case({"m": 0.5}, contact=tool, steps=(0.5, 1.0)), "m")
    assert_allclose(length, [0.0025, 0.005], rtol=RTOL, atol=ATOL)
    assert_allclose(force, [0.4, 0.8], rtol=RTOL, atol=ATOL)  # 1 N along z, projected on (0, 3, 4) / 5
    both = asked(make_case({"m": 0.5}), constraints=[tool, {**FINGER, "force": 0.5}])
    assert Digest(make_run([both])).known_loads.unit == "N", "the load is told of the only contact"


def test_force_of_an_indenter_over_its_depth() -> None:
    touch = {"kind": "indenter", "region": "base", "depth": 0.004, "shape": "sphere", "radius": 0.01}
    case = make_case({"m": 0.5}, contact=touch, steps=(0.5, 1.0))
    pushed = of_model(case, REFERENCE, scalars={"indenter_force": np.array([0.2, 0.7])})
    section = force_against_indentation(Digest(make_run([pushed])))
    (figures,) = (block for block in section.blocks if isinstance(block, Figures))
    (words,) = re.findall(r'aria-label="([^"]*)"', "".join(str(figure.svg) for figure in figures.figures))
    assert "to 700 mN at 4 mm" in words
    assert ": m " not in words, "a model without contact has no curve"


@pytest.mark.parametrize(("scanned", "kind"), [(False, "contact"), (True, "contact"), (True, "constrained")])
def test_a_curve_starts_at_the_origin_unless_a_weight_acts_there(kind: str, *, scanned: bool) -> None:
    """A body that was scanned under its weight is where its scan is, but its weight hangs on what is moved."""
    more = {"force": 0.4} if kind == "contact" else {"displacement": (0.0, 0.0, 0.004), "region": "base"}
    case = make_case({"m": 0.5}, contact={"kind": kind, **more}, steps=(0.5, 1.0))
    heavy = asked(case, gravity={"acceleration": [0.0, 0.0, -9.81], "scanned": scanned})
    starts = scanned and kind == "contact"
    for one, expected in ((case, True), (heavy, starts)):
        digest = Digest(make_run([one]))
        section = force_against_indentation(digest)
        words = " ".join(str(block) for block in section.blocks if not isinstance(block, Figures))
        assert ("no curve starts at the origin" not in words) is expected
        (pushed,) = pushes(one, digest.surfaces[one.hash])
        answer = Answer.of(one.models[REFERENCE])
        depths, _ = pushed.curve(answer)
        assert np.isfinite(pushed.force_at(0.5 * depths[0], answer)) == expected, "before the first step"
