"""The tables of the documents come from `tools/evidence.toml`: small runs give the rows that are shown."""

import csv
import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from tests.report.runs import example_measurement, make_case, make_run
from tools import error_bars, evidence, mutants, scans, trial
from tools.documents import CASES, README, ROOT, cells, rows_shown, shown
from tools.evidence import EVIDENCE, MEASURES
from vdmbench.study.config import Study, expand, load_study
from vdmbench.study.files import merged

NAN = float("nan")
OURS = [model for model in EVIDENCE["league"]["models"] if model not in ("mujoco-flex", "ngsolve-p2p1")]


def all_rows(name: str) -> list[list[str]]:
    """The rows of a table in its CSV file."""
    return list(csv.reader((ROOT / EVIDENCE[name]["all_rows"]).read_text(encoding="utf-8").splitlines()))[1:]


def test_each_table_stands_in_its_document() -> None:
    for name, own in EVIDENCE.items():
        if "part" in own:
            text = shown(ROOT / own["document"], own["part"])
            assert cells(text), text
            assert f"make evidence WHAT={name}" in (ROOT / own["document"]).read_text()


def test_other_studies_of_the_evidence_are_sound(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    own = EVIDENCE["league"]
    for body, load in ((body, load) for body in own["bodies"] for load in own["loads"]):
        path.write_text(evidence.study_of(own, body, load, name="league", models=[*OURS, "fem"]))
        assert len(expand(load_study(path))) == (4 if load == "touch" else 2)
    for name in ("cup", "fork"):
        (tmp_path / f"{name}.stl").touch()
    for body, load in ((body, load) for body in trial.OWN["bodies"] for load in trial.OWN["loads"]):
        path.write_text(evidence.study_of(trial.OWN, body, load, name=body))
        if (body, load) != ("bladder", "weight"):  # whose fluid has none
            assert len(expand(load_study(path))) == 1
    for about in scans.OWN["bodies"].values():
        path.write_text(tomli_w.dumps(merged(scans.OWN["study"], about)))
        assert expand(load_study(path))
    studies = {path.stem for path in CASES.glob("*.toml")}
    assert set(EVIDENCE["scenes"]["studies"]) | set(EVIDENCE["error_bars"]["cases"]) <= studies


def test_shares_of_the_league_count_failures_and_bars() -> None:
    errors = {"a": (0.01, 0.02, 0.04), "b": (0.06, 0.095, NAN), "c": (0.5, 0.3, 0.4)}
    cases = [
        dataclasses.replace(
            make_case(
                {model: found[k] for model, found in errors.items()}, label=str(k), reference="fem-linear"
            ),
            reference_error={"levels": 2.0, "gci:relative_l2_displacement_error": 0.015},
        )
        for k in range(3)
    ]
    rows = {row[0]: row[1:] for row in cells(evidence.league_table([make_run(cases)], list("cba")))[1:]}
    assert list(rows) == ["a", "b", "c"], "the best first"
    assert rows["a"][:5] == ["0", "2.00 % ± 1.5 %", "4.00 %", "100 %", "100 %"]
    assert rows["b"][0] == "1"
    assert rows["b"][3:5] == ["67 %", "33 %"], "a failure is within nothing, and 0.095 + 0.015 not surely"


def test_a_scene_tells_the_range_over_its_cases() -> None:
    cases = [make_case({"vdm-paper": e, "fem-linear": 0.0}, reference="fem-linear") for e in (0.75, 0.5)]
    found = evidence.scene_cells(cases, {"vdm-paper": "as printed", "bem": "bem"})
    assert found[:2] == ["2", "fem-linear"]
    assert found[-2:] == ["50 to 75", "–"]
    told = "As printed, no: its displacement is 50 to 75 % off, 62 % in the median, in 2 shipped scenes."
    assert evidence.answer(np.array([0.5, 0.75])) == told
    (row,) = (row for row in rows_shown(README, "scenes") if row[0] == "`vdm-paper`")
    assert f"{row[3]} off, {row[2]} in the median, in {row[1]} shipped scenes." in shown(README, "scenes")


def test_what_is_used_of_a_bar_by_hand_and_that_the_bars_hold() -> None:
    assert error_bars.used(MEASURES[0], 0.3, 0.02, 0.31) == pytest.approx(0.5)
    assert error_bars.used(MEASURES[0], 0.3, 0.0, 0.31) == np.inf
    assert error_bars.used(MEASURES[0], 1e-15, 0.0, 6e-11) == 0.0, "rounding is no miss"
    count, of = error_bars.held(all_rows("error_bars"), MEASURES)
    assert count >= 0.95 * of


def test_what_is_shown_is_made_of_all_rows() -> None:
    for name in ("accuracy", "ratios", "parts", "costs", "scans", "error_bars"):
        own = EVIDENCE[name]
        assert evidence.page(name, all_rows(name)) == shown(ROOT / own["document"], own["part"])
    own = EVIDENCE["performance"]
    assert rows_shown(ROOT / own["document"], own["part"])[-1] == next(
        r[2:] for r in reversed(all_rows("performance")) if r[0] == "accuracy-organ"
    )


def test_a_known_ball_is_led_back_from_its_scan_in_both_forms() -> None:
    ball = {"shape": "sphere", "radius": "50 mm", "mesh_size": "25 mm"}
    about = merged(scans.OWN["study"], {"geometry": ball, "tissue": {"youngs_modulus": "6 kPa"}})
    body, nodes, parts, *led = scans.scans_row("ball", Study.model_validate(about))
    assert (body, parts) == ("ball", "1")
    assert 40 < int(nodes) < 100
    for sag, off, told in (led[:3], led[3:]):
        assert 2.0 < float(sag) < 20.0
        worst, mean = map(float, off.split(" / "))
        assert 0.0 < mean < worst < 0.1
        assert told == "nothing"


def test_rows_of_what_was_not_measured_anew_stay(tmp_path: Path) -> None:
    place = tmp_path / "rows.csv"
    assert evidence.kept(str(place), ["body", "x"], [["a", "1"], ["b", "2"]]) == [["a", "1"], ["b", "2"]]
    assert evidence.kept(str(place), ["body", "x"], [["a", "3"]]) == [["a", "3"], ["b", "2"]]


def test_a_form_is_timed_alone_and_held_against_references_that_have_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[str] = []

    def ran(text: str, name: str, *given: str, codes: tuple[int, ...]) -> evidence.Run:
        study = tomllib.loads(text)
        model, *reference = study["study"]["models"]
        asked.append(f"{name.removeprefix('costs/')} {study.get('uncertainty', {}).get('levels', 1)}")
        assert codes == (0, 3)
        assert given == ("--timeout", "600")
        if study.get("vdm") == {"parts": 8}:
            failed = {"hash": "0", "label": "", "code": "timeout", "message": "stopped", "remedy": ""}
            return dataclasses.replace(make_run([]), failed=[failed])
        own = {"gci:relative_l2_displacement_error": 0.017} if "uncertainty" in study else {}
        case = make_case(
            {model: 0.013},
            steps=study["load"]["factors"],
            reference=reference[0] if reference else None,
            reference_error=own,
        )
        return make_run([case])

    monkeypatch.setattr(trial, "ran_text", ran)
    head = trial.COSTS["head"]
    row = dict(zip(head, trial.costs_row("4.4 mm", "bem:nonlinear/4"), strict=True))
    assert asked == [
        "bem-nonlinear-4-4.4-mm 1",
        "bem-nonlinear-4-fem-linear-4.4-mm 2",
        "bem-nonlinear-4-fem-4.4-mm 1",
    ]
    assert [row[key] for key in ("parts", "small strain", "large rotation")] == ["4", "1.3 ± 1.7", "1.3 ± ?"]
    assert [row[key] for key in ("set-up", "frame, contact", "frame")] == ["20.0 ms", "–", "400 µs"]
    assert trial.costs_row("1.98 mm", "bem-sparse")[-1] == "–", "no room for fem there"
    assert trial.costs_row("7.8 mm", "bem:nonlinear/8")[3:] == ["stopped", *["–"] * 6]


def ladder_run(*, wrong: float) -> evidence.Run:
    """Two solvers along three Poisson ratios: LU stops at the last, or is off by `wrong` there."""

    def case(ratio: float, lu: float = 0.0, stopped: dict[str, int] | None = None) -> Any:
        return make_case(
            {"vdm-paper": 0.0, "vdm-paper:lu": lu},
            label=f"{ratio}",
            swept={"tissue.poisson_ratio": ratio},
            steps=(1.0,),
            reference=None,
            stopped=stopped,
            subdivisions=0,
        )

    last = case(0.5, lu=wrong) if wrong else case(0.5, stopped={"vdm-paper:lu": 0})
    return make_run([case(0.3), case(0.4), last], sweep="one-at-a-time")


def test_rows_say_who_stands_it_and_a_silent_wrong_number_is_not_written_down() -> None:
    told = ["ball", "Poisson ratio", "0.3 to 0.5", "1 of 2", "0.5 (diverged): `vdm-paper:lu`"]
    assert evidence.stability_rows(ladder_run(wrong=0.0)) == [told]
    with pytest.raises(RuntimeError, match=r"vdm-paper:lu is wrong in silence along tissue\.poisson_ratio"):
        evidence.stability_rows(ladder_run(wrong=0.01))


def test_a_breakdown_is_beside_the_range_that_is_right_around_the_base() -> None:
    ratio, slivers = "tissue.poisson_ratio", "geometry.slivers"

    def case(stopped: str = "", **swept: float) -> Any:
        keys = {ratio: swept.get("ratio", 0.45)} | ({slivers: swept["slivers"]} if "slivers" in swept else {})
        at = {stopped: 0} if stopped else None
        return make_case({"m": 0.0, "n": 0.0}, label=str(keys), swept=keys, stopped=at, subdivisions=0)

    star = [case(), case(slivers=1e2), case("n", slivers=1e4), case("n", slivers=1e6)]
    star += [case("m", ratio=0.3), case(ratio=0.499), case("m", ratio=0.4999999), case("m", ratio=0.5)]
    assert evidence.stability_rows(make_run(star)) == [
        [
            "ball",
            "Poisson ratio",
            "0.3 to 0.5",
            "2 of 3",
            "0.3 (diverged): `m`; 0.4999999 (diverged): `m`",
        ],
        ["ball", "slivers", "100 to 1e+06", "2 of 3", "10000 (diverged): `n`"],
    ]


def test_the_table_of_a_measurement_is_that_of_the_page() -> None:
    case = make_case({"vdm-paper": 0.05}, steps=(0.25, 0.5, 1.0), reference="fem:direct")
    run = make_run([dataclasses.replace(case, measurement=example_measurement())])
    head, *rows = cells(evidence.measured_table(run))
    assert [row[0] for row in rows][:1] == ["vdm-paper"]
    assert all(len(row) == len(head) for row in rows)


def test_a_fault_of_the_mutation_test_has_its_place_and_its_tests() -> None:
    for mutant in mutants.MUTANTS:
        text = mutants.place_of(mutant, ROOT).read_text()
        compile(text.replace(mutant.old, mutant.new), mutant.where, "exec")
        assert mutants.tests_of(mutant, ROOT)
