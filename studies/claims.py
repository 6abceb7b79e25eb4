"""Tests of the paper's claims: each claim, the number of cases of a grid in which it holds, and the resulting word.

In: `claims.toml`, with the claims as printed, the rules, and the grid of bodies, meshes and materials. Out: a
frame of points, one for each row of a claim and case, with value, bar and whether the row holds; tables of words.

A rule is one function from a case of the grid to points. The rule defines the measured quantity; limits are data.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse
from scipy.optimize import least_squares
from scipy.sparse.linalg import splu

from solver_common.arrays import Array
from vdm.constraints import Load
from vdm.material import Parameters
from vdm.model import Model as Vdm
from vdm.surface import SurfaceMesh

from .body.mesh_cache import mesh_from_cache
from .body.refine import refined
from .body.surface_measures import relative_l2, relative_l2_steps, weighted_norm
from .machine import write_atomically
from .measures.metrics import History as Moved
from .measures.metrics import along, volume_drift_of_displaced
from .measures.reference import level_scene, restricted
from .measures.uncertainty import estimate_error
from .models import Prepared, run_model
from .models.frames import frame_times, growth_exponent
from .scene.result import ModelResult
from .scene.scene import Scene, build_scene
from .study.files import merged
from .study.schema import Anisotropy, Study
from .verdict.acceptance import BEYOND, WITHIN, states_of
from .verdict.acceptance import OPEN as UNSURE
from .verdict.formatting import plain

if TYPE_CHECKING:
    from pandas import DataFrame

HOLDS, WITHIN_LIMITS, FAILS, MIXED, OPEN = "holds", "holds within limits", "fails", "mixed", "undecided"
COLUMNS = ("claim", "row", "body", "mesh", "poisson_ratio", "model", "setting", "value", "bar", "floor")
SMALL_STRAIN = 0.10
STEPS, MANY_STEPS = 20, 100
DERIVED = ("vdm-consistent:nonlinear", "vdm-vector:nonlinear")
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)  # of warm starts
LENGTHS = (10, 100, 1000)  # of load histories
RATIOS = (1e-8, 1e-4, 1.0, 1e4, 1e8)  # of B to B_ij, over the rule's ratio
CONTRAST = 4.0  # of fibres
WIDEST = math.log(1e5)  # of a fitted modulus over its rule
TINY = 1e-7  # largest displacement over the body's extent at which all solvers are linear
AS_PRINTED: dict[str, float | str] = {"volume_row": "printed"}
CORRECTED: dict[str, float | str] = {"volume_row": "corrected"}
FINER = 1.6  # ratio of mesh sizes of the two meshes that give an exponent
FILLED = 0.4999  # Poisson's ratio of the elements whose own drift of volume is the least limit

DATA: dict[str, Any] = tomllib.loads(files("vdmbench").joinpath("claims.toml").read_text(encoding="utf-8"))


History = Sequence[float] | Array  # of load factors
Given = Mapping[str, float | str]  # parameters of [vdm]
NOTHING: Given = {}


def equal_steps(count: int) -> Array:
    """(count,) load factors up to one."""
    return np.arange(1, count + 1) / count


@dataclass(frozen=True)
class Point:
    """One row of a claim in one case.

    Attributes
    ----------
    value : NaN for a solver that stops
    bar : uncertainty of the value, from the reference's own error
    model, setting : distinguish it from other points of the row in that case; "key = value", several after
        semicolons
    floor : a wider limit for this case alone
    """

    row: str
    value: float
    bar: float = 0.0
    model: str = ""
    setting: str = ""
    floor: float = math.nan


class Place:
    """A case of the grid: a body on a mesh with a material; models are solved once each."""

    def __init__(
        self, body: str, mesh: str, poisson_ratio: float, cache: Path, finer_by: float = 1.0
    ) -> None:
        grid = DATA["grid"]
        own = grid["bodies"][body]
        size = own["mesh_size"][grid["meshes"].index(mesh)] / finer_by
        changes = {
            "geometry": own["geometry"] | {"mesh_size": size},
            "regions": own["regions"],
            "tissue": {"poisson_ratio": poisson_ratio},
        }
        self.body, self.mesh_name, self.poisson_ratio, self.cache = body, mesh, poisson_ratio, cache
        self.study = Study.model_validate(merged(grid["study"], changes))
        self._answers: dict[tuple[Any, ...], ModelResult] = {}
        self.others: dict[tuple[float, float], Place] = {}

    def other(self, *, poisson_ratio: float | None = None, finer_by: float = 1.0) -> Place:
        """The same body with another material or on a finer mesh; itself where nothing differs."""
        ratio = self.poisson_ratio if poisson_ratio is None else poisson_ratio
        if (ratio, finer_by) == (self.poisson_ratio, 1.0):
            return self
        if (ratio, finer_by) not in self.others:
            self.others[ratio, finer_by] = Place(self.body, self.mesh_name, ratio, self.cache, finer_by)
        return self.others[ratio, finer_by]

    @cached_property
    def scene(self) -> Scene:
        """The scene, with `STEPS` equal steps to the full load."""
        return build_scene(self.study, mesh_from_cache(self.study.geometry, self.cache))

    def answer(self, name: str, history: History | None = None, given: Given = NOTHING) -> ModelResult:
        """A model's result at load factors (by default the scene's own), with parameters of [vdm]."""
        key = (name, None if history is None else tuple(history), *sorted(given.items()))
        if key not in self._answers:
            scene = dataclasses.replace(self.scene, parameters=given)
            if history is not None:
                scene = dataclasses.replace(scene, load_factors=np.asarray(history, dtype=float))
            self._answers[key] = run_model(scene, name)
        return self._answers[key]

    @property
    def strain(self) -> Array:
        """(S,) strain of the reference that 95 % of the volume does not exceed."""
        return np.asarray(self.answer("fem").scalars["p95_principal_strain"])

    def errors(self, name: str) -> Array:
        """(S,) displacement error of a model against finite strain over the scene's history; NaN where it stops."""
        u, r = self.answer(name).displacement, self.answer("fem").displacement
        return relative_l2_steps(u, r, self.scene.surface.areas)

    def end(self, name: str, steps: int, given: Given = NOTHING) -> Array:
        """(N, 3) error of a model against finite strain at full load, after equal steps; NaN where it stops."""
        u = self.answer(name, equal_steps(steps), given).displacement[-1]
        return np.asarray(u - self.answer("fem").displacement[-1])

    def size(self, error: Array, *, normal: bool = False) -> float:
        """Such an error over the displacement, or over its normal component; NaN if unknown."""
        true = self.answer("fem").displacement[-1]
        if normal:
            error, true = (along(field[None], self.scene.surface.normals)[0] for field in (error, true))
        return weighted_norm(error, self.scene.surface.areas) / weighted_norm(true, self.scene.surface.areas)

    def drift(self, name: str, given: Given = NOTHING, load: float = 1.0) -> Array:
        """(S,) absolute change of volume over the displaced volume; NaN where the model stops."""
        history = load * self.scene.load_factors
        found = self.answer(name, history, given)
        moved = Moved(found.displacement, found.reaction_force, history)
        return np.abs(volume_drift_of_displaced(self.scene.surface, moved))

    def turned(self, one: Array, other: Array) -> float:
        """Norm of the difference of two errors (N, 3), each normalised.

        The reference's own error changes an error by its component along it, and this difference accordingly.
        """
        sizes = [weighted_norm(error, self.scene.surface.areas) for error in (one, other)]
        if not all(math.isfinite(size) and size > 0.0 for size in sizes):
            return 0.0
        return weighted_norm(one / sizes[0] - other / sizes[1], self.scene.surface.areas)

    @cached_property
    def bar(self) -> float:
        """The reference's own error (GCI): of linear elements on this mesh and on one refinement of it."""
        hierarchy = refined(self.scene.mesh, 1)
        scene = dataclasses.replace(level_scene(self.study, hierarchy), load_factors=np.ones(1))
        fine = restricted(run_model(scene, "fem-linear"), hierarchy)
        coarse = self.answer("fem-linear", (1.0,))
        difference = relative_l2(coarse.displacement[-1], fine.displacement[-1], self.scene.surface.areas)
        return estimate_error([difference]).gci


def _at_small_strain(values: Array, strain: Array) -> float:
    """(S,) values at a strain of 10 %, between the steps around it; NaN where the load does not reach it."""
    return float(np.interp(SMALL_STRAIN, strain, values)) if strain.max() >= SMALL_STRAIN else math.nan


# --- the rules ---

Rule = Callable[[Place], Iterator[Point]]
RULES: list[Rule] = []
CONDENSED = "frame of a contact, both condensed"


def rule(function: Rule) -> Rule:
    """Register the rule of the next claim of `claims.toml`."""
    RULES.append(function)
    return function


@rule
def volume(place: Place) -> Iterator[Point]:
    """1: drift of the exact volume, each solver in the loads that the paper gives it."""
    within = place.strain <= SMALL_STRAIN
    elements = place.other(poisson_ratio=FILLED)
    floor = float(elements.drift("fem").max())
    drift = place.drift("vdm-paper")
    for row, steps in (("(28), linear, strain below 10 %", within), ("(28), linear, beyond", ~within)):
        if steps.any():
            yield Point(row, drift[steps].max(), model="vdm-paper", floor=floor)
    for row, name, given in (
        ("(33) as printed, quasi-linear", "vdm-paper:quasi-linear", AS_PRINTED),
        ("(33) as printed, Figure 8", "vdm-paper:figure-8", AS_PRINTED),
        ("sum of A_i L_i, nonlinear", "vdm-paper:nonlinear", NOTHING),
        ("(33) corrected, quasi-linear", "vdm-paper:quasi-linear", CORRECTED),
        *(("exact volume, derived nonlinear", name, NOTHING) for name in DERIVED),
    ):
        yield Point(row, place.drift(name, given).max(), model=name, floor=floor)
    if elements is place:
        yield Point("mixed elements of 0.4999 themselves", floor, model="fem")


@rule
def linear_range(place: Place) -> Iterator[Point]:
    """2: errors of linear elements and of the printed model at a strain of 10 %."""
    elements, printed = place.errors("fem-linear"), place.errors("vdm-paper")
    largest = np.asarray(place.answer("fem").scalars["max_principal_strain"])
    off = _at_small_strain(printed, place.strain)
    for row, value, bar in (
        ("linear elements at a strain of 10 %", _at_small_strain(elements, place.strain), 0.0),
        ("linear elements, largest strain of any point 10 %", _at_small_strain(elements, largest), 0.0),
        ("printed model, error at a strain of 10 %", off, place.bar),
        ("printed model, growth of its error up to there", off - printed[0], 0.0),
    ):
        if math.isfinite(value):
            yield Point(row, value, bar)


@rule
def complexity(place: Place) -> Iterator[Point]:
    """3: unknowns, numbers in the matrix, set-up and frame of mixed elements over those of the printed model."""
    fine = place.other(finer_by=FINER)
    own, finer = _amounts(place.scene), _amounts(fine.scene)
    yield Point(CONDENSED, own[CONDENSED][1] / own[CONDENSED][0])
    for quantity in (quantity for quantity in own if quantity != CONDENSED):
        printed, elements = own[quantity]
        yield Point(quantity, elements / printed, setting=f"quantity = {quantity}")
        slopes = [
            growth_exponent(np.array([1.0, FINER]), np.array(ends))
            for ends in zip(own[quantity], finer[quantity], strict=True)
        ]
        yield Point(f"exponents over 1/h, less: {quantity}", slopes[1] - slopes[0])
    # whether elements on the coarser mesh are as accurate as the printed model on the finer one
    u, r = (fine.answer(name, (1.0,)).displacement[-1] for name in ("vdm-paper", "fem-linear"))
    off = relative_l2(u, r, fine.scene.surface.areas)
    alike = own if place.bar <= off else finer
    for row, quantity in (("unknowns", "unknowns"), ("frame", "frame, all nodes")):
        yield Point(f"at equal error, {row}", alike[quantity][1] / finer[quantity][0])


def _amounts(scene: Scene) -> dict[str, tuple[float, float]]:
    """Quantity -> its value for the printed model and for mixed linear elements."""
    from fem_reference.linear import LinearProblem

    printed, set_up = _printed(scene, _rule_of(scene)), Prepared(scene, "fem-linear").set_up
    assert set_up is not None, "linear elements take these scenes"
    assert isinstance(set_up.problem, LinearProblem)
    elements = set_up.problem.system
    times = frame_times(scene, ("vdm-paper", "fem-linear"), rounds=3, budget=20.0)
    numbers = elements.stiffness.nnz + (2 * elements.divergence.nnz if elements.divergence is not None else 0)
    seconds = {
        told: tuple(float(np.nanmedian(getattr(times[name], kind))) for name in ("vdm-paper", "fem-linear"))
        for told, kind in (("set-up", "setup"), ("frame, all nodes", "everywhere"), (CONDENSED, "contact"))
    }
    return {
        "unknowns": (float((~scene.held).sum() + 1), float(elements.size)),
        "numbers in the matrix": (float(printed.formulation.state_matrix().nnz), float(numbers)),
        **{told: (one, other) for told, (one, other) in seconds.items()},
    }


def _printed(scene: Scene, parameters: Parameters, **options: Any) -> Vdm:
    mesh = scene.mesh
    return Vdm(mesh.surface_points, mesh.triangles, parameters, fixed=scene.fixed, **options)


def _rule_of(scene: Scene) -> Parameters:
    surface = SurfaceMesh(scene.mesh.surface_points, scene.mesh.triangles)
    return Parameters.from_tissue(scene.tissue.youngs_modulus, surface, "paper")


@rule
def small_steps(place: Place) -> Iterator[Point]:
    """4: error at full load after 100 steps, and the gain over one step."""
    for solver in ("quasi-linear", "nonlinear", "figure-8", "incremental"):
        name, given = f"vdm-paper:{solver}", AS_PRINTED if solver == "quasi-linear" else NOTHING
        one, many = (place.end(name, steps, given) for steps in (1, MANY_STEPS))
        total = "total form: quasi-linear, nonlinear, Figure 8"
        form = "incremental form" if solver == "incremental" else total
        yield Point(form, place.size(many), place.bar, name)
        yield Point("normal component, 100 steps", place.size(many, normal=True), place.bar, name)
        gain, bar = place.size(one) - place.size(many), place.bar * place.turned(one, many)
        yield Point("error of one step less that of 100", gain, bar, name)
    for name in DERIVED:
        yield Point("derived forms, 100 steps", place.size(place.end(name, MANY_STEPS)), place.bar, name)


@rule
def warm_start(place: Place) -> Iterator[Point]:
    """5: iterations of BiCG from zero over those from the last solution."""
    best, load = -math.inf, Load(place.scene.contact_pressure)
    for stiff, tolerance in itertools.product((1.0, 10.0), TOLERANCES):
        rest = _rule_of(place.scene)
        moduli = dataclasses.replace(rest, connectivity_modulus=stiff * np.asarray(rest.connectivity_modulus))
        solver = _printed(place.scene, moduli, solver="bicg", tolerance=tolerance).solver
        # the system is linear: from zero every step takes as many iterations as the first
        once = solver.step(load).iterations
        for steps in LENGTHS if place.mesh_name == DATA["grid"]["meshes"][0] else LENGTHS[:2]:
            taken, last = 0, None
            for step in range(1, steps + 1):
                last = solver.step(load.scaled(step / steps), last)
                taken += last.iterations
            gain = once * steps / taken
            best = max(best, gain)
            setting = f"tolerance = {tolerance:g}; steps = {steps}; B_ij = {stiff:g}"
            yield Point("cold over warm iterations", gain, setting=setting)
    yield Point("of the best setting alone", best)


@rule
def blood(place: Place) -> Iterator[Point]:
    """6: factor by which the largest displacement is too large, or too small."""
    largest = [
        np.linalg.norm(place.answer(name, (0.01,), moduli).displacement[-1], axis=1).max()
        for name, moduli in (("fem", NOTHING), *(("vdm-paper", moduli) for moduli in DATA["moduli"].values()))
    ]
    for row, size in zip(DATA["moduli"], largest[1:], strict=True):
        yield Point(row, float(max(size / largest[0], largest[0] / size)))


@rule
def anisotropy(place: Place) -> Iterator[Point]:
    """7: change of the ratio of mean strains by fibres, over that of the reference's change."""
    mesh = place.scene.mesh
    surface, plain_rule = SurfaceMesh(mesh.surface_points, mesh.triangles), _rule_of(place.scene)
    gradient = place.scene.surface.volume_gradient
    load = place.scene.load(0.01)

    def strains(displacement: Array) -> Array:
        return np.einsum("na,na->a", displacement, gradient)

    def printed(parameters: Parameters) -> Array:
        model = _printed(place.scene, parameters)
        return strains(model.solve([Load(load.contact_pressure)]).displacement[-1])

    def elements(fibre: Sequence[float]) -> Array:
        fibres = {"fibre_direction": tuple(fibre), "contrast": CONTRAST}
        study = place.study.model_copy(update={"anisotropy": Anisotropy.model_validate(fibres)})
        scene = dataclasses.replace(build_scene(study, mesh), load_factors=np.array([0.01]))
        return strains(run_model(scene, "fem-linear").displacement[-1])

    bare, true = printed(plain_rule), strains(place.answer("fem-linear", (0.01,)).displacement[-1])
    for axis, name in enumerate("xy"):
        fibre = tuple(float(k == axis) for k in range(3))
        pair = (axis, 1 - axis)

        def change(found: Array, rest: Array, pair: tuple[int, int] = pair) -> float:
            return float(found[pair[0]] / found[pair[1]] - rest[pair[0]] / rest[pair[1]])

        both = plain_rule.anisotropic(surface, fibre, CONTRAST)
        laws = {
            "B_i per node": dataclasses.replace(both, connectivity_modulus=plain_rule.connectivity_modulus),
            "B_ij per edge": dataclasses.replace(both, bulk_modulus=plain_rule.bulk_modulus),
            "both": both,
            "both, contrast squared": plain_rule.anisotropic(surface, fibre, CONTRAST**2),
        }
        wanted = change(elements(fibre), true)
        found = {law: change(printed(parameters), bare) / wanted for law, parameters in laws.items()}
        for law, value in {**found, "best law of each case": max(found.values())}.items():
            yield Point(law, value, setting=f"fibres = {name}")


@rule
def large_strain(place: Place) -> Iterator[Point]:
    """8: growth of the error from a twentieth of the load to the full load."""
    for form, names in (("printed form", ("vdm-paper:nonlinear",)), ("derived forms", DERIVED)):
        for name in names:
            errors = place.errors(name)
            u, r = place.answer(name).displacement, place.answer("fem").displacement
            bar = place.bar * place.turned(*(u - r)[[0, -1]])
            yield Point(f"growth of the error, {form}", errors[-1] - errors[0], bar, name)
            yield Point(f"{form}, error at full load", errors[-1], place.bar, name)


@rule
def stability(place: Place) -> Iterator[Point]:
    """9: difference of every printed solver from the direct solution, over ratios of the moduli."""
    rest = _rule_of(place.scene)
    bulk, edge = (float(np.asarray(value)) for value in (rest.bulk_modulus, rest.connectivity_modulus))
    solvers = ("lu", "bicg", "bicg-cold", "quasi-linear", "nonlinear", "incremental", "figure-8")
    for ratio in RATIOS:
        given = {"bulk_modulus": ratio * bulk, "connectivity_modulus": edge}
        size = np.abs(place.answer("vdm-paper", (1.0,), given).displacement).max()
        factor = TINY * place.scene.surface.smallest_extent / size
        direct = place.answer("vdm-paper", (factor,), given).displacement[-1]
        for solver in solvers:
            found = place.answer(f"vdm-paper:{solver}", (factor,), given)
            off = relative_l2(found.displacement[-1], direct, place.scene.surface.areas)
            value = off if found.status[-1].ok else math.nan
            yield Point(solver, value, model=f"vdm-paper:{solver}", setting=f"ratio = {ratio:g}")


@rule
def iterations(place: Place) -> Iterator[Point]:
    """10: iterations of BiCG over the number of unknowns."""
    unknowns = float((~place.scene.held).sum() + 1)
    for tolerance in (1e-4, 1e-8, 1e-12):
        cold = place.answer("vdm-paper:bicg-cold", (1.0,), {"tolerance": tolerance})
        taken = cold.iterations[-1] / unknowns if cold.status[-1].ok else math.nan
        yield Point("iterations over unknowns, from zero", taken, setting=f"tolerance = {tolerance:g}")
        warm = place.answer("vdm-paper:bicg", equal_steps(MANY_STEPS), {"tolerance": tolerance})
        mean = warm.iterations.mean() / unknowns if all(s.ok for s in warm.status) else math.nan
        yield Point("the same, warm, 100 steps", mean, setting=f"tolerance = {tolerance:g}")


@rule
def memory(place: Place) -> Iterator[Point]:
    """11: numbers in the factors of the state matrix over those in the matrix, and their growth."""
    counts = []
    for scene in (place.scene, place.other(finer_by=FINER).scene):
        model = _printed(scene, _rule_of(scene))
        matrix = sparse.csc_array(model.formulation.state_matrix())
        counts.append((len(scene.fixed), matrix.nnz))
        if len(counts) == 1:
            factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0)
            yield Point("numbers in L and U over those in K", (factors.L.nnz + factors.U.nnz) / matrix.nnz)
    yield Point("exponent of the numbers in K over nodes", growth_exponent(*np.array(counts).T))


@rule
def trade_off(place: Place) -> Iterator[Point]:
    """12: time and error of the quasi-linear and of the nonlinear solver."""
    names = ("vdm-paper:nonlinear", "vdm-paper:quasi-linear")
    times = []
    for name in names:
        prepared, taken = Prepared(place.scene, name, STEPS), []
        for _ in range(3):
            start = time.process_time()
            prepared.answer(place.scene.loads)
            taken.append(time.process_time() - start)
        times.append(min(taken))
    yield Point("nonlinear over quasi-linear, time of a step", times[0] / times[1])
    nonlinear, quasi = (place.errors(name)[-1] for name in names)
    yield Point("error of quasi-linear less that of nonlinear", float(quasi - nonlinear))


@rule
def any_deformation(place: Place) -> Iterator[Point]:
    """13: drift of the volume at full load, and at twice that, with both readings of (33)."""
    name = "vdm-paper:quasi-linear"
    floor = float(place.other(poisson_ratio=FILLED).drift("fem").max())
    for row, given, load in (
        ("(33) as printed", AS_PRINTED, 1.0),
        ("(33) corrected", CORRECTED, 1.0),
        ("(33) corrected, twice the load", CORRECTED, 2.0),
    ):
        yield Point(row, place.drift(name, given, load)[-1], floor=floor)


@rule
def conceded(place: Place) -> Iterator[Point]:
    """14: errors at a small load."""
    yield Point("printed form at a small load", place.errors("vdm-paper")[0], place.bar)
    yield Point("mixed elements on the same mesh", place.bar)
    for name in ("vdm-consistent", "vdm-vector"):
        yield Point("derived forms at a small load", place.errors(name)[0], place.bar, name)
    true = place.answer("fem-linear", (1.0,)).displacement[-1]
    by_rule = Patches(place)
    fitted = {
        "printed form, normal component": np.ones(2),
        "the same, B fitted on other loads": by_rule.fitted(1),
        "the same, B and B_ij fitted on other loads": by_rule.fitted(2),
    }
    for row, multiples in fitted.items():
        (u,) = by_rule.answers(multiples, [place.scene])
        (r,) = along(true[None], place.scene.surface.normals)
        yield Point(row, relative_l2(u[:, None], r, place.scene.surface.areas), place.bar)


class Patches:
    """Loads on three other places of a body, to fit B and B_ij of the printed form to linear elements."""

    def __init__(self, place: Place) -> None:
        self.place, mesh = place, place.scene.mesh
        points, free = mesh.surface_points, ~place.scene.held
        centres = [points[place.scene.contact].mean(axis=0)]
        for _ in range(3):  # each as far as possible from the finger and the earlier ones, on the upper half
            away = np.linalg.norm(points[:, None] - np.array(centres), axis=2).min(axis=1)
            upper = free & (points[:, 2] > np.median(points[:, 2]))
            centres.append(points[np.where(upper, away, -1.0).argmax()])
        middles, width = points[mesh.triangles].mean(axis=1), 0.25 * place.scene.surface.smallest_extent
        loose = free[mesh.triangles].all(axis=1)
        self.scenes = []
        for centre in centres[1:]:
            near = np.exp(-0.5 * (np.linalg.norm(middles - centre, axis=1) / width) ** 2) * loose
            pressure = np.repeat(near[:, None], place.scene.facet_pressure.shape[1], axis=1)
            scene = dataclasses.replace(place.scene, facet_pressure=pressure, load_factors=np.ones(1))
            self.scenes.append(scene)

    def answers(self, multiples: Array, scenes: Sequence[Scene]) -> Array:
        """(L, N) normal displacement of the printed form under each load, for multiples of the rule's moduli."""
        rest = _rule_of(self.place.scene)
        bulk, edge = (
            m * np.asarray(v)
            for m, v in zip(multiples, (rest.bulk_modulus, rest.connectivity_modulus), strict=True)
        )
        moduli = dataclasses.replace(rest, bulk_modulus=bulk, connectivity_modulus=edge)
        solver = _printed(self.place.scene, moduli).solver
        fields = [solver.step(Load(scene.contact_pressure)).displacement for scene in scenes]
        return along(np.array(fields), self.place.scene.surface.normals)[..., 0]

    def fitted(self, count: int) -> Array:
        """(2,) multiples with the least squared normal error on the patches; of B alone where `count` is 1."""
        true = np.array([run_model(scene, "fem-linear").displacement[-1] for scene in self.scenes])
        weights = np.sqrt(self.place.scene.surface.areas)
        wanted = weights * along(true, self.place.scene.surface.normals)[..., 0]
        sizes = np.linalg.norm(wanted, axis=1, keepdims=True)

        def both(multiples: Array) -> Array:
            return np.append(multiples, np.ones(2 - count))

        def lacking(logs: Array) -> Array:
            answers = weights * self.answers(both(np.exp(logs)), self.scenes)
            return np.ravel(answers / sizes - wanted / sizes)

        found = least_squares(lacking, np.zeros(count), bounds=(-WIDEST, WIDEST))
        return both(np.exp(found.x))


# --- the grid ---


def places(cache: Path) -> list[Place]:
    """Every case of the grid; materials of one body and mesh share their results."""
    grid, found = DATA["grid"], []
    for body, mesh in itertools.product(grid["bodies"], grid["meshes"]):
        same = [Place(body, mesh, ratio, cache) for ratio in grid["poisson_ratio"]]
        for place in same:
            place.others |= {(other.poisson_ratio, 1.0): other for other in same}
        found += same
    return found


def ratios_of(number: int) -> Sequence[float]:
    """Poisson's ratios for a claim: the last of the grid if the measured quantity does not depend on it."""
    every: list[float] = DATA["grid"]["poisson_ratio"]
    return every[-1:] if DATA["claims"][number - 1].get("one_material") else every


def measure(
    cache: Path, numbers: Iterable[int] = (), watch: Callable[[str], None] = lambda _: None
) -> DataFrame:
    """The points of some claims (all by default) over the grid: a frame with the columns of `COLUMNS`.

    Parameters
    ----------
    cache : directory for meshes
    watch : called for each case
    """
    import pandas as pd

    chosen = sorted(set(numbers)) or list(range(1, len(RULES) + 1))
    rows = []
    for place in places(cache):
        watch(f"{place.body}, {place.mesh_name} mesh, Poisson's ratio {place.poisson_ratio:g}")
        for number in chosen:
            if place.poisson_ratio in ratios_of(number):
                rows += points_of(number, place)
    return pd.DataFrame(rows, columns=list(COLUMNS)).sort_values("claim", kind="stable", ignore_index=True)


def points_of(number: int, place: Place) -> list[tuple[Any, ...]]:
    """The points of a claim in one case, as `COLUMNS`."""
    case = place.body, place.mesh_name, place.poisson_ratio
    with np.errstate(all="ignore"):
        found = RULES[number - 1](place)
        return [(number, p.row, *case, p.model, p.setting, p.value, p.bar, p.floor) for p in found]


# --- the words ---


@dataclass(frozen=True)
class Row:
    """A row of a claim over the grid; the word is "" for a figure without a limit."""

    claim: int
    name: str
    word: str
    limit: str
    holds: int
    cases: int
    low: float
    high: float
    part: str = ""  # settings for which it holds: "tolerance = 0.01"


def judge(points: DataFrame) -> list[Row]:
    """Every row of every claim with points: its own points, or those of the rows that it is `of`."""
    import pandas as pd

    groups = dict(list(points.groupby(["claim", "row"], sort=False)))
    found = []
    for number, claim in enumerate(DATA["claims"], start=1):
        for name, about in claim["rows"].items():
            limit = {sense: about[sense] for sense in ("at_most", "at_least") if sense in about}
            if own := [groups[number, row] for row in about.get("of", [name]) if (number, row) in groups]:
                found.append(_row(number, name, limit, claim.get("along", ()), pd.concat(own)))
    return found


def _row(number: int, name: str, limit: Mapping[str, float], along: Sequence[str], points: DataFrame) -> Row:
    sign, about = -1.0 if "at_least" in limit else 1.0, (number, name)
    values, bars = points["value"].to_numpy(), points["bar"].to_numpy()
    values = np.where(np.isfinite(values), values, sign * math.inf)  # a solver that stops exceeds any limit
    ends = float(values.min()), float(values.max())
    if not limit:
        return Row(*about, "", "", 0, len(values), *ends)
    ((sense, least),) = limit.items()
    bound = np.fmax(least, points["floor"].to_numpy())
    states = states_of(sign * values, bars, sign * bound)
    holds, fails = states == WITHIN, states >= BEYOND
    told = f"{sense.replace('_', ' ')} {least:g}"
    if (bound > least).any():
        told += f" or the floor, {plain(bound.max(), 2)}"
    word, part = MIXED, ""
    if holds.all():
        word = HOLDS
    elif part := _part(points, holds, along):
        word = WITHIN_LIMITS
    elif fails.sum() * 2 > len(values):
        word = FAILS
    elif not fails.any() or (states == UNSURE).sum() * 2 > len(values):
        word = OPEN
    return Row(*about, word, told, int(holds.sum()), len(values), *ends, part)


def _part(points: DataFrame, holds: Array, along: Sequence[str]) -> str:
    """The values of one or several settings for which a row holds in every case; "" for none."""
    for keys in along:
        found: dict[str, list[bool]] = {}
        for model, setting, held in zip(points["model"], points["setting"], holds, strict=True):
            given = dict(part.split(" = ") for part in setting.split("; ") if part) | {"model": model}
            values = [f"{key} = {given[key]}" for key in keys.split(" + ") if given.get(key)]
            found.setdefault(", ".join(values), []).append(bool(held))
        whole = [value for value, every in found.items() if value and all(every)]
        if whole and len(found) > 1:
            return "; ".join(whole)
    return ""


def title(number: int) -> str:
    """A claim with its number."""
    return f"{number}. {DATA['claims'][number - 1]['text']}"


def told(number: int) -> list[str]:
    """The paper's words, their reading, other possible meanings, and the source of the limits."""
    claim = DATA["claims"][number - 1]
    return [
        f"\u201c{claim['quote']}\u201d ({claim['place']})",
        f"Read as: {claim['reading']}",
        f"Also: {claim['others']}",
        f"Limits: {claim['rule']}",
    ]


def table_of_claims(rows: Sequence[Row]) -> list[dict[str, str]]:
    """One line for each claim, from its deciding row."""
    first = {row.claim: row for row in reversed(rows)}
    return [{"claim": title(number)} | _cells(row) for number, row in sorted(first.items())]


def table_of(number: int, rows: Sequence[Row]) -> list[dict[str, str]]:
    """A line for each row of a claim."""
    return [{"measured": row.name} | _cells(row) for row in rows if row.claim == number]


def _cells(row: Row) -> dict[str, str]:
    ends = ["stops" if math.isinf(value) else plain(value, 2) for value in (row.low, row.high)]
    return {
        "verdict": row.word + (f": {row.part}" if row.part else ""),
        "holds in": f"{row.holds} of {row.cases}" if row.word else f"{row.cases} cases",
        "range": " to ".join(dict.fromkeys(ends)),
        "limit": row.limit,
    }


def write_points(points: DataFrame, path: Path) -> None:
    """Write the points as CSV, to 6 digits, whole or not at all. Raises OSError."""
    write_atomically(path, points.to_csv(index=False, float_format="%.6g").encode())


def read_points(path: Path) -> DataFrame:
    """Read the points back. Raises ValueError for a file that cannot be read, and for another one."""
    import pandas as pd

    try:
        table = pd.read_csv(path, dtype={"setting": str, "model": str})
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    except ValueError:  # no table at all
        table = pd.DataFrame()
    if tuple(table.columns) != COLUMNS:
        raise ValueError(f"{path}: not a file of claims; write one with vdmbench claims --out")
    return table.fillna({"setting": "", "model": ""})
