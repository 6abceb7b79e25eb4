"""The scene's picture: parts, arrows and scale are where the arrays say, seen from where they show."""

import io

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from tests.report.runs import icosphere
from vdmbench.report.scene_picture import KINDS, Part, Stage, scene_figure, scene_png, scene_svg

POINTS, TRIANGLES = icosphere(3)
POINTS = 0.05 * POINTS
ON_TOP, BELOW = POINTS[:, 2] > 0.04, POINTS[:, 2] < -0.035
SUPPORT = Part("base", "fixed", BELOW)


def finger(*force: float) -> Part:
    return Part("finger", "contact", ON_TOP, np.array(force), "0.1 N")


def stage(*parts: Part) -> Stage:
    return Stage(POINTS, TRIANGLES, parts)


def hued(pixels: np.ndarray, kind: str) -> np.ndarray:
    """Mask of the pixels that have a kind's hue, whatever the light."""
    wanted = np.array(to_rgb(KINDS[kind][1]))
    colours = pixels[..., :3] / np.maximum(pixels[..., :3].max(axis=2, keepdims=True), 1)
    return np.abs(colours - wanted / wanted.max()).max(axis=2) < 0.06


def arrow_of(figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """Tail and head of the first arrow."""
    arrow = next(text for text in figure.axes[0].texts if text.arrow_patch is not None)
    return np.array(arrow.xyann), np.array(arrow.xy)


def test_parts_have_their_colours_where_they_are_and_every_run_draws_the_same() -> None:
    png, again = (
        scene_png(stage(SUPPORT, finger(0, 0, -0.1)), ["E 5 kPa"], title="A ball", dpi=100) for _ in range(2)
    )
    assert png == again
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(float)
    drawing = pixels[: int(0.78 * len(pixels))]  # without the legend
    contact, support = hued(drawing, "contact"), hued(drawing, "fixed")
    assert contact.sum() > 500
    assert support.sum() > 100
    assert np.nonzero(contact)[0].max() < np.nonzero(support)[0].mean(), "the finger is above"
    bare = scene_png(stage(), dpi=100)
    assert not hued(np.asarray(Image.open(io.BytesIO(bare)).convert("RGB")).astype(float), "contact").any()


@pytest.mark.parametrize("nodes", [ON_TOP, np.arange(len(POINTS)) == POINTS[:, 2].argmax()])
@pytest.mark.parametrize(("force", "outside"), [((0, 0, -0.1), "tail"), ((0, 0, 0.1), "head")])
def test_the_arrow_has_the_direction_of_the_force_and_stays_outside(
    force: tuple[float, ...], outside: str, nodes: np.ndarray
) -> None:
    pushed = Part("finger", "contact", nodes, np.array(force), "0.1 N")
    tail, head = arrow_of(scene_figure(stage(SUPPORT, pushed)))
    assert np.sign(head[1] - tail[1]) == np.sign(force[2])
    assert abs(head[0] - tail[0]) < 1e-9
    assert (tail[1] if outside == "tail" else head[1]) > 0.055
    assert (head[1] if outside == "tail" else tail[1]) == pytest.approx(
        0.05 * np.cos(np.radians(22)), abs=0.004
    )


def test_the_camera_looks_at_a_part_on_any_side() -> None:
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        seen = stage(Part("side", "contact", POINTS @ [x, y, 0] > 0.04))
        hidden, shown = scene_figure(seen).axes[0].collections
        assert len(shown.get_segments()) > 3 * len(hidden.get_segments()), (x, y)
    first, again = (scene_svg(seen, alt="", salt="s") for _ in range(2))
    assert first == again


def test_lone_nodes_show_as_dots() -> None:
    lone = np.zeros(len(POINTS), dtype=bool)
    lone[[5, 7]] = True
    figure = scene_figure(stage(Part("pins", "fixed", lone)))
    assert [len(line.get_xdata()) for line in figure.axes[0].lines] == [2]
    whole = scene_figure(stage(SUPPORT))
    assert [len(line.get_xdata()) for line in whole.axes[0].lines] == [0]


def test_the_scale_bar_has_the_length_it_tells_and_the_legend_names_the_parts() -> None:
    parts = [SUPPORT, finger(0, 0, -0.1)]
    for size, told in ((1.0, "20 mm"), (0.02, "500 µm")):
        figure = scene_figure(Stage(size * POINTS, TRIANGLES, parts), ["E 5 kPa, nu 0.49"])
        drawing, foot = figure.axes
        left, right = foot.lines[0].get_xdata()
        figure.draw_without_rendering()  # the aspect decides the drawing's width
        inches = drawing.get_window_extent().width / figure.dpi
        metres = (right - left) * np.ptp(drawing.get_xlim()) / inches
        assert foot.texts[0].get_text() == told
        factor = {"mm": 1e-3, "µm": 1e-6}[told.split()[1]]
        assert metres == pytest.approx(float(told.split()[0]) * factor, rel=1e-6)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["support: base", "contact: finger"]
    assert "E 5 kPa, nu 0.49" in [text.get_text() for text in figure.texts]


def test_a_flat_body_a_body_of_no_size_and_names_to_escape_are_drawn() -> None:
    odd = Part("$<b>", "constrained", BELOW, np.array([0.0, 0.0, 1e-3]), "$1 <mm")
    for scale in ([1, 1, 1e-3], [1e-3, 1e-3, 1], [0, 0, 0]):
        svg = scene_svg(Stage(POINTS * scale, TRIANGLES, [odd]), alt='"<', salt="s")
        assert "<b>" not in svg
        assert 'aria-label="&#34;&lt;"' in svg
        assert "var(--ink)" in svg
