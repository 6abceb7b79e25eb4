"""A model compared with a measurement, by ASME V&V 20-2009: comparison error and validation uncertainty.

E = S - D of a simulated value S and a measured one D; u_val = sqrt(u_num^2 + u_input^2 + u_D^2), all standard
uncertainties. If |E| <= u_val the model's error is within the uncertainty; otherwise it is at least |E| - u_val.

u_num of the reference is the grid convergence index of its mesh levels, which is wider than a standard
uncertainty; a coarser level adds its distance from the finest. Other models are not solved on two meshes and have
no u_num.

u_input is the effect of uncertain inputs, if [inputs] of a study gives their uncertainty: standard deviations of
the answers, and the part of each input. With d_k the standard deviation of an answer through input k alone, it is
the root of the sum of d_k^2. This is first order: it holds for answers linear in each input, and independent
inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from solver_common.arrays import Array, Index, Mask

from ..body.mesh import Mesh
from ..body.nearest import nearest_on_surface
from ..body.surface_measures import Surface, weighted_norm, without_motions
from ..scene.measured_points import place_measured
from ..study.checks import pushing
from ..study.measured import AXES, same_load
from ..study.registry import REFINED
from ..study.schema import Study
from ..study.sweep import Input, inputs_of
from .metrics import full_load_step
from .pushed import Answer, Pushed
from .uncertainty import estimate_limit

_NOTHING = 1e-6  # share of the displacement: smaller is solver error
STRAIGHT = 0.2  # largest `ModelSpread.bend` for first order: it changes the deviation by a fiftieth


@dataclass(frozen=True)
class ModelSpread:
    """Effect of uncertain inputs on one model at full load.

    Attributes
    ----------
    displacement : area-weighted norm of the displacement's standard deviation, over that of the displacement
    deformation : the same without the best-fit rigid motion
    parts : (K,) share of `displacement` by each input alone
    bend : largest deviation of an answer from the line between those at an input's ends, over `displacement`
    """

    displacement: float
    deformation: float
    parts: Array
    bend: float


@dataclass(frozen=True)
class InputSpread:
    """The K uncertain inputs of a case, their uncertainties, and the effect: model -> spread."""

    keys: Sequence[str]
    units: Sequence[str]
    values: Array  # (K,) of the study, SI
    deviations: Array  # (K,) standard deviations, SI
    models: Mapping[str, ModelSpread]


def _parts(inputs: Sequence[Input], answers: Sequence[Array]) -> Array:
    """(K, ...) signed standard deviation of each number through one input alone, from the answers at its ends."""
    pairs = zip(inputs, answers[0::2], answers[1::2], strict=True)
    return np.stack([one.weight * (high - low) / 2.0 for one, low, high in pairs])


Answers = Callable[[str], Sequence[Array]]  # model -> its V answers at full load (N, 3)


def input_spread(study: Study, surface: Surface, own: Mapping[str, Array], answers: Answers) -> InputSpread:
    """Effect of uncertain inputs on each model.

    Parameters
    ----------
    own : model -> (N, 3) its answer to the unchanged study at full load [m]
    """
    inputs, found = inputs_of(study), {}
    for name, displacement in own.items():
        # variations use the case's own mesh, even if the model's own answer is on a finer one
        unvaried = own[name.removesuffix(REFINED)]
        found[name] = _model_spread(inputs, surface, displacement, answers(name), unvaried)
    return InputSpread(
        [one.key for one in inputs],
        [one.unit for one in inputs],
        np.array([one.value for one in inputs]),
        np.array([one.deviation for one in inputs]),
        found,
    )


def _model_spread(
    inputs: Sequence[Input], surface: Surface, own: Array, fields: Sequence[Array], unvaried: Array
) -> ModelSpread:
    areas = surface.areas

    def shape(values: Array) -> Array:
        return without_motions(surface.rigid_motions, values[None], areas)[0]

    def share(values: Array, whole: Array) -> float:
        norm = weighted_norm(whole, areas)
        return weighted_norm(values, areas) / norm if norm else float("nan")

    slopes = _parts(inputs, fields)
    parts = np.array([share(slope, own) for slope in slopes])
    shapes = np.array([share(shape(slope), shape(own)) for slope in slopes])
    total, deformation = (float(np.sqrt((values**2).sum())) for values in (parts, shapes))
    bends = [
        share(low + (high - low) * one.place - unvaried, own)
        for one, low, high in zip(inputs, fields[0::2], fields[1::2], strict=True)
    ]
    bend = float(np.max(bends)) / total if total > _NOTHING else 0.0
    return ModelSpread(total, deformation, parts, bend)


RMS, MOST = "rms distance", "largest distance"  # of a measured surface's points to the deformed body
FORCE = "force"


@dataclass(frozen=True)
class Quantity:
    """One measured number.

    It is a component of a point's displacement, a distance of a whole surface (with D = 0), or the force of a
    constraint, named by `point`, at a depth.
    """

    table: str
    point: str
    component: str  # "x", "y", "z", RMS, MOST or FORCE
    step: int  # of the load history; for a force that of the largest load
    value: float  # D [m], or [N] of a force
    uncertainty: float  # u_D, likewise
    distance: float  # of the measured place from the mesh's surface [m]
    depth: float = np.nan  # of a force [m]
    facet: int = -1  # of the surface that the point is on; -1 of what is no point
    weights: tuple[float, float, float] = (0.0, 0.0, 0.0)  # barycentric coordinates in it

    @property
    def unit(self) -> str:
        """Unit of its numbers."""
        return "N" if self.component == FORCE else "m"


@dataclass(frozen=True)
class Measurement:
    """The Q quantities measured on a case, and their values by models and other programs.

    Attributes
    ----------
    quantities : in the order of the study's tables
    simulated : name -> (Q,) S, each in its quantity's unit; NaN where there is no answer
    numerical : name -> (Q,) u_num, likewise; NaN where unknown
    sources : table -> source of the measurement
    others : names in `simulated` that are no model of the study: results that came with the measurement
    inputs : name -> (Q,) u_input, likewise; NaN, or no entry, where unknown
    """

    quantities: Sequence[Quantity]
    simulated: Mapping[str, Array]
    numerical: Mapping[str, Array]
    sources: Mapping[str, str] = field(default_factory=dict)
    others: Sequence[str] = ()
    inputs: Mapping[str, Array] = field(default_factory=dict)

    @property
    def values(self) -> Array:
        """(Q,) D."""
        return np.array([quantity.value for quantity in self.quantities])

    def error(self, name: str) -> Array:
        """(Q,) E = S - D."""
        return np.asarray(self.simulated[name] - self.values)

    def parts(self, name: str) -> dict[str, Array]:
        """(Q,) u_num, u_input and u_D by their names; NaN where unknown."""
        unknown = np.full(len(self.quantities), np.nan)
        data = np.array([quantity.uncertainty for quantity in self.quantities])
        return {"u_num": self.numerical[name], "u_input": self.inputs.get(name, unknown), "u_D": data}

    def uncertainty(self, name: str) -> Array:
        """(Q,) u_val; unknown parts count as zero."""
        return np.asarray(
            np.sqrt(sum(np.nan_to_num(part, nan=0.0) ** 2 for part in self.parts(name).values()))
        )

    def within(self, name: str) -> Mask:
        """(Q,) whether |E| <= u_val."""
        return np.asarray(np.abs(self.error(name)) <= self.uncertainty(name))

    def as_good_as(self, name: str, other: str) -> Mask:
        """(Q,) whether an answer is within u_num of another one, with a known u_num, whatever was measured."""
        apart = np.abs(self.simulated[name] - self.simulated[other])
        return np.asarray(apart <= self.numerical[other])

    @property
    def with_levels(self) -> list[str]:
        """Names with a u_num."""
        return [name for name, known in self.numerical.items() if np.isfinite(known).any()]


def hold_against(
    study: Study,
    mesh: Mesh,
    results: Mapping[str, Answer],
    levels: Sequence[tuple[str, Answer]] = (),
    varied: Mapping[str, Callable[[], Sequence[Answer]]] | None = None,
) -> Measurement | None:
    """The results of a case compared with its measurements; None without measurements.

    Parameters
    ----------
    results : model -> its answers to the load steps at the surface nodes of `mesh`
    levels : the reference on its mesh levels at the same nodes, coarse first, each with its name in `results`, or
        ""
    varied : model -> its answers at both ends of each input, for u_input

    Raises
    ------
    SceneError
        measured points that are not on the mesh.
    """
    quantities, others = _quantities(study, mesh)
    if not quantities:
        return None
    pushed = {one.point: Pushed.on(study, mesh, one.point) for one in quantities if one.component == FORCE}
    surfaces = {table.name: np.array(table.surface) for table in study.measured or () if table.surface}

    def simulate(answer: Answer) -> Array:
        return _simulated(quantities, answer, mesh, pushed, surfaces)

    simulated = {name: simulate(answer) for name, answer in results.items()}
    numerical = {name: np.full(len(quantities), np.nan) for name in (*results, *others)}
    solved = [simulate(answer) for _, answer in levels]
    for (name, _), values in zip(levels, solved, strict=True):
        if name and len(levels) > 1:
            numerical[name] = _numerical(values, solved[::-1])
    return Measurement(
        quantities,
        {**simulated, **others},
        numerical,
        {table.name: table.source for table in study.measured or ()},
        tuple(others),
        {
            name: np.sqrt((_parts(inputs_of(study), list(map(simulate, answers()))) ** 2).sum(axis=0))
            for name, answers in (varied or {}).items()
        },
    )


def _numerical(values: Array, levels: Sequence[Array]) -> Array:
    """(Q,) u_num of a level; `levels` are the finest first."""
    found = np.full(len(values), np.nan)
    for k, figures in enumerate(zip(*levels, strict=True)):
        if np.isfinite(figures).all():
            gci = estimate_limit([float(figure) for figure in figures])[1].gci
            found[k] = gci + abs(values[k] - figures[0])
    return found


def _quantities(study: Study, mesh: Mesh) -> tuple[list[Quantity], dict[str, Array]]:
    """The Q quantities of a study, and other programs' values: name -> (Q,), NaN where missing."""
    factors = np.array(study.load.history)
    found: list[Quantity] = []
    others: list[dict[str, float]] = []
    for table, placed in zip(study.measured or (), place_measured(study, mesh), strict=True):
        for k, point in enumerate(table.points):
            name, step = point.name or str(k + 1), _step(table.factor(point), factors)
            (u, v, w), facet = placed.weights[k].tolist(), int(placed.facet[k])
            about = table.deviation(point), float(placed.distance[k]), np.nan, facet, (u, v, w)
            theirs = {program: other.components() for program, other in point.others.items()}
            for axis, value in point.components().items():
                found.append(Quantity(table.name, name, AXES[axis], step, value, *about))
                others.append({program: known[axis] for program, known in theirs.items() if axis in known})
        if table.surface:
            step = _step(table.factor(), factors)
            found += [
                Quantity(table.name, "", what, step, 0.0, table.deviation(), 0.0) for what in (RMS, MOST)
            ]
        for one in table.forces:
            name, step = table.constraint or pushing(study)[0], full_load_step(factors)
            own = one.uncertainty if one.uncertainty is not None else table.force_uncertainty or 0.0
            found.append(Quantity(table.name, name, FORCE, step, one.force, float(own), 0.0, one.depth))
        others += [{}] * (len(found) - len(others))
    programs = dict.fromkeys(program for each in others for program in each)
    return found, {name: np.array([each.get(name, np.nan) for each in others]) for name in programs}


def _simulated(
    quantities: Sequence[Quantity],
    answer: Answer,
    mesh: Mesh,
    pushed: Mapping[str, Pushed],
    surfaces: Mapping[str, Array],
) -> Array:
    """(Q,) S of an answer; `pushed` are the constraints by name, `surfaces` the measured ones by table."""
    found = np.full(len(quantities), np.nan)
    for k, one in enumerate(quantities):
        field = answer.displacement[one.step]
        if one.component in AXES:
            corners = field[mesh.triangles[one.facet], AXES.index(one.component)]
            found[k] = np.dot(one.weights, corners)
        elif one.component == FORCE:
            found[k] = pushed[one.point].force_at(one.depth, answer)
        elif one.component == RMS and np.isfinite(field).all():  # sets the largest distance too
            deformed = mesh.surface_points + field
            distance, _, _ = nearest_on_surface(surfaces[one.table], deformed, mesh.triangles)
            found[k : k + 2] = np.sqrt((distance**2).mean()), distance.max()
    return found


def _step(factor: float | None, factors: Array) -> int:
    if factor is None:
        return full_load_step(factors)
    largest = float(np.abs(factors).max())
    return next(k for k, step in enumerate(factors) if same_load(factor, float(step), largest))


def step_rms(found: Measurement, name: str, n_steps: int) -> Array:
    """(S,) root mean square of E over the points' components of each step [m]; NaN for a step without points."""
    errors = np.full(n_steps, np.nan)
    steps: Index = np.array([q.step if q.component in AXES else -1 for q in found.quantities])
    for step in range(n_steps):
        if (mine := steps == step).any():
            errors[step] = np.sqrt((found.error(name)[mine] ** 2).mean())
    return errors
