"""Bodies in parts on trial: slender, thick, thin-walled, forked and hollow ones, and lumps, beside elements.

And what parts cost on finer and finer meshes, beside one body of boundary elements and its sparse form, and what
frames of a body in parts take.
"""

from __future__ import annotations

import math
import resource
import signal
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import gmsh
import numpy as np
import tomli_w

from tools.documents import RUNS, table
from tools.evidence import EVIDENCE, MEASURES, as_per_cent, ran_text, slashed, study_of
from vdm.constraints import Load
from vdm.material import Parameters
from vdm.model import Model
from vdm.parts.solve import PartsSolver
from vdm.problem import Step
from vdmbench.body.mesh import Mesh
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.body.refine import refined
from vdmbench.body.surface_measures import Surface, relative_l2
from vdmbench.machine import cache_directory
from vdmbench.measures.case import CaseResult
from vdmbench.measures.frame import series
from vdmbench.measures.reference import level_scene, own_error, restricted
from vdmbench.measures.uncertainty import reference_bar
from vdmbench.models import Prepared
from vdmbench.models.frames import contact_frame, median_seconds, pressure_everywhere
from vdmbench.scene.result import ModelResult
from vdmbench.scene.scene import build_scene
from vdmbench.study.config import Study
from vdmbench.study.files import merged
from vdmbench.verdict.formatting import NOTHING, quantity

OWN = EVIDENCE["parts"]
FORM = OWN["study"]["study"]["models"][0]
BODIES = RUNS / "parts" / "bodies"  # files of bodies that no shape of a study is
COSTS = EVIDENCE["costs"]


def _write(path: Path) -> None:
    """The body of this name [m]: a cup, its rim at x = 60 mm, or a fork of two prongs along x."""
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 4.0)
        occ = gmsh.model.occ
        if path.stem == "cup":
            occ.cut(
                [(3, occ.addCylinder(0, 0, 0, 60, 0, 0, 25))], [(3, occ.addCylinder(12, 0, 0, 60, 0, 0, 15))]
            )
        else:
            prongs = [(3, occ.addCylinder(35, 0, 0, 50, y, 0, 8)) for y in (-30, 30)]
            occ.fuse([(3, occ.addCylinder(0, 0, 0, 42, 0, 0, 10))], prongs)
        occ.dilate(occ.getEntities(3), 0, 0, 0, 1e-3, 1e-3, 1e-3)
        occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.004)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def _run(name: str, text: str) -> list[CaseResult]:
    """Its cases; one whose reference ends on the way is compared where that ended."""
    BODIES.mkdir(parents=True, exist_ok=True)
    for file in (BODIES / "cup.stl", BODIES / "fork.stl"):
        if not file.exists():
            _write(file)
    return ran_text(text, f"parts/{name}", codes=(0, 3), files=BODIES.iterdir()).cases


def row(body: str, load: str, case: CaseResult, form: str = FORM) -> list[str]:
    """A line of the table, at the largest load that elements and parts both reached."""
    result = case.models[form]
    at = max(step for step in range(case.reached + 1) if result.status[step].ok)
    moved = np.linalg.norm(case.models[str(case.reference)].displacement[at], axis=1).max()
    parts = result.scalars["parts"][at] if "parts" in result.scalars else 1.0
    status = result.status[case.reached]
    told = status.message if status.ok else f"{status.code}: {status.message}"
    errors = [float(values[at]) for m in MEASURES if (values := series(case, form, m)) is not None]
    own = [reference_bar(case.reference_error, m) for m in MEASURES]
    return [
        body, load, str(len(case.points)), f"{1e3 * moved:.3g} mm", f"{parts:.0f}", slashed(errors), slashed(own),
        told or "nothing",
    ]  # fmt: skip


def parts(arguments: Sequence[str]) -> Iterator[list[str]]:
    """All lines that are measured anew, of a surface that is named too."""
    for body in OWN["bodies"]:
        for load in OWN["loads"]:
            if not (load == "weight" and body == "bladder"):
                name = f"{body}-{load}"
                (case,) = _run(name, study_of(OWN, body, load, name=name))
                yield row(body, load, case)
    for surface in map(Path, arguments):
        text: dict[str, Any] = OWN["liver"] | {"study": {"name": "liver", **OWN["study"]["study"]}}
        text["geometry"] = {**text["geometry"], "path": f"liver{surface.suffix}"}
        (BODIES / f"liver{surface.suffix}").write_bytes(surface.read_bytes())
        yield from (row("liver, 4 kPa", "weight", case) for case in _run("liver", tomli_w.dumps(text)))
    yield from lumps()


def lumps() -> Iterator[list[str]]:
    """The lines of a ball with and without lumps."""
    for k, (name, inside) in enumerate(OWN["lumpy"].items()):
        text = merged(OWN["lumps"], {"study": {"name": f"lumps-{k}"}, **inside})
        (case,) = _run(f"lumps-{k}", tomli_w.dumps(text))
        yield row(name, "contact", case, "bem")


def parts_page(lines: Sequence[Sequence[str]]) -> str:
    """The table, and what it comes to."""
    off = [line for line in lines if not max(map(float, line[5].split(" / "))) < 100 * OWN["limit"]]
    silent = sum(line[-1] == "nothing" for line in off)
    return table(OWN["head"], lines) + (
        f"\n{len(lines) - len(off)} of {len(lines)} are within {100 * OWN['limit']:.0f} % in both errors. "
        f"Of the other {len(off)} the model gives {silent} without a reservation.\n"
    )


# --- costs ---


class Cost(NamedTuple):
    """What a form answers on a surface and takes, in seconds of processor time.

    `contact` is a frame of the contact by its columns, NaN where there are none; `whole` all of set-up, answers and
    what is told of their errors.
    """

    surface: Surface
    result: ModelResult
    contact: float
    whole: float


def cost(given: Mapping[str, Any], level: int) -> Cost:
    """Of a study's only model on its mesh split so often; in a process of its own.

    Raises
    ------
    MemoryError, TimeoutError
        what takes more than the limits of the entry.
    """

    def too_long(*_: object) -> None:
        raise TimeoutError(f"more than {COSTS['seconds'] / 60:.0f} minutes")

    signal.signal(signal.SIGXCPU, too_long)
    resource.setrlimit(resource.RLIMIT_CPU, (COSTS["seconds"], COSTS["seconds"] + 60))
    resource.setrlimit(resource.RLIMIT_AS, (int(COSTS["bytes"]),) * 2)
    time.perf_counter = time.thread_time  # the clock that models read: others take none of it
    study, whole_mesh = body(given)
    (model,) = study.study.models
    hierarchy = refined(whole_mesh, level)
    mesh, scene = hierarchy.meshes[0], level_scene(study, hierarchy)
    start = time.thread_time()
    prepared = Prepared(scene, model, len(scene.load_factors))
    result = restricted(prepared.answer(scene.loads), hierarchy)
    whole = time.thread_time() - start
    contact, problem = math.nan, prepared.set_up.problem if prepared.set_up else None
    if problem is not None and not model.startswith("fem"):
        frame, pressure = contact_frame(problem, scene), scene.contact_pressure[scene.contact]
        frame(pressure)
        frame(pressure)  # shortens the columns
        contact = median_seconds(lambda: frame(pressure))
    return Cost(Surface(mesh.surface_points, mesh.triangles), result, contact, whole)


def body(given: Mapping[str, Any]) -> tuple[Study, Mesh]:
    """A study, by its tables, and its mesh."""
    study = Study.model_validate(given)
    return study, mesh_from_cache(study.geometry, cache_directory())


def measured(given: Mapping[str, Any], level: int = 0) -> Cost | str:
    """The cost of a study's only model, or why there is none."""
    print(*given["study"]["models"], given.get("vdm", ""), level, file=sys.stderr)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            found = pool.submit(cost, given, level).result()
        except TimeoutError as error:
            return f"{error}"
        except MemoryError:
            return f"more than {COSTS['bytes'] / 1e9:.0f} GB"
        except BrokenProcessPool:
            return "its process was killed"
    status = found.result.status[0]
    return found if status.ok else status.message


def costs_of(size: str) -> Iterator[list[str]]:
    """The lines of one mesh: every form beside `fem-linear` at a thousandth of the load and `fem` at all of it."""
    factors = COSTS["factors"]

    def asked(model: str, factors: Sequence[float], **vdm: int) -> dict[str, Any]:
        own = {"models": [model]}, {"mesh_size": size}, {"factors": factors}, vdm
        return merged(COSTS["study"], dict(zip(("study", "geometry", "load", "vdm"), own, strict=True)))

    nodes = str(len(body(asked("bem", factors))[1].surface_nodes))
    references = list[list[Cost]]()
    for model, at in (("fem-linear", factors[:1]), ("fem", factors[:2])):
        levels = levels_of(asked(model, at))
        if isinstance(levels, str):
            yield [nodes, model, NOTHING, levels, *[NOTHING] * 7]
        references.append([] if isinstance(levels, str) else levels)
    for model, _, parts in (form.partition("/") for form in COSTS["forms"]):
        found = measured(asked(model, factors, **({"parts": int(parts)} if parts else {})))
        if isinstance(found, str):
            yield [nodes, model, parts or "1", found, *[NOTHING] * 7]
            continue
        result = found.result
        errors = [
            error_of(result.displacement[at], levels, found.surface, at)
            for at, levels in enumerate(references)
        ]
        first, *frames = result.seconds_per_step[1:]
        seconds = (found.contact, first, float(np.median(frames)), found.whole)
        contact, answer, frame, whole = (quantity(taken, "s") for taken in seconds)
        about = [quantity(result.seconds_setup, "s"), quantity(result.peak_bytes, "B")]
        yield [nodes, model, parts or "1", *about, contact, errors[0], answer, frame, errors[1], whole]


def costs(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The lines of all meshes, or of those of the sizes that are named."""
    for size in arguments or COSTS["sizes"]:
        yield from costs_of(size)


def costs_page(lines: Sequence[Sequence[str]]) -> str:
    """The coarsest mesh first."""
    return table(COSTS["head"], sorted(lines, key=lambda line: int(line[0])))


def levels_of(given: Mapping[str, Any]) -> list[Cost] | str:
    """A reference on the mesh split once, where eight times the cost is within limits, and on the mesh itself.

    Or why there is none.
    """
    own = measured(given)
    if isinstance(own, str):
        return own
    fits = 8 * own.whole < COSTS["seconds"] and 8 * own.result.peak_bytes < COSTS["bytes"]
    split = measured(given, 1) if fits else ""
    return [own] if isinstance(split, str) else [split, own]


def error_of(u: np.ndarray, levels: Sequence[Cost], surface: Surface, step: int) -> str:
    """Of a displacement (N, 3) against the finest of some levels at a step, ± that one's own."""
    if not np.isfinite(u).all():
        return "no balance"
    if not levels:
        return NOTHING
    factors = np.array(COSTS["factors"][: len(levels[0].result.displacement)])
    off = relative_l2(u, levels[0].result.displacement[step], surface.areas)
    if len(levels) == 1:
        return f"{as_per_cent(off)} ± ?"
    own = own_error(surface, [level.result for level in levels], factors)
    return f"{as_per_cent(off)} ± {as_per_cent(own['gci:relative_l2_displacement_error'])}"


# --- frames ---


def frames(_: Sequence[str]) -> Iterator[list[str]]:
    """A line for each load that moves all of a body in parts: frames from the last state, a hundredth apart.

    One after another, without what is told of an answer's errors, which a history asks for after each.
    """
    own = EVIDENCE["frames"]
    study, mesh = body(merged(COSTS["study"], own["study"]))
    scene, weight = build_scene(study, mesh), np.array([0.0, 0.0, -9.81])
    everywhere = pressure_everywhere(scene)

    def load(finger: float, elsewhere: float = 0.0) -> Load:
        pressed = replace(scene, facet_pressure=finger * scene.facet_pressure + elsewhere * everywhere)
        acting = pressed.load(1.0)
        return Load(acting.contact_pressure, acting.contact_force)

    shares = 0.01 * np.arange(own["frames"])
    histories = {
        "its weight": (weight, [replace(load(0.0), weight=1.0 + share) for share in shares]),
        "a pressure on its tip": (0.0 * weight, [load(1.0 + share) for share in shares]),
        "two pressures, apart": (  # once around in six frames
            0.0 * weight,
            [load(1.0 + 0.01 * np.cos(100 * share), 1.0 + 0.01 * np.sin(100 * share)) for share in shares],
        ),
    }
    tissue = study.tissue
    mu = tissue.youngs_modulus / (2.0 * (1.0 + tissue.poisson_ratio))
    material = Parameters(shear_modulus=mu, poisson_ratio=tissue.poisson_ratio, parts=study.vdm.parts)
    for name, (gravity, loads) in histories.items():
        model = Model(
            mesh.surface_points,
            mesh.triangles,
            material,
            formulation="bem",
            solver="nonlinear",
            fixed=scene.fixed,
            density=tissue.density,
            gravity=gravity,
        )
        assert isinstance(model.solver, PartsSolver)
        model.solver.prepare(loads, compared=False)
        steps, taken = list[Step](), list[float]()
        for acting in loads:
            start = time.thread_time()
            steps.append(model.solver.step(acting, steps[-1] if steps else None))
            _ = steps[-1].reaction_force, steps[-1].energy
            taken.append(time.thread_time() - start)
        moved = np.linalg.norm(steps[0].displacement, axis=1).max()
        corrections = np.mean([step.iterations for step in steps[own["first"] :]])
        yield [
            name, str(len(mesh.surface_nodes)), f"{model.solver.body.n_parts}", f"{1e3 * moved:.3g} mm",
            f"{corrections:.1f}",
            *(quantity(float(of(taken[own["first"] :])), "s") for of in (np.median, np.min, np.max)),
        ]  # fmt: skip
