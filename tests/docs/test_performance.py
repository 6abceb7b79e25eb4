"""README's performance section follows from a benchmark's numbers; here from some chosen by hand."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.bench.test_bench import CONDENSED, LINEAR, VECTOR
from tools import marked, performance
from tools.runs import ROOT
from vdmbench.bench import YARDSTICK, Bench
from vdmbench.cli.verb_bench import run as bench_verb

MACHINE = {"processor": "a processor", "cores": "2", "memory": "8.6 GB", "rounds": "3"}


def bench() -> Bench:
    """Three models on four meshes of a ball and one of an organ; set-up as the nodes, frame as their root."""
    entries = [
        replace(
            e, nodes=n, setup=n * 1e-4 * np.ones(3), frame_all=np.sqrt(n) * np.ones(3), peak_bytes=1e4 * n
        )
        for n in (100, 200, 400, 800)
        for e in (VECTOR, CONDENSED, LINEAR, replace(VECTOR, model="vdm-vector:quasi-linear"))
    ]
    entries += [replace(e, body="organ", nodes=300) for e in (VECTOR, CONDENSED, LINEAR)]
    return Bench(MACHINE, entries)


def test_the_section_has_the_machine_the_finest_meshes_and_the_answers() -> None:
    text = performance.section(bench())
    assert text.startswith(
        "a processor, 2 cores, 8.6 GB, one thread; medians of 3 rounds, in each a frame below 20 ms is the "
        "median of five samples of 1 ms or more; the interquartile range over the rounds is 0 % of the median for "
        "the typical time and 0 % at most; ball"
    )
    assert "ball (800 surface nodes), organ (300 surface nodes)" in text
    rows = [line for line in text.splitlines() if line.startswith(("| ball | ", "| organ | "))]
    assert len(rows) == 6, "of solvers that only differ in theirs, one stands for all"
    assert "| ball | fem-linear | 80 ms | 28.3 s | – | 50 ms | 100 ms | 8.00 MB | ~3 % ± 1 % |" in rows
    assert "| question | ball, 800 nodes | organ, 300 nodes |" in text
    assert "\n| Most accurate at 1 ms a frame of a contact | " in text
    assert (
        "| vdm-vector | 0.1 to 1 | – | 0.02 to 0.02 | 1 to 1 | 0.1 to 0.1 | 20 % ± 1 % to 20 % ± 1 % |"
        in text
    )


def test_the_figure_has_a_panel_for_each_body_and_names_its_models() -> None:
    root = ET.fromstring(performance.picture(bench()))
    panels = [part for part in root if part.tag.endswith("svg")]
    assert len(panels) == 2
    width = float(root.get("width", ""))
    edges = [(float(p.get("x", "")), float(p.get("x", "")) + float(p.get("width", ""))) for p in panels]
    assert 0 <= edges[0][0] < edges[0][1] <= edges[1][0] < edges[1][1] <= width
    words = "".join(root.itertext())
    assert {"ball, 800 nodes", "vdm-vector", "fem-condensed"} <= set(re.split(r"\n|[●■▲◆▼✚✖\u2003] ?", words))


def in_seconds(shown: str) -> float:
    number, unit = shown.split()
    return float(number) * {"s": 1.0, "ms": 1e-3, "µs": 1e-6}[unit]


def test_the_multiples_are_those_of_its_own_table() -> None:
    """As `performance.relative` makes them, from rounded times: what is measured is not kept with the sources."""
    blocks = marked.shown(performance.DOCUMENT, performance.PART).split("\n\n")
    tables = {tuple(rows[0][:2]): rows for text in blocks if (rows := marked.cells(text))}
    costs, multiples = tables["body", "model"], tables["model", "set-up"]
    rows = [dict(zip(costs[0], row, strict=True)) for row in costs[1:]]
    bodies = dict.fromkeys(row["body"] for row in rows)
    known = {(row["body"], row["model"]): row for row in rows}
    assert [row[0] for row in multiples[1:]] == list(performance.COMPARED)
    for row in multiples[1:]:
        told = dict(zip(multiples[0], row, strict=True))
        mine = [known[body, told["model"]] for body in bodies]
        for cost in ("set-up", "columns", "frame, contact", "frame, all nodes", "re-cut"):
            if any(entry[cost] == "–" for entry in mine):
                assert told[cost] == "–"
                continue
            found = [
                in_seconds(entry[cost]) / in_seconds(known[entry["body"], YARDSTICK][cost]) for entry in mine
            ]
            shown = [float(number.replace(",", "")) for number in told[cost].split(" to ")]
            # three digits of either time, two of their ratio
            np.testing.assert_allclose(shown, [min(found), max(found)], rtol=0.06, atol=0, err_msg=cost)
        errors = sorted((entry["error"] for entry in mine), key=lambda e: float(e.strip("~").split(" %")[0]))
        assert told["error"] == f"{errors[0]} to {errors[-1]}"


def test_what_was_measured_stays_where_the_section_is_made_from_it_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command runs for an hour: here its verb, with the measurement in place of measuring."""

    def command(*words: str | Path, **_: object) -> None:
        given = Namespace(study=None, surface=None, allow_outside=False, json=False, out=None)
        given.out = words[words.index("--out") + 1]
        assert bench_verb(given) == 0

    kept = "results/bench/bench.json"
    assert f"--bench {kept}" in performance.DOCUMENT.read_text()
    monkeypatch.setattr("vdmbench.bench.measure", lambda *_, **__: bench())
    monkeypatch.setattr(performance, "finished", command)
    monkeypatch.setattr(performance, "DOCUMENT", tmp_path / "README.md")
    monkeypatch.setattr(performance, "GALLERY", tmp_path)
    monkeypatch.setattr(performance, "MEASURED", tmp_path / kept)
    assert "results/bench/" in (ROOT / ".gitignore").read_text().splitlines()
    made = []
    for options in ([], ["--bench", str(tmp_path / kept)]):
        (tmp_path / "README.md").write_text("<!-- performance -->\n<!-- /performance -->\n")
        monkeypatch.setattr("sys.argv", ["performance", *options])
        performance.main()
        made.append((tmp_path / "README.md").read_text())
        monkeypatch.setattr(performance, "finished", None)  # from now on nothing is measured
    assert made[0] == made[1]
    assert performance.section(bench()) in made[0]
