"""`make evidence WHAT=name` measures anew what a documented table shows: its rows are in `evidence.toml`.

Each row is a shipped study with some values changed, run by the command `vdmbench` and read back as a frame.
"""

from __future__ import annotations

import csv
import dataclasses
import importlib
import itertools
import json
import shutil
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import tomli_w

from tools.documents import CASES, ROOT, RUNS, finished, show, table
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.frame import at_full_load, frame, where_reached
from vdmbench.measures.metrics import DEFORMATION, VECTOR
from vdmbench.measures.uncertainty import is_resolved, reference_bar
from vdmbench.store.cases import read_run
from vdmbench.study.config import Study, expand, load_study
from vdmbench.study.files import merged
from vdmbench.study.registry import FINITE_STRAIN, all_models, split
from vdmbench.verdict.formatting import NOTHING, parameter_name, percent, quantity, short_percent, swept_value
from vdmbench.verdict.reading import WRONG, reading

EVIDENCE: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
MEASURES = (VECTOR, DEFORMATION)
NORMAL = "relative_l2_normal_error"
DRIFT, DISPLACED = "volume_drift", "volume_drift_of_displaced"
ALONG_NORMALS = ("vdm-paper", "vdm-consistent")  # the models that move nodes along normals only
STEP = 1e-3  # m, by which a patch is moved; linear models have the same errors at every other


def ran(
    study: str, changes: Mapping[str, Any] | None = None, name: str = "", *, surface: Path | None = None,
    codes: tuple[int, ...] = (0,),
) -> Run:  # fmt: skip
    """A shipped study with changed values, run as far as it is missing.

    Raises
    ------
    RuntimeError
        a study that did not finish all its cases.
    """
    path = CASES / f"{study}.toml"
    text = path.read_text()
    if changes or name:
        wanted = {"study": {"name": name or study}, **(changes or {})}
        text = tomli_w.dumps(merged(tomllib.loads(text), wanted))
    given = ("--surface", surface) if surface else ()
    return ran_text(text, name or study, *given, codes=codes, called=study)


def ran_text(
    text: str, name: str, *given: str | Path, codes: tuple[int, ...] = (0,), called: str = "",
    files: Iterable[Path] = (),
) -> Run:  # fmt: skip
    """A study given as text, run in `results/runs/NAME` with `files` and what shipped studies read beside it.

    `given` are further words of the command.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{called or Path(name).name}.toml"
        path.write_text(text, encoding="utf-8")
        for data in (*CASES.glob("*.csv"), *files):
            shutil.copy(data, folder)
        finished("run", path, *given, "--out", RUNS / name, "--jobs", "1", codes=codes)
    return read_run(RUNS / name)


def study_of(own: Mapping[str, Any], body: str, load: str, **study: Any) -> str:
    """A body under a load as a study file, with these keys of [study]."""
    about, loads = own["bodies"][body], own["loads"]
    found = merged(own["study"], {key: value for key, value in about.items() if key not in loads})
    found = merged(merged(found, loads[load]), about.get(load, {}))
    return tomli_w.dumps(merged(found, {"study": study}))


def as_per_cent(share: np.floating[Any] | float) -> str:
    """Per cent with two digits."""
    per_cent = 100.0 * share
    return f"{per_cent:.0f}" if per_cent >= 9.95 else f"{per_cent:.1f}"


def slashed(values: Sequence[float] | np.ndarray) -> str:
    """Shares in per cent, one beside the other."""
    return " / ".join(map(as_per_cent, values))


def reached(cases: Sequence[CaseResult], model: str, metrics: Sequence[str] = MEASURES) -> np.ndarray:
    """(metrics, cases) of a model, "" for the reference, at the largest load that this reached."""
    return np.array(
        [[where_reached(c, model or str(c.reference), metric) for c in cases] for metric in metrics]
    )


def own_error(cases: Sequence[CaseResult], metrics: Sequence[str] = MEASURES) -> np.ndarray:
    """(metrics, cases) the reference's own error in them."""
    return np.array([[reference_bar(case.reference_error, metric) for case in cases] for metric in metrics])


def motion(cases: Sequence[CaseResult]) -> list[str]:
    """The share of rigid motion in the reference's displacement, and what it is off itself, moved along normals."""
    return [
        as_per_cent(share) for share in reached(cases, "", ("rigid_share", "tangential_share")).mean(axis=1)
    ]


def mean_and_worst(errors: np.ndarray, bars: np.ndarray | float = 0.0) -> str:
    """Means of (metrics, cases), ~ where a bar is too wide, the worst in brackets; NOTHING where one lacks."""
    if not np.isfinite(errors).all():
        return NOTHING
    sure = is_resolved(errors, bars).all(axis=1)
    shown = [
        ("" if ok else "~") + as_per_cent(mean) for ok, mean in zip(sure, errors.mean(axis=1), strict=True)
    ]
    return f"{' / '.join(shown)} ({slashed(errors.max(axis=1))})"


def kept(path: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[list[str]]:
    """All rows of a table in its CSV file, in their order, those of bodies that were not measured anew too."""
    place = ROOT / path
    _, *old = csv.reader(place.read_text(encoding="utf-8").splitlines()) if place.exists() else [head]
    anew: dict[str, list[list[str]]] = {}
    for row in rows:
        anew.setdefault(row[0], []).append(list(row))
    bodies = dict.fromkeys([*(row[0] for row in old), *anew])
    found = [row for body in bodies for row in anew.get(body) or (one for one in old if one[0] == body)]
    with place.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([head, *found])
    return found


# --- docs/evidence/accuracy.md ---


def accuracy(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Six patches on each body, and on surfaces that are named, which go through `accuracy-organ`."""
    for row in EVIDENCE["accuracy"]["rows"]:
        yield accuracy_row(row)
    for surface in (Path(argument).resolve() for argument in arguments):
        for moved in (False, True):
            yield accuracy_row({"body": surface.stem, "moved": moved}, surface=surface)


def accuracy_page(rows: Sequence[Sequence[str]]) -> str:
    """The means of the two errors of pressed patches, without worst and consistent form."""
    head = EVIDENCE["accuracy"]["head"]
    columns = [k for k, title in enumerate(head) if title not in ("nodes", "loads", "consistent")]
    pressed = [row for row in rows if not row[0].endswith(", moved")]
    cells = [[" / ".join(row[k].partition(" (")[0].split(" / ")[:2]) for k in columns] for row in pressed]
    return table([head[k] for k in columns], cells)


def accuracy_row(row: Mapping[str, Any], *, surface: Path | None = None) -> list[str]:
    """A row: size, the reference's motion and own error, and each model's errors, mean and in brackets worst."""
    study = "accuracy-organ" if surface else f"accuracy-{row['body']}"
    changes, words = accuracy_changes(study, row)
    suffix = words.replace(", ", "-").replace(" ", "-").replace("%", "percent")
    cases = ran(study, changes, f"accuracy-{row['body']}{suffix}", surface=surface).cases
    rigid, along_normals = motion(cases)
    own = slashed(own_error(cases).mean(axis=1))
    cells = [str(len(cases[0].points)), str(len(cases)), rigid, own, along_normals]
    for model in EVIDENCE["accuracy"]["models"]:
        metrics = (*MEASURES, NORMAL) if model in ALONG_NORMALS else MEASURES
        cells.append(mean_and_worst(reached(cases, model, metrics), own_error(cases, metrics)))
    return [row["body"] + words, *cells]


def accuracy_changes(study: str, row: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
    """What a row changes in its study, and the words after its body's name."""
    sweep = tomllib.loads((CASES / f"{study}.toml").read_text())["sweep"]
    found: dict[str, Any] = {}
    words = ""
    if share := row.get("embedded"):
        found["regions"] = {"base": {"below": {"axis": "z", "fraction": share, "value": None}}}
        words += f", embedded to {100 * share:.0f} %"
    if stiffness := row.get("springs"):
        bed = {"kind": "elastic", "stiffness": stiffness, "direction": "full"}
        found["constraints"] = {"base": bed}
        words += " on springs"
    if row.get("moved"):
        way = np.array([sweep[f"regions.finger.cap.direction.{k}"] for k in range(3)])
        inward = -STEP * way / np.linalg.norm(way, axis=0)
        finger = {"kind": "constrained", "pressure": None, "profile": None}
        found["constraints"] = {"finger": finger | {"displacement": inward[:, 0].tolist()}}
        found["sweep"] = {f"constraints.finger.displacement.{k}": inward[k].tolist() for k in range(3)}
        words += ", moved"
    return found, words


def ratios(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The accuracy studies at every Poisson's ratio, with the tissue and with VDM's fluid inside `bem`."""
    for study in EVIDENCE["ratios"]["studies"]:
        yield from ratio_rows(study.removeprefix("accuracy-"), study)
    for surface in (Path(argument).resolve() for argument in arguments):
        yield from ratio_rows(surface.stem, "accuracy-organ", surface=surface)


def ratios_page(rows: Sequence[Sequence[str]]) -> str:
    """A row a ratio: the mean of what the rows of all bodies show, of what is in brackets the largest."""
    found: dict[str, list[Sequence[str]]] = {}
    for _, ratio, *cells in rows:
        found.setdefault(ratio, []).append(cells)
    means = [[ratio, *map(_mean_cell, zip(*own, strict=True))] for ratio, own in found.items()]
    return table(EVIDENCE["ratios"]["head"][1:], means)


def ratio_rows(body: str, study: str, *, surface: Path | None = None) -> Iterator[list[str]]:
    """A row a ratio: errors in displacement, shape and volume, over the volume that the reference displaces."""
    own = EVIDENCE["ratios"]

    def pressed(ratio: float, inside: str) -> Sequence[CaseResult]:
        name, form = f"accuracy-{body}-{ratio}-{inside}", {"bem": {"compressibility": inside}}
        changes = {"study": {"name": name}, "tissue": {"poisson_ratio": ratio}, "models": form}
        return ran(study, merged(own["set"], changes), name, surface=surface).cases

    for ratio in own["ratios"]:
        tissue, fluid = (pressed(ratio, inside) for inside in own["inside"])
        errors = (_with_volume(tissue, "bem"), _with_volume(fluid, "bem"), _with_volume(tissue, "fem-linear"))
        volume = as_per_cent(np.abs(reached(tissue, "", [DISPLACED])).mean())
        bars = slashed(own_error(tissue).mean(axis=1))
        yield [body, str(ratio), bars, volume, *map(mean_and_worst, errors)]


def _with_volume(cases: Sequence[CaseResult], model: str) -> np.ndarray:
    """(3, cases) errors in displacement, shape and volume, this over the volume that the reference displaces."""
    (drift,), (own, displaced) = reached(cases, model, [DRIFT]), reached(cases, "", [DRIFT, DISPLACED])
    return np.vstack([reached(cases, model), np.abs((drift - own) * displaced / own)])


def _mean_cell(cells: Sequence[str]) -> str:
    shown = [[list(map(float, part.split("/"))) for part in cell.rstrip(")").split("(")] for cell in cells]
    first = slashed(np.mean([parts[0] for parts in shown], axis=0) / 100.0)
    if len(shown[0]) == 1:
        return first
    return f"{first} ({slashed(np.max([parts[1] for parts in shown], axis=0) / 100.0)})"


def scenes(arguments: Sequence[str]) -> None:
    """Every shipped study against elements; README sums up. Arguments are studies, for their rows alone."""
    own = EVIDENCE["scenes"]
    rows, errors = [], {model: np.zeros(0) for model in own["models"]}
    for study in [study for study in own["studies"] if not arguments or study in arguments]:
        cases = ran(study).cases
        rows.append([study, *scene_cells(cases, errors)])
        errors = {model: np.append(found, answered(cases, model)) for model, found in errors.items()}
    kept(own["all_rows"], own["head"], rows)
    if arguments:
        return
    told = [
        [f"`{model}`", f"{len(e)}", f"{as_per_cent(np.median(e))} %", f"{span(e)} %", f"{(e <= 0.1).sum()}"]
        for model, e in errors.items()
    ]
    head = ["model", "scenes", "median error", "range", "within 10 %"]
    show(ROOT / own["document"], own["part"], f"{answer(errors['vdm-paper'])}\n\n{table(head, told)}")


def answer(errors: np.ndarray) -> str:
    """Should I use VDM? The sentence for the printed form, of its displacement errors in all shipped scenes."""
    within = (errors <= 0.1).sum()
    word = f"in {within} scenes" if within else "no"
    median = f"{as_per_cent(np.median(errors))} % in the median"
    told = f"its displacement is {span(errors)} % off, {median}, in {len(errors)} shipped scenes"
    return f"As printed, {word}: {told}."


def answered(cases: Sequence[CaseResult], model: str) -> np.ndarray:
    """A model's displacement errors in the cases that it answers."""
    (errors,) = reached(cases, model, [VECTOR])
    return errors[np.isfinite(errors)]


def span(errors: np.ndarray) -> str:
    """From the least to the largest, in per cent."""
    return " to ".join(dict.fromkeys(as_per_cent(end) for end in (errors.min(), errors.max())))


def scene_cells(cases: Sequence[CaseResult], models: Iterable[str]) -> list[str]:
    """Of a study: cases, the reference and its motion, and each model's displacement errors from least to most."""
    own = own_error(cases, [VECTOR]).mean()
    cells = [
        str(len(cases)),
        str(cases[0].reference),
        f"± {as_per_cent(own)}" if np.isfinite(own) else NOTHING,
    ]
    errors = [answered(cases, model) for model in models]
    return [*cells, *motion(cases), *(span(found) if len(found) else NOTHING for found in errors)]


# --- docs/evidence/stability.md ---


def stability(_: Sequence[str]) -> Iterator[list[str]]:
    """What breaks where as one parameter is raised."""
    for study in EVIDENCE["stability"]["studies"]:
        yield from stability_rows(ran(study, codes=(0, 3)))


def stability_rows(run: Run) -> list[list[str]]:
    """A row for each number of which cases differ in that alone: who stands all of it, where the others break down.

    Raises
    ------
    RuntimeError
        a step that is called converged and is wrong: the table has no place for it.
    """
    keys = list(dict.fromkeys(key for case in run.cases for key in case.swept))
    base = {key: Counter(case.swept.get(key) for case in run.cases).most_common(1)[0][0] for key in keys}
    rows = []
    for key in keys:
        others = [other for other in keys if other != key]
        alone = [case for case in run.cases if all(case.swept.get(k) == base[k] for k in others)]
        found = {float(v): case for case in alone if isinstance(v := case.swept.get(key), int | float)}
        if len(found) > 1:
            told = _along(key, dict(sorted(found.items())), base[key] if others else None)
            rows.append([run.study.study.name, parameter_name(key), *told])
    return rows


def _along(key: str, cases: Mapping[float, CaseResult], base: float | str | None) -> list[str]:
    """From where to where a number goes, how many models stand it all, where the others break down."""
    first = next(iter(cases.values()))
    unit, own = first.swept_units.get(key, "1"), key.removeprefix("models.").rpartition(".")[0]
    short = [swept_value(value, unit) for value in cases]
    texts = [
        f"{value:.12g}" if unit == "1" and short.count(text) > 1 else text
        for value, text in zip(cases, short, strict=True)
    ]
    known = [name for case in cases.values() for name in case.models]
    models = [own] if key.startswith("models.") else list(dict.fromkeys(known))
    places: dict[str, list[str]] = {}
    for model in models:
        with np.errstate(all="ignore"):  # of what solvers leave behind that broke down
            read = [reading(case, model) for case in cases.values()]
        if any(one is not None and one.code == WRONG for one in read):
            raise RuntimeError(f"{model} is wrong in silence along {key}")
        right = [one is not None and one.ok for one in read]
        for k in _beside(right, list(cases).index(base) if base in cases else None):
            if (one := read[k]) is not None:
                places.setdefault(f"{texts[k]} ({one.code})", []).append(f"`{model}`")
    broken = {name for names in places.values() for name in names}
    breaks = "; ".join(f"{place}: {', '.join(names)}" for place, names in places.items()) or "nowhere"
    return [f"{texts[0]} to {texts[-1]}", f"{len(models) - len(broken)} of {len(models)}", breaks]


def _beside(right: Sequence[bool], base: int | None) -> list[int]:
    """The places beside the run of right ones that has the base, else the longest; the first if none is right."""
    runs = [list(run) for ok, run in itertools.groupby(range(len(right)), key=right.__getitem__) if ok]
    if not runs:
        return [0]
    chosen = max([run for run in runs if base in run] or runs, key=len)
    return [k for k in (chosen[0] - 1, chosen[-1] + 1) if 0 <= k < len(right)]


# --- docs/evidence/measured.md ---


def measured(_: Sequence[str]) -> None:
    """The phantoms against their measurement."""
    own = EVIDENCE["measured"]
    for study in own["studies"]:
        models = tomllib.loads((CASES / f"{study}.toml").read_text())["study"]["models"]
        models += [model for model in own["beside"] if split(model)[0] in all_models()]
        run = ran(study, {"study": {"name": study, "models": models}}, f"{study}-peers")
        show(ROOT / own["document"], study, measured_table(run))


def measured_table(run: Run) -> str:
    """The summary of a run against its measurement, as its page has it, without times."""
    from vdmbench.report.blocks import Table
    from vdmbench.report.section_measurement import against_measurement
    from vdmbench.verdict.digest import Digest

    section = against_measurement(Digest(run))
    assert section is not None, "the run has no measurement"
    summary = next(block for block in section.blocks if isinstance(block, Table))
    head = [column.title[:1].lower() + column.title[1:] for column in summary.columns]
    shown_here = [k for k, title in enumerate(head) if title not in ("of rms of D", "u_D", "per frame")]
    left_out = EVIDENCE["measured"]["left_out"]
    rows = [[row[k].text for k in shown_here] for row in summary.rows if row[0].text not in left_out]
    return table([head[k] for k in shown_here], rows)


# --- docs/evidence/league.md ---


def league(_: Sequence[str]) -> None:
    """Models and engines on the same bodies under the same loads, the best first."""
    own = EVIDENCE["league"]
    here = [model for model in own["models"] if split(model)[0] in all_models()]
    runs = []
    for body, load in itertools.product(own["bodies"], own["loads"]):
        name = f"league-{body}-{load}"
        runs.append(ran_text(study_of(own, body, load, name=name, models=[*here, "fem"]), name))
    engines = [
        f"{wheel} {version(wheel)}" for wheel in ("mujoco", "ngsolve") if len(here) == len(own["models"])
    ]
    left_out = [
        f"Not here: {model}: `pip install ./docs/examples`." for model in own["models"] if model not in here
    ]
    machine = f"{runs[0].cases[0].provenance['processor']}, one thread"
    count = f"{sum(len(run.cases) for run in runs)} cases"
    told = " ".join([f"{', '.join([machine, *engines, count])}.", *left_out])
    show(ROOT / own["document"], own["part"], f"{told}\n\n{league_table(runs, here)}")


def league_table(runs: Sequence[Run], models: Sequence[str]) -> str:
    """A line for each model; a failure is within no limit, and what is within one with its bar is so surely."""
    import pandas as pd

    limit = EVIDENCE["league"]["limit"]
    every = at_full_load(pd.concat([frame(run) for run in runs])).set_index(["metric", "case"])
    head = ["model", "failed", "median error", "worst", f"within {short_percent(limit)}", "surely"]
    rows = []
    for model in models:
        own = every[every["model"] == model]
        errors = own.loc[VECTOR].sort_values("value")  # what failed last
        known = errors.dropna(subset="value")
        if known.empty:
            rows.append((0.0, np.inf, [model, str(len(errors)), *[NOTHING] * 6]))
            continue
        middle, worst = known.iloc[(len(known) - 1) // 2], float(known["value"].iloc[-1])
        within, surely = (errors["value"] <= limit).mean(), (errors["value"] + errors["bar"] <= limit).mean()
        cells = [f"{percent(middle['value'])} ± {100 * middle['bar']:.2g} %", percent(worst)]
        cells += [f"{100 * within:.0f} %", f"{100 * surely:.0f} %"]
        for cost in ("seconds_per_step", "seconds_setup"):
            cells.append(quantity(float(own.loc[cost]["value"][known.index].median()), "s"))
        rows.append((-within, middle["value"], [model, str(len(errors) - len(known)), *cells]))
    return table([*head, "frame", "set-up"], [row[2] for row in sorted(rows, key=lambda row: row[:2])])


# --- docs/evidence/performance.md ---


def performance(arguments: Sequence[str]) -> None:
    """The finest meshes of `vdmbench bench`, whose runs stay in results/runs/bench."""
    from vdmbench.bench import rows as bench_rows

    own, there = EVIDENCE["performance"], RUNS / "bench"
    surface = ["--surface", Path(arguments[0]).absolute()] if arguments else []
    told = json.loads(finished("bench", *surface, "--out", there, "--json", OPENBLAS_NUM_THREADS="1"))
    runs = [read_run(Path(report).parent) for report in told["reports"]]
    found = [row for run in runs for row in bench_rows(dataclasses.replace(run, cases=[_finest(run)]))]
    head = own["head"]
    rows = [[row[key].partition(" [")[0] for key in head] for row in found if row["model"] in own["models"]]
    kept(own["all_rows"], head, rows)
    machine = f"{_finest(runs[0]).provenance['processor']}, one thread; medians of rounds"
    of_one = table(head[2:], [row[2:] for row in rows if row[0] == own["body"]])
    show(ROOT / own["document"], own["part"], f"{machine}; the {own['body']}.\n\n{of_one}")


def _finest(run: Run) -> CaseResult:
    return max(run.cases, key=lambda case: len(case.points))


# --- results/calibrations.md ---

STORED = ROOT / "results" / "calibrations"


def calibrations(_: Sequence[str]) -> Iterator[list[str]]:
    """Every shipped body calibrated, each fit tried on all others; the values to paste, and all figures as JSON."""
    own, found = EVIDENCE["calibrations"], {}
    for study in own["studies"]:
        others = [word for other in own["studies"] if other != study for word in ("--transfer", other)]
        found[study] = json.loads(finished("calibrate", study, *others, "--json"))[study]
        for suffix in ("toml", "json"):
            shutil.copy(RUNS / study / f"calibration.{suffix}", STORED / f"{study}.{suffix}")
    return calibration_rows(found)


def calibration_rows(found: Mapping[str, Mapping[str, Any]]) -> Iterator[list[str]]:
    """A line for each model and body: study -> model -> its calibration as `vdmbench calibrate --json` has it."""
    from vdmbench.calibrate import Errors, bars_in_percent, in_percent

    for model in EVIDENCE["calibrations"]["models"]:
        for study, entries in found.items():
            fit, transfer = entries[model]["fit"], entries[model]["transfer"]
            by_rule, held_out = (Errors(**fit[part]) for part in ("by_rule", "held_out"))
            there = [errors["vector"] for errors in transfer.values()]
            multiples = ", ".join(f"{value:.2g}" for value in fit["multiples"].values())
            cells = [model, study.removeprefix("calibrate-"), multiples, in_percent(by_rule)]
            cells += [in_percent(held_out), bars_in_percent(held_out)]
            yield [*cells, f"{percent(min(there))} to {percent(max(there))}"]


# --- docs/methods/measures.md ---


def strain(arguments: Sequence[str]) -> Iterable[list[str]]:
    """The strain of every shipped study of finite strain on three meshes, of its first case, by linear elements."""
    return map(strain_row, arguments or finite_studies())


def finite_studies() -> list[str]:
    """The shipped studies whose reference is of finite strain: where the axis of small-strain limits is one."""
    studies = {path.stem: tomllib.loads(path.read_text())["study"] for path in sorted(CASES.glob("*.toml"))}
    return [study for study, keys in studies.items() if split(str(keys.get("reference")))[0] in FINITE_STRAIN]


def strain_row(study: str) -> list[str]:
    """On three mesh sizes, each over that of the study, at a hundredth of load and weight: strains are linear."""
    case = expand(load_study(CASES / f"{study}.toml"))[0].study
    if case.gravity is not None:
        weight = tuple(0.01 * float(component) for component in case.gravity.acceleration)
        case = case.model_copy(update={"gravity": case.gravity.model_copy(update={"acceleration": weight})})
    levels = np.array([strain_on(case, size) for size in EVIDENCE["strain"]["sizes"]])
    off = [[f"{100.0 * share:+.1f} %" for share in column[:-1] / column[-1] - 1.0] for column in levels.T]
    nodes, strains = [f"{n:.0f}" for n in levels[:, 0]], [f"{strain:.3g}" for strain in levels[:, 1]]
    return [study, *(" / ".join(cells) for cells in (nodes, strains, off[1], off[2]))]


def strain_on(study: Study, size: float) -> tuple[float, float, float]:
    """Surface nodes of a mesh, the strain that 95 % of the volume stays below there, and the largest."""
    from fem_reference.linear import LinearProblem
    from vdmbench.body.geometry import build_mesh
    from vdmbench.models import Prepared
    from vdmbench.models.elements import fem_loads
    from vdmbench.scene.scene import build_scene

    geometry = study.geometry.model_copy(update={"mesh_size": size * study.geometry.mesh_size})
    study = study.model_copy(update={"geometry": geometry})
    scene = build_scene(study, build_mesh(study.geometry))
    set_up = Prepared(scene, "fem-linear").set_up
    assert set_up is not None, "linear elements take these scenes"
    assert isinstance(set_up.problem, LinearProblem)
    load = scene.load(0.01 * float(scene.load_factors[np.abs(scene.load_factors).argmax()]))
    names = ("p95_principal_strain", "max_principal_strain")
    found = set_up.problem.solve(fem_loads([load], set_up.problem.mesh), frozenset(names)).scalars
    return float(len(scene.fixed)), *(float(found[each][0]) for each in names)


# --- docs/evidence/claims.md ---


def claims(arguments: Sequence[str]) -> None:
    """The grid of the paper's claims, measured anew, or of claims that are named by number; a table of each."""
    import pandas as pd

    from vdmbench.claims import measure, read_points, write_points
    from vdmbench.machine import cache_directory

    own = EVIDENCE["claims"]
    points = measure(cache_directory(), map(int, arguments), lambda case: print(case, file=sys.stderr))
    if arguments:
        old = read_points(ROOT / own["points"])
        points = pd.concat([old[~old["claim"].isin(map(int, arguments))], points])
        points = points.sort_values("claim", kind="stable", ignore_index=True)
    write_points(points, ROOT / own["points"])
    show_claims()


def show_claims() -> None:
    """The page from what was measured: a line for each claim, then its words and how they are read."""
    from vdmbench.claims import DATA, judge, read_points, table_of_claims, told

    own = EVIDENCE["claims"]
    lines = table_of_claims(judge(read_points(ROOT / own["points"])))
    show(ROOT / own["document"], own["part"], table(list(lines[0]), [list(line.values()) for line in lines]))
    words = (" ".join(told(number)[:2]).replace("<", "&lt;") for number in range(1, len(DATA["claims"]) + 1))
    show(ROOT / own["document"], own["words"], "".join(f"{k}. {text}\n" for k, text in enumerate(words, 1)))


def page(name: str, rows: Sequence[Sequence[str]]) -> str:
    """What a document shows of all rows of a table: the table itself, or what `NAME_page` makes of them."""
    make = getattr(maker(name), f"{name}_page", None)
    return make(rows) if make else table(EVIDENCE[name]["head"], rows)


def maker(name: str) -> ModuleType:
    """Where the function of a table's name is."""
    return importlib.import_module(EVIDENCE[name].get("made_by", "tools.evidence"))


def main(arguments: Sequence[str]) -> None:
    """Make the table that is named; further arguments are its own."""
    if not arguments or arguments[0] not in EVIDENCE:
        sys.exit(f"say what: one of {', '.join(EVIDENCE)}")
    name, *given = arguments
    own = EVIDENCE[name]
    if (rows := getattr(maker(name), name)(given)) is not None:  # else it writes its page itself
        rows = kept(own["all_rows"], own["head"], rows) if "all_rows" in own else list(rows)
        show(ROOT / own["document"], own["part"], page(name, rows))


if __name__ == "__main__":
    main(sys.argv[1:])
