"""Every metric of every model on a scene, as a case has them."""

from __future__ import annotations

from collections.abc import Mapping

from studies.case import MetricSeries, ModelResult
from studies.graph import work
from studies.scene import Scene


def compare(
    scene: Scene, results: Mapping[str, ModelResult], reference: str | None
) -> dict[str, dict[str, MetricSeries]]:
    """Against the reference; without one each by itself."""
    surface = work._Block(scene.mesh).surface(scene)
    return work.compare(surface, results, scene.load_factors, reference)
