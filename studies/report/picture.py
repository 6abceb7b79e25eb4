"""Still pictures of the key cases, for print and where WebGL is missing: rendered off-screen by pyvista.

The rendering runs in a child process, because VTK crashes the process that asks it to draw where no GL library
works. The child looks for the libraries before it touches VTK.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

# off-screen GL: the library and the VTK window class that uses it
_LIBRARIES = (("libEGL.so.1", "vtkEGLRenderWindow"), ("libOSMesa.so.8", "vtkOSOpenGLRenderWindow"))
_PANEL = 420  # pixels
_MARGIN = 1.06  # of the body's extent, seen from the camera
_SHAPES = (0.45, 1.1)  # least and largest height of a panel over its width
_TIMEOUT = 120.0  # seconds for all pictures together
_ELEVATION = np.radians(22.0)
_PACKAGE_ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Panel:
    """One drawing: N nodes where they are drawn, and a value at each between 0 and 1."""

    points: np.ndarray  # (N, 3)
    triangles: np.ndarray  # (F, 3)
    values: np.ndarray  # (N,)
    colour_map: str
    azimuth: float  # about z, from where it is seen [rad]


def render(pictures: Sequence[Sequence[Panel]]) -> tuple[list[bytes], str]:
    """PNG files, one per picture of panels side by side, and "", or no files and why there are none."""
    with tempfile.TemporaryDirectory(prefix="vdmbench-pictures-") as name:
        directory = Path(name)
        for k, panels in enumerate(pictures):
            arrays: dict[str, Any] = {}
            for j, panel in enumerate(panels):
                arrays |= {
                    f"points{j}": panel.points,
                    f"triangles{j}": panel.triangles,
                    f"values{j}": panel.values,
                }
            np.savez(directory / f"{k}.npz", **arrays)
            about = [{"colour_map": p.colour_map, "azimuth": p.azimuth} for p in panels]
            (directory / f"{k}.json").write_text(json.dumps(about))
        why = _run_child(directory)
        files = [directory / f"{k}.png" for k in range(len(pictures))]
        if why or not all(file.exists() for file in files):
            return [], why or "the renderer made no picture"
        return [file.read_bytes() for file in files], ""


def _run_child(directory: Path) -> str:
    path = os.pathsep.join(filter(None, [str(_PACKAGE_ROOT), os.environ.get("PYTHONPATH", "")]))
    try:
        done = subprocess.run(
            [sys.executable, "-m", "studies.report.picture", str(directory)],
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"the renderer took more than {_TIMEOUT:.0f} s"
    if done.returncode < 0:
        return "the renderer crashed, as VTK does without a working GL driver; install libegl1 and libgl1-mesa-dri"
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "the renderer failed"
    return ""


def _off_screen_window() -> str | None:
    for library, window in _LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return window
    return None


def main(arguments: Sequence[str]) -> None:
    """The child: draws every picture of a directory.

    Raises
    ------
    SystemExit
        no off-screen GL library on this machine.
    """
    window = _off_screen_window()
    if window is None:
        raise SystemExit("no off-screen GL library on this machine; install libegl1")
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = window
    for file in sorted(Path(arguments[0]).glob("*.npz")):
        with np.load(file, allow_pickle=False) as arrays:
            _draw(dict(arrays), json.loads(file.with_suffix(".json").read_text()), file.with_suffix(".png"))


def _directions(azimuth: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors towards the viewer, to the right and up, seen from an azimuth about z [rad]."""
    cos, sin, level, rise = np.cos(azimuth), np.sin(azimuth), np.cos(_ELEVATION), np.sin(_ELEVATION)
    return (
        np.array([cos * level, sin * level, rise]),
        np.array([-sin, cos, 0.0]),
        np.array([-cos * rise, -sin * rise, level]),
    )


def _draw(arrays: Mapping[str, np.ndarray], panels: Sequence[Mapping[str, Any]], path: Path) -> None:
    import pyvista  # only here, in the child

    everything = np.concatenate([arrays[f"points{j}"] for j in range(len(panels))])
    towards, right, up = _directions(float(panels[0]["azimuth"]))
    low, high = (f([everything @ axis for axis in (right, up, towards)], axis=1) for f in (np.min, np.max))
    half_width, half_height, half_depth = np.maximum(_MARGIN * (high - low) / 2, 1e-12)
    centre = np.stack([right, up, towards], axis=1) @ ((low + high) / 2)
    height = round(_PANEL * float(np.clip(half_height / half_width, *_SHAPES)))
    plotter: Any = pyvista.Plotter(
        off_screen=True, shape=(1, len(panels)), border=False, window_size=[_PANEL * len(panels), height]
    )
    for j, about in enumerate(panels):
        plotter.subplot(0, j)
        points, triangles = arrays[f"points{j}"], arrays[f"triangles{j}"]
        mesh = pyvista.PolyData.from_regular_faces(points, triangles)
        plotter.add_mesh(
            mesh,
            scalars=arrays[f"values{j}"],
            clim=(0.0, 1.0),
            cmap=about["colour_map"],
            show_scalar_bar=False,
            smooth_shading=False,
            ambient=0.35,
            diffuse=0.7,
            specular=0.0,
        )
        plotter.enable_parallel_projection()
        plotter.camera_position = [tuple(centre + 4 * half_depth * towards), tuple(centre), (0.0, 0.0, 1.0)]
        plotter.camera.parallel_scale = max(half_height, half_width * height / _PANEL)
        plotter.reset_camera_clipping_range()
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(str(path), transparent_background=True)
    plotter.close()


if __name__ == "__main__":
    main(sys.argv[1:])
