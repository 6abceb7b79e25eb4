"""README's performance section, from `vdmbench bench`: `make performance`; or from a bench.h5 that is named."""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from studies.benchmark.bench_data import Bench, Entry, answers, median, seconds
from studies.benchmark.bench_store import read_bench
from tests.command import vdmbench

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
PICTURE = ROOT / "results" / "gallery" / "performance.svg"
MARKERS = "os^DvPX*<>phd"
_SECTION = re.compile(r"(<!-- performance -->\n).*?(<!-- /performance -->)", re.DOTALL)


def finest(bench: Bench) -> list[list[Entry]]:
    """The entries of the finest mesh of each body."""
    return [bench.on(mesh) for mesh in {mesh[0]: mesh for mesh in bench.meshes()}.values()]


def section(bench: Bench) -> str:
    """The machine, the table and the answers as Markdown."""
    machine = bench.machine
    bodies = finest(bench)
    sizes = " and ".join(f"{body[0].body} ({body[0].nodes:,} surface nodes)" for body in bodies)
    text = (
        f"{machine['processor']}, {machine['cores']} cores, one thread; medians of {machine['rounds']} rounds; "
        f"{sizes}. Errors are in the displacement, ± the reference's own.\n\n"
        "| body | model | set-up | frame, all nodes | frame, contact | re-cut | memory | error |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
    )
    for e in [e for body in bodies for e in body]:
        times = (seconds(median(values)) for values in (e.setup, e.frame_all, e.frame_local, e.recut))
        error = f"{100 * e.error:.3g} % ± {100 * e.bar:.2g} %"
        text += f"| {e.body} | {e.model} | {' | '.join(times)} | {e.peak_bytes / 1e6:.0f} MB | {error} |\n"
    return text + "\n" + "".join(f"- {line}\n" for line in answers(bench))


def picture(bench: Bench, path: Path) -> None:
    """Time against error on the finest mesh of each body: filled a contact frame, hollow a re-cut."""
    bodies = finest(bench)
    with rc_context({"svg.hashsalt": "performance", "font.size": 8.0, "svg.fonttype": "none"}):
        canvas = Figure(figsize=(4.4 * len(bodies) + 2.0, 3.6), layout="constrained")
        for axes, body in zip(
            canvas.subplots(1, len(bodies), sharey=True, squeeze=False)[0], bodies, strict=True
        ):
            for k, e in enumerate(body):
                colour, marker = f"C{k % 10}", MARKERS[k % len(MARKERS)]
                frame, recut = median(e.frame_local), median(e.recut)
                axes.plot([frame, recut], [100 * e.error] * 2, ":", color=colour, linewidth=1.0)
                axes.plot([recut], [100 * e.error], marker, color=colour, markerfacecolor="none")
                axes.plot([frame], [100 * e.error], marker, color=colour, label=e.model)
            axes.set(
                xscale="log",
                yscale="log",
                xlabel="time [s]",
                title=f"{body[0].body}, {body[0].nodes:,} nodes",
            )
        canvas.axes[0].set_ylabel("displacement error [%]")
        canvas.legend(*canvas.axes[0].get_legend_handles_labels(), loc="outside right center")
        canvas.savefig(path, metadata={"Date": None, "Creator": None})


def main() -> None:
    """Write the section and the figure; an argument names the benchmark's file."""
    with tempfile.TemporaryDirectory() as name:
        stored = Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else Path(name) / "bench" / "bench.h5"
        if len(sys.argv) == 1:
            result = vdmbench(
                "bench", "--out", "bench", cwd=Path(name), seconds=3600, OPENBLAS_NUM_THREADS="1"
            )
            if result.returncode:
                raise RuntimeError(result.stderr)
        bench = read_bench(stored)
    picture(bench, PICTURE)
    text = section(bench)
    README.write_text(_SECTION.sub(lambda found: found.group(1) + text + found.group(2), README.read_text()))


if __name__ == "__main__":
    main()
