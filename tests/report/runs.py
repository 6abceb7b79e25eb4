"""Runs made by hand for tests of the report: a ball that deforms by a P_2 mode, models off by known amounts."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from solver_common.solution import Status
from tests.vdm.vdm_shapes import icosphere
from vdmbench.body.surface_measures import Surface
from vdmbench.machine import processor_name
from vdmbench.measures.case import CaseResult, Limit, ModelLimits, Run
from vdmbench.measures.measurement import InputSpread, Measurement, ModelSpread, Quantity
from vdmbench.measures.metrics import History, evaluate
from vdmbench.scene.result import FrameTimes, ModelResult
from vdmbench.study.config import resolved
from vdmbench.study.schema import Study

RADIUS = 0.05  # m
AMPLITUDE = 0.002  # m, radial displacement at the poles at full load
REFERENCE = "fem-linear"
CONVERGED = Status("converged")
STOPPED = Status("diverged", "the volume could not be held", "take smaller load steps")


_LEAST: dict[str, Any] = {
    "study": {"name": "ball", "models": ["vdm-paper"]},
    "geometry": {"shape": "sphere", "radius": 0.05, "mesh_size": 0.006},
    "tissue": {"youngs_modulus": 5e3, "poisson_ratio": 0.45},
}


def typed_study(**tables: Any) -> Study:
    """A study of these tables, which need not fit each other, and of the least that a study has."""
    return Study.model_validate(_LEAST | tables)


def asked(case: CaseResult, **tables: Any) -> CaseResult:
    """The case with these tables of its study in place of its own."""
    return replace(case, study=Study.model_validate(resolved(case.study) | tables))


def of_model(case: CaseResult, model: str, **fields: Any) -> CaseResult:
    """The case with these fields of a model's answer."""
    return replace(case, models={**case.models, model: replace(case.models[model], **fields)})


def of_metric(case: CaseResult, model: str, metric: str, value: Any) -> CaseResult:
    """The case with this value of a metric at each step, or these values."""
    series = np.broadcast_to(value, len(case.load_factors))
    return replace(case, metrics={**case.metrics, model: {**case.metrics[model], metric: series}})


def p2_mode(directions: np.ndarray) -> np.ndarray:
    """(N, 3) displacement of unit amplitude at the poles: pushed in there, out at the equator, sliding between.

    Even in x, it has no rigid part.
    """
    cosine = directions[:, 2]
    radial = -(1.5 * cosine**2 - 0.5)
    axis = np.array([0.0, 0.0, 1.0])
    tangential = axis - cosine[:, None] * directions
    return radial[:, None] * directions - 0.6 * cosine[:, None] * tangential


def make_case(
    errors: Mapping[str, float],
    *,
    label: str = "",
    swept: Mapping[str, float | str] | None = None,
    units: Mapping[str, str] | None = None,
    steps: Sequence[float] = (0.25, 0.5, 0.75, 1.0),
    reference: str | None = REFERENCE,
    reference_error: Mapping[str, float] | None = None,
    stopped: Mapping[str, int] | None = None,
    subdivisions: int = 2,
    contact: Mapping[str, object] | None = None,
    load: float = 1.0,
) -> CaseResult:
    """A case in which model m answers (1 + errors[m]) times the reference: its relative errors are errors[m].

    `stopped[m]` is the first step at which m failed; it is NaN from there on.
    """
    directions, triangles = icosphere(subdivisions)
    points = RADIUS * directions
    factors = np.array(steps, dtype=float)
    true = load * AMPLITUDE * factors[:, None, None] * p2_mode(directions)
    finger, base = directions[:, 2] > np.cos(np.radians(25)), directions[:, 2] < -0.7
    surface = Surface(points, triangles, finger)
    answers = {name: (1 + error) * true for name, error in errors.items()}
    if reference is not None:
        answers[reference] = true
    models, histories = {}, {}
    for number, (name, displacement) in enumerate(answers.items()):
        failed_from = (stopped or {}).get(name, len(factors))
        displacement = displacement.copy()
        displacement[failed_from:] = np.nan
        reaction = np.zeros_like(displacement)
        reaction[:, base, 2] = factors[:, None] / base.sum()
        is_reference = name == reference
        models[name] = ModelResult(
            displacement=displacement,
            fluid_pressure=200.0 * factors,
            reaction_force=reaction,
            energy=factors**2,
            volume=np.full(len(factors), surface.volume),
            iterations=np.zeros(len(factors), dtype=np.int64),
            status=tuple(CONVERGED if k < failed_from else STOPPED for k in range(len(factors))),
            seconds_setup=2.5 if is_reference else 0.02 * (number + 1),
            seconds_per_step=np.full(len(factors), 0.8 if is_reference else 4e-4 * (number + 1)),
            peak_bytes=350_000_000 if is_reference else 12_000_000,
            version="1",
            parameters={"bulk_modulus": 700.0, "solver": "direct"},
        )
        histories[name] = History(displacement, reaction, factors)
    metrics = {}
    for name, history in histories.items():
        other = histories[reference] if reference is not None and name != reference else None
        metrics[name] = evaluate(surface, history, other)
    given = contact or {}
    force = {} if "kind" in given else {"force": 0.5 * load}
    constraint = {"kind": "contact", "name": "finger", "region": "finger", **force, **given}
    swept = swept or {}
    return CaseResult(
        hash=hashlib.sha256(repr((label, swept, errors)).encode()).hexdigest(),
        label=label,
        swept=swept,
        swept_units=dict.fromkeys(swept, "1") | dict(units or {}),
        study=typed_study(
            constraints=[{"kind": "fixed", "region": "base"}, constraint], load={"factors": list(steps)}
        ),
        provenance={
            "package.numpy": "2.1.0",
            "platform": "Linux",
            "mesh_hash": "c0ffee" * 10,
            "date": "2026-01-02T03:04:05+00:00",
        },
        points=points,
        triangles=triangles,
        load_factors=factors,
        regions={"finger": finger, "base": base},
        models=models,
        metrics=metrics,
        reference=reference,
        reference_error={} if reference_error is None else reference_error,
        mesh_quality={"worst_sicn": 0.31, "surface_nodes": len(points), "tetrahedra": 4000},
    )


def make_run(
    cases: Sequence[CaseResult],
    *,
    sweep: str = "grid",
    acceptance: Mapping[str, float] | None = None,
    **about: Any,
) -> Run:
    """A run of these cases in which nothing failed; `about` is of [study], unchecked."""
    models = list(dict.fromkeys(name for case in cases for name in case.models))
    reference = next((case.reference for case in cases if case.reference), None)
    study = typed_study(sweep={"mode": sweep}, acceptance=dict(acceptance or {}))
    told = {"title": "A ball under a fingertip", "models": tuple(models), "reference": reference, **about}
    study = study.model_copy(update={"study": study.study.model_copy(update=told)})
    return Run(study, '[study]\nname = "ball"\n', list(cases), [], [], {})


def sweep_run() -> Run:
    """Three Poisson ratios by two pressures, two models off by amounts that grow with both."""
    cases = []
    measured = {
        "relative_l2": 0.0055,
        "gci:relative_l2_displacement_error": 0.0068,
        "gci:relative_l2_deformation_error": 0.0074,
    }
    for i, nu in enumerate((0.3, 0.45, 0.4999)):
        for j, pressure in enumerate((200.0, 800.0)):
            cases.append(
                make_case(
                    {"vdm-paper": 0.6 + 0.05 * i + 0.02 * j, "vdm-vector": 0.05 + 0.02 * i + 0.016 * j},
                    label=f"poisson_ratio = {nu}, pressure = {pressure:g} Pa",
                    swept={"tissue.poisson_ratio": nu, "constraints.finger.pressure": pressure},
                    units={"constraints.finger.pressure": "Pa"},
                    reference_error=measured,
                    load=1.0 + j,
                )
            )
    return make_run(cases)


def cheap_run(n_cases: int) -> Run:
    """Many cases of one small surface with different metrics, quick to make: two parameters, one of them text."""
    base = make_case({"vdm-paper": 0.5, "vdm-vector": 0.1}, subdivisions=1, steps=(0.5, 1.0))
    cases = []
    for k in range(n_cases):
        factor = 1.0 + 0.5 * np.sin(k)
        metrics = {
            model: {name: values * factor for name, values in entries.items()}
            for model, entries in base.metrics.items()
        }
        changes = {
            "hash": hashlib.sha256(str(k).encode()).hexdigest(),
            "label": f"modulus = {k}",
            "swept": {
                "tissue.youngs_modulus": 1000.0 + 10.0 * k,
                "geometry.shape": ("box", "organ", "sphere")[k % 3],
            },
            "swept_units": {"tissue.youngs_modulus": "Pa", "geometry.shape": "1"},
            "metrics": metrics,
        }
        cases.append(replace(base, **changes))
    return make_run(cases)


def measured_anew(case: CaseResult) -> CaseResult:
    """The case as a run leaves it that has measured the frames of every model, four rounds of one time each."""
    models = {}
    for name, model in case.models.items():
        rounds = np.ones(4)
        frame = float(np.median(model.seconds_per_step))
        frames = FrameTimes(
            model.seconds_setup * rounds, frame * rounds, 2 * frame * rounds, processor_name()
        )
        models[name] = replace(model, frames=frames)
    return replace(case, models=models)


STUDY = typed_study(
    study={"name": "s", "title": "<script>", "models": ["a", "b:x"]},
    geometry={"shape": "file", "path": "liver.stl"},
    constraints=[
        {"kind": "contact", "region": "base", "name": "finger", "force": 0.1, "profile": "uniform"},
        {"kind": "contact", "region": "base", "name": "palm", "pressure": 10.0},
        {"kind": "fixed", "region": "base"},
        {"kind": "constrained", "region": "base", "name": "rod", "displacement": [0.0, 0.0, 1e-3]},
    ],
    anisotropy={"fibre_direction": [1.0, 0.0, 0.0], "contrast": 2.0},
    gravity={"acceleration": [0.0, 0.0, -9.81]},
    vdm={"bulk_modulus": 10.0},
    models={"vdm-paper": {"bulk_modulus": 20.0}},
)


def example_measurement() -> Measurement:
    """Two quantities, of which the second was measured as a whole surface, and a program that came with them."""
    return Measurement(
        [
            Quantity("tips", "tip <1>", "z", 2, -6.5e-3, 1e-4, 2e-5, facet=1, weights=(0.5, 0.25, 0.25)),
            Quantity("bent", "", "rms distance", 2, 0.0, 1e-3, 0.0),
        ],
        {
            "vdm-paper": np.array([-6.45e-3, 2e-3]),
            "fem:direct": np.array([np.nan, np.nan]),
            "COMSOL": np.array([-6.7e-3, np.nan]),
        },
        {"vdm-paper": np.full(2, np.nan), "fem:direct": np.array([1e-4, 2e-4]), "COMSOL": np.full(2, np.nan)},
        {"tips": "motion capture", "bent": ""},
        ("COMSOL",),
        {"vdm-paper": np.array([2e-4, 0.0]), "fem:direct": np.full(2, np.nan)},
    )


def example_inputs() -> InputSpread:
    """Two inputs."""
    return InputSpread(
        ["tissue.poisson_ratio", "tissue.youngs_modulus"],
        ["1", "Pa"],
        np.array([0.45, 5e3]),
        np.array([0.01, 300.0]),
        {
            "vdm-paper": ModelSpread(0.07, 0.08, np.array([0.03, 0.06]), 0.3),
            "fem:direct": ModelSpread(0.06, np.nan, np.array([0.01, 0.06]), 0.02),
        },
    )


def whole_case(case_hash: str = "ab" * 32) -> CaseResult:
    """A case with all that a file can hold, steps and numbers that are none among it."""
    steps = (0.25, 0.5, 1.0)
    case = make_case(
        {"vdm-paper": 0.1},
        label="poisson_ratio = 0.45",
        reference="fem:direct",
        steps=steps,
        stopped={"vdm-paper": 2},
        subdivisions=0,
    )
    n = len(case.points)
    models = {
        name: replace(
            result,
            seconds_per_step=np.array([0.1, 0.2, np.nan]),
            scalars={"compliance": 0.5 * result.energy},
            part_of_node=np.arange(n) % 2 + 1,
        )
        for name, result in case.models.items()
    }
    return replace(
        case,
        hash=case_hash,
        swept={"tissue.poisson_ratio": 0.45, "geometry.shape": "=cmd()"},
        swept_units={"tissue.poisson_ratio": "1", "geometry.shape": "1"},
        study=STUDY,
        models=models,
        reference_error={"relative_l2": 0.01, "observed_order": float("nan"), "gci:max_nodal_error": 0.25},
        moved=np.linspace(0.0, 2e-3, n),
        measurement=example_measurement(),
        inputs=example_inputs(),
        small_strain={
            "vdm-paper": ModelLimits(
                0.75,
                0.02,
                (
                    Limit(0.05, "found", 0.35, 0.08, 0.004, 0.11, 0.05, 0.07),
                    Limit(0.1, "model-stopped", 0.6, float("nan"), 0.006, 0.17),
                ),
            )
        },
    )
