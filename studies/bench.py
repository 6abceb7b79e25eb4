"""Run time against error: a study on several mesh sizes, relative to linear elements, and run like any other.

In: a study. Out: a study whose frames are timed on every mesh; from its run a table of times and errors.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
import tomli_w

from solver_common.arrays import Array

from .measures.case import CaseResult, Run
from .measures.frame import value_bar, where_reached
from .measures.metrics import VECTOR
from .measures.uncertainty import is_resolved
from .models.frames import FACTORS
from .scene.result import FrameTimes
from .study.config import expand, resolved
from .study.errors import StudyError
from .study.kinds import MAX_NAME
from .study.registry import REFINED, model_names
from .study.schema import Study, Sweep, Uncertainty
from .verdict.formatting import NOTHING, number, percent, quantity

SIZES = (2.6, 2.0, 1.6, 1.3)  # mesh sizes over that of the study
YARDSTICK = "fem-linear"  # errors are against it on refined meshes; ratios are to its time in the same round
SUFFIX = "-bench"  # of the names of studies
NOTE = (
    "Every model answers the same loads on the same mesh. Its error is the relative L2 difference from "
    "linear elements on the refined mesh, ± that reference's own; ~ where this is more than a tenth. "
    "Times are medians over rounds, between their quartiles."
)


def models_to_measure() -> list[str]:
    """Every model by its default solver, and by the nonlinear one where it has that."""
    return [name for name in model_names() if ":" not in name or name.endswith(":nonlinear")]


def study_to_run(
    given: Study,
    models: Sequence[str],
    sizes: Sequence[float] = SIZES,
    watch: Callable[[str], object] = lambda _: None,
) -> Study:
    """The first case of a study with other models, on `sizes` times its mesh size.

    A size that does not suit the body is left out, and reported to `watch`. If none is left, or the body has
    tetrahedra of its own, it is measured on its own mesh.
    """
    case = expand(given)[0].study
    own = {
        "name": given.study.name[: MAX_NAME - len(SUFFIX)] + SUFFIX,
        "models": tuple(dict.fromkeys((*models, YARDSTICK))),
        "reference": YARDSTICK,
    }
    study = case.model_copy(
        update={
            "study": case.study.model_copy(update=own),
            "load": case.load.model_copy(update={"factors": tuple(FACTORS.tolist()), "steps": None}),
            "uncertainty": Uncertainty(levels=2),
            **dict.fromkeys(("limits", "inputs", "measured", "calibration")),
        }
    )
    own_size, meant = case.geometry.mesh_size, []
    for times in sizes if own_size and not case.geometry.has_own_tetrahedra else ():
        size = times * (own_size or 0.0)
        try:
            expand(_on_meshes(study, [size]))
            meant.append(size)
        except StudyError as error:
            watch(f"left out {times:g} times the mesh_size: {error.problems[0].message}")
    study = _on_meshes(study, meant)
    study._source = dataclasses.replace(given._source, text=tomli_w.dumps(resolved(study)))
    return study


def _on_meshes(study: Study, sizes: Sequence[float]) -> Study:
    swept = Sweep.model_validate({"geometry.mesh_size": list(sizes)} if sizes else {})
    return study.model_copy(update={"sweep": swept})


def rows(run: Run) -> list[dict[str, str]]:
    """The printed table, a line for each mesh and model: column title -> text."""
    return [_row(run, case, name) for case in run.cases for name in case.models if not name.endswith(REFINED)]


def _row(run: Run, case: CaseResult, name: str) -> dict[str, str]:
    result, yardstick = case.models[name], case.models[YARDSTICK].frames
    nothing = np.zeros(0)
    times = result.frames or FrameTimes(nothing, nothing, nothing)
    yard = yardstick or times
    return {
        "model": name,
        "body": run.study.study.name.removesuffix(SUFFIX),
        "nodes": f"{len(case.points):,}",
        "set-up": _between(times.setup, "s"),
        "frame, all nodes": _between(times.everywhere, "s"),
        "frame, contact": _between(times.contact, "s"),
        "set-up ratio": _between(_over(times.setup, yard.setup), "1"),
        "frame ratio": _between(_over(times.contact, yard.contact), "1"),
        "memory": quantity(result.peak_bytes, "B"),
        "error": _error(case, name),
    }


def _over(times: Array, yardstick: Array) -> Array:
    """Ratios of two times, for the rounds that both have."""
    count = min(len(times), len(yardstick))
    return times[:count] / yardstick[:count]


def _between(values: Array, unit: str) -> str:
    """Median, first and third quartile of the finite values, as text."""
    known = values[np.isfinite(values)]
    if not known.size:
        return NOTHING
    first, middle, third = (
        number(value, 2) if unit == "1" else quantity(value, unit)
        for value in np.quantile(known, (0.25, 0.5, 0.75)).tolist()
    )
    return f"{middle} [{first}, {third}]"


def _error(case: CaseResult, name: str) -> str:
    """A model's error ± the reference's own, or the reason why there is no answer."""
    error, bar = where_reached(case, name, VECTOR), value_bar(case, name, VECTOR)
    if not math.isfinite(error):
        return case.models[name].status[-1].message
    return f"{'' if is_resolved(error, bar) else '~'}{percent(error)} ± {100 * bar:.2g} %"
