"""What a worker process does: make one mesh, or run one case from its mesh to its file."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from . import models
from .case import CaseResult, MetricSeries, ModelResult
from .config import geometry_of
from .geometry_spec import Geometry
from .mesh import Mesh
from .mesh_cache import mesh_from_cache
from .metrics import METRICS, History, Surface, evaluate
from .plan import needs_volume
from .reference import refined_reference, require_converged
from .scene import Scene, build_scene
from .schema import Study
from .small_strain import small_strain_limits
from .store import write_case

REFINED = " refined"  # what the reference's name gets where it is solved on refinements of the case's mesh
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
    names = list(study.study.models)
    reference = study.study.reference
    mesh = mesh_from_cache(geometry_of(study), Path(task["cache"]), volume=needs_volume(study))
    scene = build_scene(study, mesh)
    results = {name: models.run_model(scene, name) for name in names}
    reference_error: dict[str, float] = {}
    if reference is not None:
        require_converged(reference, results[reference])
        if study.uncertainty is not None:
            on_case_mesh, n_levels = results[reference], study.uncertainty.levels
            finest, reference_error = refined_reference(study, scene, reference, on_case_mesh, n_levels)
            reference += REFINED
            results[reference] = finest
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
            small_strain=small_strain_limits(study, scene) if study.limits is not None else None,
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
