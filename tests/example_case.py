"""Studies and a finished case made by hand, for tests of what reads them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from solver_common.solution import Status
from vdmbench.measures.case import CaseResult, Limit, MetricSeries, ModelLimits, SmallStrainLimits
from vdmbench.measures.measurement import InputSpread, Measurement, ModelSpread, Quantity
from vdmbench.scene.result import ModelResult
from vdmbench.study.config import resolved
from vdmbench.study.schema import Study

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
    return dataclasses.replace(case, study=Study.model_validate(resolved(case.study) | tables))


N_STEPS = 3
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


def tetrahedron() -> tuple[np.ndarray, np.ndarray]:
    """Four nodes, four outward facets."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    return points, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def model_result(rng: np.random.Generator, n_nodes: int) -> ModelResult:
    return ModelResult(
        displacement=rng.normal(size=(N_STEPS, n_nodes, 3)),
        fluid_pressure=rng.normal(size=N_STEPS),
        reaction_force=rng.normal(size=(N_STEPS, n_nodes, 3)),
        energy=rng.normal(size=N_STEPS),
        volume=rng.normal(size=N_STEPS),
        iterations=np.arange(N_STEPS),
        status=(
            Status("converged"),
            Status("stalled", "no progress", "take smaller steps"),
            Status("converged"),
        ),
        seconds_setup=0.5,
        seconds_per_step=np.array([0.1, 0.2, np.nan]),
        peak_bytes=12345,
        version="1",
        parameters={"bulk_modulus": 10.0, "solver": "direct"},
        scalars={"compliance": rng.normal(size=N_STEPS)},
        part_of_node=np.arange(n_nodes) % 2 + 1,
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


def example_case(case_hash: str = "ab" * 32, label: str = "poisson_ratio = 0.45") -> CaseResult:
    rng = np.random.default_rng(11)
    points, triangles = tetrahedron()
    return CaseResult(
        hash=case_hash,
        label=label,
        swept={"tissue.poisson_ratio": 0.45, "geometry.shape": "=cmd()"},
        swept_units={"tissue.poisson_ratio": "1", "geometry.shape": "1"},
        study=STUDY,
        provenance={"python": "3.11"},
        points=points,
        triangles=triangles,
        load_factors=np.array([0.25, 0.5, 1.0]),
        regions={"base": np.array([True, False, True, False])},
        models={"vdm-paper": model_result(rng, 4), "fem:direct": model_result(rng, 4)},
        metrics={
            "vdm-paper": {
                "volume_drift": MetricSeries(np.array([0.0, np.nan, 1e-3]), "1", "(V - V0)/V0", 1),
                "max_nodal_error": MetricSeries(np.array([1.0, 2.0, 3.0]), "m", "largest |u - r|", 2),
            },
            "fem:direct": {},
        },
        reference="fem:direct",
        reference_error={"relative_l2": 0.01, "observed_order": float("nan"), "gci:max_nodal_error": 0.25},
        mesh_quality={"worst_sicn": 0.3},
        moved=np.array([0.0, 1e-3, 2e-3, 4e-4]),
        measurement=example_measurement(),
        inputs=example_inputs(),
        small_strain=SmallStrainLimits(
            "constraints.finger.pressure",
            "Pa",
            {
                "vdm-paper": ModelLimits(
                    0.75,
                    0.02,
                    (
                        Limit(0.05, "found", 350.0, 0.08, 0.004, 0.11, 0.05, 0.07),
                        Limit(0.1, "model-stopped", 600.0, float("nan"), 0.006, 0.17),
                    ),
                )
            },
        ),
    )
