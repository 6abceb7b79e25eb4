"""The limits of [acceptance]: read from a study, held against each case, and no part of any result."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.report.runs import REFERENCE, make_case, make_run, measured_anew, of_metric, of_model
from tests.study.study_texts import SMALL
from vdmbench.machine import processor_name
from vdmbench.measures.case import CaseResult
from vdmbench.scene.result import FrameTimes
from vdmbench.study.config import load_study
from vdmbench.verdict.acceptance import BEYOND, LOST, OPEN, WITHIN
from vdmbench.verdict.digest import Digest
from vdmbench.verdict.verdict import verdicts
from vdmbench.verdict.words import why_not


def limits_of(tmp_path: Path, table: str) -> dict[str, Any]:
    path = tmp_path / "study.toml"
    path.write_text(SMALL + table)
    return load_study(path).acceptance.model_dump(exclude_none=True)


def test_what_a_study_may_limit(tmp_path: Path) -> None:
    usual = {"displacement_error": 0.1, "deformation_error": 0.1}
    assert limits_of(tmp_path, "") == usual
    assert limits_of(tmp_path, "[acceptance]\n") == usual
    assert limits_of(tmp_path, '[acceptance]\ndisplacement_error = "5 %"\n') == usual | {
        "displacement_error": 0.05
    }
    every = (
        "[acceptance]\ndisplacement_error = 0.02\n"
        'deformation_error = "12.5%"\nlargest_difference = "1 mm"\nframe_time = "0.5 ms"\n'
    )
    assert limits_of(tmp_path, every) == {
        "displacement_error": 0.02,
        "deformation_error": 0.125,
        "largest_difference": 0.001,
        "frame_time": 0.0005,
    }


# --- against a case ---


def states(case: CaseResult, model: str = "vdm-m", **table: Any) -> dict[str, int]:
    """Limit -> where a model stands at full load."""
    digest = Digest(make_run([case], acceptance=table))
    return {one.key: int(digest.at_full(digest.states(model, one))[0]) for one in digest.criteria}


def test_each_limit_has_its_own_answer() -> None:
    case = measured_anew(make_case({"vdm-m": 0.08}, subdivisions=2))
    largest = np.linalg.norm(case.models[REFERENCE].displacement[-1], axis=1).max()
    table = {
        "displacement_error": 0.05,
        "largest_difference": 1.01 * 0.08 * largest,
        "frame_time": 1e-4,  # it takes 4e-4 s
    }
    assert states(case, **table) == {
        "displacement_error": BEYOND,
        "deformation_error": WITHIN,
        "largest_difference": WITHIN,
        "frame_time": BEYOND,
    }
    assert states(case, largest_difference=0.99 * 0.08 * largest)["largest_difference"] == BEYOND
    assert states(case, frame_time=1e-3)["frame_time"] == WITHIN


def test_a_history_that_comes_back_is_judged_at_its_largest_load() -> None:
    case = measured_anew(make_case({"vdm-m": 0.08}, steps=(0.5, 1.0, 0.5), subdivisions=2))
    found = states(case, frame_time=1e-3, largest_difference=1.0)
    assert set(found.values()) == {WITHIN}
    digest = Digest(make_run([case], acceptance={"frame_time": 1e-3}))
    assert digest.standing("vdm-m").tolist() == [WITHIN]


def test_without_an_answer_every_limit_is_lost() -> None:
    case = measured_anew(make_case({"vdm-m": 0.01}, stopped={"vdm-m": 3}, subdivisions=0))
    digest = Digest(make_run([case]))
    assert states(case, largest_difference=1.0)["largest_difference"] == LOST
    assert states(case, frame_time=1.0)["frame_time"] == LOST
    assert digest.standing("vdm-m").tolist() == [LOST]
    assert digest.shares("vdm-m").tolist() == [np.inf]


def test_the_best_form_is_the_one_nearest_to_its_limits() -> None:
    """vdm-a is 8 / 8 % off, vdm-b 4 / 12 %: with 5 % in displacement b is nearer, with 10 % in both a."""
    case = make_case({"vdm-a": 0.08, "vdm-b": 0.04}, subdivisions=0)
    case = of_metric(case, "vdm-b", "relative_l2_deformation_error", 0.12)

    def focus(**table: float) -> str | None:
        return Digest(make_run([case], acceptance=table)).focus

    assert focus() == "vdm-a"
    assert focus(displacement_error=0.05, deformation_error=0.1) == "vdm-b"
    assert focus(displacement_error=0.06, deformation_error=0.2) == "vdm-b"
    assert focus(frame_time=1e-3) == "vdm-a"
    assert focus(frame_time=5e-4) == "vdm-a", "the first takes 0.4 ms, the second 0.8 ms"


@pytest.mark.parametrize(
    ("times", "processor", "state"),
    [
        ((4e-4, 4e-4, 4e-4, 9e-3), "", WITHIN),  # one that a busy machine made long
        ((4e-4, 13e-3, 13e-3, 13e-3), "", OPEN),
        ((13e-3, 14e-3, 13e-3, 15e-3), "", BEYOND),
        ((13e-3, np.nan, np.nan, np.nan), "", OPEN),  # once
        ((np.nan,) * 4, "", OPEN),
        ((4e-4,) * 4, "an abacus", OPEN),
        (None, "", OPEN),  # an answer of the cache says 0.4 ms, which decides nothing
    ],
)
def test_a_time_decides_where_its_spread_and_its_run_allow(
    times: tuple[float, ...] | None, processor: str, state: int
) -> None:
    case = make_case({"vdm-m": 0.01}, subdivisions=0)
    rounds = np.array(times) if times is not None else np.zeros(0)
    frames = FrameTimes(rounds, rounds, rounds, processor or processor_name())
    case = of_model(case, "vdm-m", frames=frames if times is not None else None)
    assert states(case, frame_time=1e-3)["frame_time"] == state


@pytest.mark.parametrize(
    ("times", "worked", "state"),
    [
        ((4e-3,) * 4, (1.6e-3, 1.5e-3, 1.7e-3, 1.6e-3), BEYOND),
        ((4e-3,) * 4, (1.6e-3, 0.9e-3, 1.7e-3, 1.6e-3), OPEN),  # of a busy machine
        ((4e-3,) * 4, (0.4e-3,) * 4, OPEN),
        ((0.9e-3,) * 4, (0.4e-3,) * 4, WITHIN),
        ((40e-3,), (16e-3,), BEYOND),  # once, but far
        ((40e-3,), (2.9e-3,), OPEN),
        ((40e-3,), (np.nan,), OPEN),
    ],
)
def test_time_that_a_busy_machine_adds_decides_nothing(
    times: tuple[float, ...], worked: tuple[float, ...], state: int
) -> None:
    frames = FrameTimes(*[np.array(times)] * 3, processor_name(), contact_worked=np.array(worked))
    case = of_model(make_case({"vdm-m": 0.01}, subdivisions=0), "vdm-m", frames=frames)
    assert states(case, frame_time=1e-3)["frame_time"] == state


def test_the_bar_of_a_time_is_what_a_busy_machine_added() -> None:
    times = np.array([40e-3, 41e-3, 37e-3])
    frames = FrameTimes(times, times, times, processor_name(), contact_worked=np.array([16e-3, 17e-3, 15e-3]))
    case = of_model(make_case({"vdm-vector": 0.01}, subdivisions=0), "vdm-vector", frames=frames)
    found = verdicts(Digest(make_run([case], acceptance={"frame_time": 20e-3})))["vdm-derived"]
    (limit,) = (limit for limit in found.limits if limit.key == "frame_time")
    assert (limit.word, limit.value, limit.bar) == ("undecided", 40e-3, pytest.approx(24e-3))
    (text,) = why_not(found)
    assert text.startswith(
        "the time: 40 ms was measured for a frame, of which the processor works 16 ms, on both"
    )
