"""Every metric of every model on a scene, as a case has them."""

from __future__ import annotations

from collections.abc import Mapping

from vdmbench.measures.case import MetricSeries
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import Scene
from vdmbench.work import case


def compare(
    scene: Scene, results: Mapping[str, ModelResult], reference: str | None
) -> dict[str, dict[str, MetricSeries]]:
    """Against the reference; without one each by itself."""
    surface = case.loaded_surface(scene)
    return case.compare(surface, results, scene.load_factors, reference)
