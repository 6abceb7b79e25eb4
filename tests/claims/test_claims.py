"""The paper's claims: words from counts, rules on one case, and the stored grid measured again."""

import json
import math
from pathlib import Path
from unittest import mock

import pandas as pd
import pytest

from tests.command import vdmbench
from vdmbench import claims
from vdmbench.claims import COLUMNS, DATA, FAILS, HOLDS, MIXED, OPEN, RULES, WITHIN_LIMITS, Place, judge

ROOT = Path(__file__).parents[2]
STORED = ROOT / "results" / "claims.csv"


def points(
    values: list[float], *, bar: float = 0.0, settings: tuple[str, ...] = (), floor: float = math.nan
) -> pd.DataFrame:
    """Of claim 10's first row: at most 1, in part by tolerance."""
    told = settings or ("",) * len(values)
    rows = [
        (10, "iterations over unknowns, from zero", "ball", "coarse", 0.45, "", setting, value, bar, floor)
        for value, setting in zip(values, told, strict=True)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


@pytest.mark.parametrize(
    ("values", "bar", "word"),
    [
        ([0.2, 0.9], 0.05, HOLDS),
        ([0.2, 0.9], 0.2, OPEN),
        ([0.2, 1.1], 0.0, MIXED),
        ([0.2, 1.1, 1.2], 0.0, FAILS),
        ([0.2, 1.1, 1.2], 0.5, OPEN),
        ([math.inf, 2.0, 0.5], 0.0, FAILS),
    ],
)
def test_the_word_follows_from_counts_and_bars(values: list[float], bar: float, word: str) -> None:
    (row,) = judge(points(values, bar=bar))
    assert row.word == word
    assert (row.low, row.high) == (min(values), max(values))
    assert row.holds == sum(value + bar <= 1.0 for value in values)


def test_a_claim_holds_within_limits_where_a_stated_part_holds_in_every_case() -> None:
    loose, tight = "tolerance = 0.01", "tolerance = 1e-08"
    (row,) = judge(points([0.2, 0.3, 1.5, 1.6, 1.7], settings=(loose, loose, tight, tight, tight)))
    assert (row.word, row.part) == (WITHIN_LIMITS, loose)
    (row,) = judge(points([0.2, 1.3, 1.5], settings=(loose, loose, tight)))
    assert row.word == FAILS


def test_a_floor_widens_the_limit_of_its_own_case() -> None:
    (row,) = judge(points([1.5, 1.5], floor=2.0))
    assert row.word == HOLDS
    assert row.limit == "at most 1 or the floor, 2"
    (row,) = judge(points([1.5, 1.5], floor=0.5))
    assert row.word == FAILS


def test_every_claim_is_quoted_and_has_a_rule_with_limits() -> None:
    assert len(DATA["claims"]) == len(RULES) == 14
    for claim in DATA["claims"]:
        assert all(claim[part] for part in ("text", "quote", "place", "reading", "others", "rule"))
        first = next(iter(claim["rows"].values()))
        assert first.keys() & {"at_most", "at_least"}, "the row that decides has a limit"
        assert {row for about in claim["rows"].values() for row in about.get("of", ())} <= claim[
            "rows"
        ].keys()


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    return claims.places(tmp_path_factory.mktemp("meshes"))[1]  # the coarse ball of 0.4999


def test_rules_measure_again_what_is_stored(place: Place) -> None:
    """Every row of every claim, seconds and long warm starts apart: the grid's own baseline, one case of it."""
    stored = claims.read_points(STORED)
    stored = stored[
        (stored["body"] == "ball") & (stored["mesh"] == "coarse") & (stored["poisson_ratio"] == 0.4999)
    ]
    for number in range(1, len(RULES) + 1):
        own = stored[stored["claim"] == number]
        rows = {name for name, about in DATA["claims"][number - 1]["rows"].items() if "of" not in about}
        assert set(own["row"]) == rows, f"claim {number}: rows of the data"
        if number in (3, 5, 12):  # seconds; a thousand steps
            continue
        found = pd.DataFrame(claims.points_of(number, place), columns=list(COLUMNS))
        # solvers stop at tolerances of their own; how many iterations of 10 that takes, rounding decides
        rtol = 0.15 if number == 10 else 1e-3
        pd.testing.assert_frame_equal(found, own.reset_index(drop=True), rtol=rtol, atol=1e-6)


def test_the_grid_is_whole(place: Place) -> None:
    assert place.poisson_ratio == 0.4999
    grid, stored = DATA["grid"], claims.read_points(STORED)
    assert min(len(grid["bodies"]) - 2, len(grid["meshes"]) - 1, len(grid["poisson_ratio"]) - 1) >= 1
    for number in range(1, len(RULES) + 1):
        cases = stored[stored["claim"] == number][["body", "mesh", "poisson_ratio"]].drop_duplicates()
        assert len(cases) == len(grid["bodies"]) * len(grid["meshes"]) * len(claims.ratios_of(number))


def test_the_other_place_is_another_mesh_or_itself(place: Place) -> None:
    assert place.other() is place
    assert place.other(finer_by=1.6) is place.other(finer_by=1.6)
    assert len(place.other(finer_by=1.6).scene.fixed) > 1.5 * len(place.scene.fixed)


def test_an_error_that_keeps_its_direction_is_not_moved_by_the_reference(place: Place) -> None:
    error = place.scene.mesh.surface_points
    assert place.turned(error, 3.0 * error) == pytest.approx(0.0, abs=1e-12)
    assert place.turned(error, -error) == pytest.approx(2.0, rel=1e-12)


def test_a_file_that_cannot_be_written_is_told_before_anything_is_measured(tmp_path: Path) -> None:
    failed = vdmbench("claims", "1", "--out", ".", cwd=tmp_path)
    assert failed.returncode == 4
    assert failed.stderr.splitlines() == ["vdmbench: .: Is a directory"]
    assert vdmbench("claims", "--from", "no.csv", "--out", "no.csv", cwd=tmp_path).returncode == 2
    assert not (tmp_path / "no.csv").exists()
    with mock.patch("vdmbench.claims.measure", side_effect=KeyboardInterrupt):
        assert vdmbench("claims", "1", "--out", "cut.csv", cwd=tmp_path).returncode == 130
    assert not list(tmp_path.glob("*.csv")), "nor is anything left where it is interrupted"
    done = vdmbench("claims", "5", "--from", str(STORED), "--out", "new/points.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "new/points.csv").read_text().startswith("claim,")


def test_the_command_judges_what_is_stored(tmp_path: Path) -> None:
    done = vdmbench("claims", "--from", str(STORED), "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["claims"]
    assert {row["claim"] for row in rows} == set(range(1, 15))
    told = vdmbench("claims", "5", "--from", str(STORED), cwd=tmp_path).stdout
    assert DATA["claims"][4]["quote"].split(" [")[0][:40] in told
    for wrong, why in (
        (("15",), "there is no claim 15"),
        (("--from", str(ROOT / "README.md")), "not a file of claims"),
        (("--from", str(ROOT / "studies/cases/quickstart.toml")), "not a file of claims"),
        (("--from", "nowhere.csv"), "nowhere.csv: No such file"),
    ):
        failed = vdmbench("claims", *wrong, cwd=tmp_path)
        assert failed.returncode == 2
        assert why in failed.stderr
        assert "Traceback" not in failed.stderr
