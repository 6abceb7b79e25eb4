"""What a worker process does: make one mesh, or run one case from its mesh to its file."""

from __future__ import annotations

import itertools
import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from . import models, uncertainty
from .case import CaseResult, MetricSeries, ModelResult
from .execute import TaskError
from .geometry_spec import Geometry
from .mesh import Mesh
from .mesh_cache import mesh_from_cache
from .metrics import METRICS, History, Surface, evaluate, relative_l2, rigid_motion_removed
from .plan import level_geometries, needs_volume
from .scene import Scene, build_scene
from .schema import Study
from .store import write_case

PACKAGES = (
    "vdmbench",
    "numpy",
    "scipy",
    "scikit-fem",
    "gmsh",
    "meshio",
    "pyvista",
    "h5py",
    "rslab",
    "cholespy",
    "pyamg",
)


def make_mesh(task: Mapping[str, Any]) -> None:
    """Put one mesh into the cache."""
    geometry = Geometry(task["shape"], task["mesh_size"], task["parameters"])
    mesh_from_cache(geometry, Path(task["cache"]), volume=task["volume"])


def run_case(task: Mapping[str, Any]) -> None:
    """Mesh, scene, every model, metrics, one file.

    Raises
    ------
    TaskError
        the reference failed, so that there is nothing to compare with.
    """
    study = Study.model_validate(task["study"])
    cache = Path(task["cache"])
    names = list(study.study.models)
    reference = study.study.reference
    geometry, *coarser = level_geometries(study)
    mesh = mesh_from_cache(geometry, cache, volume=needs_volume(study))
    scene = build_scene(study, mesh)
    results = {name: models.run_model(scene, name) for name in names}
    reference_error: dict[str, float] = {}
    if reference is not None:
        _require_converged(reference, results[reference])
        if coarser and study.uncertainty is not None:
            levels = [(mesh, results[reference])]
            for level in coarser:
                coarse_mesh = mesh_from_cache(level, cache, volume=True)
                coarse = models.run_model(build_scene(study, coarse_mesh), reference)
                _require_converged(f"{reference} on a coarser mesh", coarse)
                levels.append((coarse_mesh, coarse))
            reference_error = mesh_level_error(levels, study.uncertainty.ratio)
    write_case(
        Path(task["path"]),
        CaseResult(
            hash=task["id"],
            label=task["label"],
            swept=task["swept"],
            swept_units=task["swept_units"],
            resolved=task["study"],
            provenance=provenance(mesh),
            points=mesh.surface_points,
            triangles=mesh.triangles,
            load_factors=scene.load_factors,
            regions=scene.regions,
            models=results,
            metrics=compare(scene, results, reference),
            reference=reference,
            reference_error=reference_error,
            mesh_quality={
                **mesh.quality,
                "tetrahedra": len(mesh.tetrahedra),
                "surface_nodes": len(mesh.surface_nodes),
            },
        ),
    )


def compare(
    scene: Scene, results: Mapping[str, ModelResult], reference: str | None
) -> dict[str, dict[str, MetricSeries]]:
    """Every metric of every model; the reference itself gets those that need no comparison."""
    surface = Surface(scene.mesh.surface_points, scene.mesh.triangles, scene.contact)
    histories = {
        name: History(result.displacement, result.reaction_force, scene.load_factors)
        for name, result in results.items()
    }
    out = {}
    for name, history in histories.items():
        other = histories[reference] if reference is not None and name != reference else None
        out[name] = {
            metric: MetricSeries(
                values, METRICS[metric].unit, METRICS[metric].definition, METRICS[metric].version
            )
            for metric, values in evaluate(surface, history, other).items()
        }
    return out


def mesh_level_error(levels: list[tuple[Mesh, ModelResult]], ratio: float) -> dict[str, float]:
    """The reference's error at the last load step from mesh levels, finest first.

    Neighbouring levels are compared at the coarser one's surface nodes, relative to the finer one's displacement;
    the error holds what the mesh changes in the solution, the shape, the support and the load.
    """
    vector, deformation = [], []
    for (fine, fine_result), (coarse, coarse_result) in itertools.pairwise(levels):
        points = coarse.surface_points
        areas = Surface(points, coarse.triangles).areas
        u = coarse_result.displacement[-1]
        v = uncertainty.interpolate_on_surface(
            points, fine.surface_points, fine.triangles, fine_result.displacement[-1]
        )
        vector.append(relative_l2(u, v, areas))
        u, v = (rigid_motion_removed(points, w, areas) for w in (u, v))
        deformation.append(relative_l2(u, v, areas))
    estimate = uncertainty.estimate_error(vector, ratio)
    return {
        "relative_l2": estimate.error,
        "gci": estimate.gci,
        "observed_order": estimate.observed_order,
        "order_is_reasonable": float(estimate.reasonable),
        "relative_l2_deformation": uncertainty.estimate_error(deformation, ratio).error,
        "levels": float(len(levels)),
    }


def provenance(mesh: Mesh) -> dict[str, str]:
    """Where a case comes from: packages, platform, mesh, time."""
    return {
        **{f"package.{name}": version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": _processor(),
        "mesh_hash": mesh.content_hash,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")


def _require_converged(name: str, result: ModelResult) -> None:
    for status in result.status:
        if not status.ok:
            raise TaskError(f"{name}: {status.message}", status.remedy)
    if not np.isfinite(result.displacement).all():
        raise TaskError(
            f"{name} gave a displacement that is not finite", "check the scene's supports and loads"
        )
