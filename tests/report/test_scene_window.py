"""The scene in a window: drawn off screen here, with every region in its colour."""

from __future__ import annotations

import numpy as np
import pytest

from tests.command import write_study
from tests.vdm.vdm_shapes import icosphere
from vdmbench.cli.arguments import parse
from vdmbench.cli.output import UsageError
from vdmbench.report.scene_picture import KINDS, Part
from vdmbench.report.scene_window import scene_plotter


def test_body_regions_and_arrow_are_drawn() -> None:
    points, triangles = icosphere(2)
    top, base = points[:, 2] > 0.8, points[:, 2] < -0.8
    parts = [
        Part("base", "fixed", base, None, ""),
        Part("finger", "contact", top, np.array([0.0, 0.0, -1.0]), "0.1 N"),
    ]
    plotter = scene_plotter(points, triangles, parts, title="a ball", off_screen=True)
    try:
        colours = {
            name: actor.prop.color.hex_rgb for name, actor in plotter.actors.items() if hasattr(actor, "prop")
        }
        assert colours["base"] == KINDS["fixed"][1]
        assert colours["finger"] == KINDS["contact"][1]
        assert plotter.actors["finger"].mapper.dataset.n_cells == top[triangles].all(axis=1).sum()
        coloured = sum(part.nodes[triangles].all(axis=1).sum() for part in parts)
        assert plotter.actors["body"].mapper.dataset.n_cells == len(triangles) - coloured, (
            "no facet is drawn twice"
        )
        arrows = [name for name in plotter.actors if name not in {"body", "base", "finger"}]
        assert arrows, "the load has an arrow"
    finally:
        plotter.close()


def test_without_a_display_it_says_so(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    options = parse(["show", str(write_study(tmp_path)), "--window"])
    with pytest.raises(UsageError, match="no display here"):
        options.verb(options)
