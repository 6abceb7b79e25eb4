"""Bodies in parts on trial: slender, thick, thin-walled, forked and hollow ones, and lumps, beside elements.

And what parts cost on finer and finer meshes, beside one body of boundary elements and its sparse form, how far
their linear answers are from its own, and what set-up and frames of a body in parts take.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import tomli_w

from solver_common.arrays import Array, Mask
from tools.documents import RUNS, table
from tools.evidence import EVIDENCE, MEASURES, as_per_cent, ran_text, slashed, study_of
from vdm.constraints import Load
from vdm.material import Parameters
from vdm.model import Model
from vdm.parts.solve import PartsSolver
from vdm.problem import Step
from vdm.solvers.linear import LinearSolver
from vdm.surface import SurfaceMesh
from vdmbench.body.mesh import Mesh
from vdmbench.body.mesh_cache import mesh_from_cache
from vdmbench.body.refine import refined
from vdmbench.machine import cache_directory
from vdmbench.measures.case import CaseResult, Run
from vdmbench.measures.frame import series, where_reached
from vdmbench.measures.metrics import VECTOR
from vdmbench.measures.uncertainty import reference_bar
from vdmbench.models.frames import pressure_everywhere
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


def body_file(name: str) -> Path:
    """Of a body that no shape of a study is."""
    BODIES.mkdir(parents=True, exist_ok=True)
    if not (path := BODIES / name).exists():
        _write(path)
    return path


def _run(name: str, text: str) -> list[CaseResult]:
    """Its cases; one whose reference ends on the way is compared where that ended."""
    for file in ("cup.stl", "fork.stl"):
        body_file(file)
    return ran_text(text, f"parts/{name}", codes=(0, 3), files=BODIES.iterdir()).cases


def row(body: str, load: str, case: CaseResult, form: str = FORM) -> list[str]:
    """A line of the table, at the largest load that elements and parts both reached."""
    result = case.models[form]
    at = max(step for step in range(case.reached + 1) if result.status[step].ok)
    moved = np.linalg.norm(case.models[str(case.reference)].displacement[at], axis=1).max()
    share = case.load_factors[at] / case.load_factors[-1]
    acting = load if share == 1.0 else f"{load}, {share:.2g} of it"
    parts = result.scalars["parts"][at] if "parts" in result.scalars else 1.0
    status = result.status[case.reached]
    told = status.message if status.ok else f"{status.code}: {status.message}"
    errors = [float(values[at]) for m in MEASURES if (values := series(case, form, m)) is not None]
    own = [reference_bar(case.reference_error, m) for m in MEASURES]
    return [
        body, acting, str(len(case.points)), f"{1e3 * moved:.3g} mm", f"{parts:.0f}", slashed(errors), slashed(own),
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
    yield from soft(arguments)
    yield from lumps()


def soft(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The lines of soft bodies under their weight, of a surface that is named too."""
    bodies = dict[str, dict[str, Any]](OWN["held"])
    for surface in map(Path, arguments):
        file = BODIES / f"liver{surface.suffix}"
        file.write_bytes(surface.read_bytes())
        for body, about in OWN["surface"].items():
            bodies[body] = merged(about, {"geometry": {"path": file.name}})
    for body, about in bodies.items():
        name = body.replace(", ", "-").replace(" ", "-")
        text = merged(merged(OWN["soft"], about), {"study": {"name": name, **OWN["study"]["study"]}})
        yield from (row(body, "weight", case) for case in _run(name, tomli_w.dumps(text)))


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


def costs(arguments: Sequence[str]) -> Iterator[list[str]]:
    """A line for each mesh, or those of the sizes that are named, and each form."""
    for size, form in product(arguments or COSTS["sizes"], COSTS["forms"]):
        yield costs_row(size, form)


def costs_row(size: str, form: str) -> list[str]:
    """What a form takes for all loads; its errors: at the first beside `fem-linear`, at the second beside `fem`."""
    model, _, parts = form.partition("/")
    small, full, *_ = factors = COSTS["factors"]
    alone = costs_run(size, form, factors)
    ended = [one["message"] for one in alone.failed]
    ended += [one.message for case in alone.cases for one in case.models[model].status if not one.ok]
    if not alone.cases:
        _, mesh = body({"study": {"models": [model]}, "geometry": {"mesh_size": size}})
    about = [str(len(alone.cases[0].points if alone.cases else mesh.surface_nodes)), model, parts or "1"]
    if ended:
        return [*about, ended[0], *[NOTHING] * 6]
    result = alone.cases[0].models[model]
    _, first, *frames = result.seconds_per_step
    of_contact = np.median(result.frames.contact) if result.frames is not None else math.nan
    seconds = (result.seconds_setup, of_contact, first, np.median(frames))
    set_up, contact, first, frame = (quantity(float(taken), "s") for taken in seconds)
    errors = [costs_error(size, form, *held) for held in (("fem-linear", small), ("fem", full))]
    memory = quantity(result.peak_bytes, "B")
    return [*about, set_up, memory, contact, errors[0], first, frame, errors[1]]


def costs_error(size: str, form: str, reference: str, factor: float) -> str:
    """Of a form in displacement, ± the reference's own; NOTHING beside one that is too costly on this mesh."""
    levels = COSTS["sizes"][size].get(reference)
    for case in costs_run(size, form, [factor], reference, levels).cases if levels else ():
        off = where_reached(case, form.partition("/")[0], VECTOR)
        own = reference_bar(case.reference_error, VECTOR)
        if math.isfinite(off):
            return f"{as_per_cent(off)} ± {as_per_cent(own) if math.isfinite(own) else '?'}"
    return NOTHING


def costs_run(size: str, form: str, factors: Sequence[float], reference: str = "", levels: int = 1) -> Run:
    """A form on a mesh at some loads, alone or beside a reference on so many mesh levels."""
    model, _, parts = form.partition("/")
    name = "-".join(filter(None, (model, parts, reference, size))).translate(str.maketrans(": ", "--"))
    asked: dict[str, Any] = {"study": {"name": name, "models": [model]}, "geometry": {"mesh_size": size}}
    asked["load"] = {"factors": factors}
    if parts:
        asked["vdm"] = {"parts": int(parts)}
    if reference:
        asked["study"] |= {"models": [model, reference], "reference": reference}
    if levels > 1:
        asked["uncertainty"] = {"levels": levels}
    given = ("--timeout", str(COSTS["seconds"]))
    return ran_text(tomli_w.dumps(merged(COSTS["study"], asked)), f"costs/{name}", *given, codes=(0, 3))


def body(changes: Mapping[str, Any]) -> tuple[Study, Mesh]:
    """The study of the costs with changes, and its mesh."""
    study = Study.model_validate(merged(COSTS["study"], changes))
    return study, mesh_from_cache(study.geometry, cache_directory())


def costs_page(lines: Sequence[Sequence[str]]) -> str:
    """The coarsest mesh first."""
    return table(COSTS["head"], sorted(lines, key=lambda line: int(line[0])))


# --- agreement ---


def agreement(_: Sequence[str]) -> Iterator[list[str]]:
    """A line for each body and weight: how far linear answers are from that of a finer mesh, in per cent.

    That of one body, and those of parts, which are beside that too, on either mesh. The finer one has each facet of
    the same polyhedron in four, and holds the same of it.
    """
    own = EVIDENCE["agreement"]
    counts = (1, *own["parts"])
    for about, (name, weight) in product(own["bodies"], own["weights"].items()):
        mesh, held = _held_over(about)
        meshes = refined(mesh, 1)
        finest = meshes.finest
        coarse = [_linear(mesh, held, weight, count) for count in counts]
        fine = [_linear(finest, meshes.inherit(held), weight, count) for count in counts]
        yield [
            f"{about['name']}, {about['share']}", name, str(len(coarse[0])),
            *(_off(mesh, u, fine[0][: len(u)]) for u in coarse), *(_off(mesh, u, coarse[0]) for u in coarse[1:]),
            str(len(fine[0])), *(_off(finest, u, fine[0]) for u in fine[1:]),
        ]  # fmt: skip


def _off(mesh: Mesh, u: Array, other: Array) -> str:
    """How far a displacement (N, 3) of a surface is from another, in per cent of that, by area."""
    areas = np.sqrt(SurfaceMesh(mesh.surface_points, mesh.triangles).nodal_areas)[:, None]
    return as_per_cent(np.linalg.norm(areas * (u - other)) / np.linalg.norm(areas * other))


def _held_over(about: Mapping[str, Any]) -> tuple[Mesh, Mask]:
    """A body of the trial, or another shape, and the nodes held from its end along x over a share of it."""
    shape = about.get("geometry") or OWN["bodies"][about["name"]]["geometry"]
    if "path" in shape:
        shape = {**shape, "path": str(body_file(shape["path"]))}
    study = merged(COSTS["study"], EVIDENCE["agreement"]["study"])
    study = Study.model_validate(study | {"geometry": {**shape, "mesh_size": about["mesh"]}})
    mesh = mesh_from_cache(study.geometry, cache_directory())
    x = mesh.surface_points[:, 0]
    return mesh, x <= x.min() + about["share"] * np.ptp(x)


def _linear(mesh: Mesh, held: Mask, weight: Sequence[float], count: int = 1) -> Array:
    """(N, 3) linear answer to a weight of a body in so many parts; one knows its rims as `bem` does."""
    load = Load(np.zeros(len(mesh.surface_nodes)))
    material = Parameters(shear_modulus=1e4, poisson_ratio=0.49, parts=count)
    solver = _in_parts(mesh, held, material, 1e3 * np.array(weight), [load])
    return LinearSolver(solver.problem, factor=solver.factor).step(load).displacement


def _in_parts(
    mesh: Mesh, held: Mask, material: Parameters, weight: Array, loads: Sequence[Load]
) -> PartsSolver:
    """A body of a weight [N/m^3], ready for loads, without what tells of their errors."""
    model = Model(
        mesh.surface_points,
        mesh.triangles,
        material,
        formulation="bem",
        solver="nonlinear",
        fixed=held,
        density=1.0,
        gravity=weight,
    )
    assert isinstance(model.solver, PartsSolver)
    model.solver.prepare(loads, compared=False)
    return model.solver


# --- setup ---


def setup(arguments: Sequence[str]) -> Iterator[list[str]]:
    """A line for each body, and for a surface that is named: its set-up where the number of parts is found.

    By its own weight; processor time over that of one part, given, in turns, without what tells of errors.
    """
    own = EVIDENCE["setup"]
    files = [{"geometry": {"path": str(Path(surface).resolve())}} for surface in arguments]
    for about in (*own["bodies"], *(merged(own["surface"], file) for file in files)):
        mesh, held = _held_over(about)
        load, weight = Load(np.zeros(len(mesh.surface_nodes))), np.array(own["weight"])
        ratios, parts = list[float](), 0
        for turn in range(own["turns"] + 1):
            taken = [0.0, 0.0]
            for count in (0, 1) if turn % 2 else (1, 0):
                material = Parameters(
                    shear_modulus=about["modulus"] / 3.0, poisson_ratio=0.49, parts=count or None
                )
                start = time.process_time()
                solver = _in_parts(mesh, held, material, weight, [load])
                taken[count] = time.process_time() - start
                parts = parts if count else solver.body.n_parts
            ratios.append(taken[0] / taken[1])
        ratios = ratios[1:]  # the first turn warms
        yield [
            about["name"], str(len(mesh.surface_nodes)), f"{parts}",
            *(f"{of(ratios):.2f}" for of in (np.median, np.min, np.max)),
        ]  # fmt: skip


# --- frames ---


def frames(_: Sequence[str]) -> Iterator[list[str]]:
    """A line for each load that moves all of a body in parts: frames from the last state, a hundredth apart.

    One after another, without what is told of an answer's errors, which a history asks for after each.
    """
    own = EVIDENCE["frames"]
    study, mesh = body(own["study"])
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
        solver = _in_parts(mesh, scene.fixed, material, tissue.density * gravity, loads)
        steps, taken = list[Step](), list[float]()
        for acting in loads:
            start = time.thread_time()
            steps.append(solver.step(acting, steps[-1] if steps else None))
            _ = steps[-1].reaction_force, steps[-1].energy
            taken.append(time.thread_time() - start)
        moved = np.linalg.norm(steps[0].displacement, axis=1).max()
        corrections = np.mean([step.iterations for step in steps[own["first"] :]])
        yield [
            name, str(len(mesh.surface_nodes)), f"{solver.body.n_parts}", f"{1e3 * moved:.3g} mm",
            f"{corrections:.1f}",
            *(quantity(float(of(taken[own["first"] :])), "s") for of in (np.median, np.min, np.max)),
        ]  # fmt: skip
