"""One finished case as plain data, which `store` writes and reads and `report` shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from solver_common.arrays import Array

from ..scene.result import ModelResult
from .measurement import InputSpread, Measurement
from .metrics import full_load_step

if TYPE_CHECKING:
    from ..study.schema import Study


@dataclass(frozen=True)
class Limit:
    """The load at which a model's error has grown by a threshold; see `vdmbench.measures.limits`."""

    threshold: float
    state: (
        str  # "found", "unresolved", or the reason: "beyond" the search, "model-stopped", "reference-stopped"
    )
    load: float  # times the study's own loads; if not found, the largest that was reached
    bar: float  # relative uncertainty of `load` from the reference's own error; NaN where not measured
    indentation: float  # of the reference at `load` [m]; NaN where nothing is in contact
    strain: float  # principal Green-Lagrange strain of the reference at `load`, not exceeded in 95 % of the volume
    indentation_bar: float = np.nan  # relative uncertainty of `indentation`, including that of `load`
    strain_bar: float = np.nan  # likewise of `strain`
    largest_strain: float = np.nan  # largest of any point: grows with each refinement, without a bar


@dataclass(frozen=True)
class ModelLimits:
    """The limits of one model: its error at small loads, and the loads at which it has grown by each threshold."""

    structural_error: float  # e0, relative L2 displacement error in the limit of a small load
    structural_bar: float  # its uncertainty from the reference's own error, absolute; NaN where not measured
    limits: tuple[Limit, ...]


@dataclass(frozen=True)
class CaseResult:
    """A case: its input, the answer of each model, and the distance of each from the reference."""

    hash: str  # hex, names the file
    label: str  # distinguishes it, such as "poisson_ratio = 0.45"; "" in a study of one case
    swept: Mapping[str, float | str]  # swept key -> value, SI
    swept_units: Mapping[str, str]  # swept key -> SI unit, "1" where it has none
    study: Study  # input of the case, SI; files by their names
    provenance: Mapping[str, str]  # package versions, platform, commit, mesh hash, date
    points: Array  # (N, 3) m
    triangles: NDArray[np.int64]  # (F, 3), outward
    load_factors: Array  # (S,)
    regions: Mapping[str, NDArray[np.bool_]]  # (N,) masks
    models: Mapping[str, ModelResult]
    metrics: Mapping[str, Mapping[str, Array]]  # model -> name in `METRICS` -> (S,); none without a reference
    reference: str | None  # a key of `models`
    reference_error: Mapping[str, float] = field(default_factory=dict)
    # error of the reference itself, see vdmbench.measures.reference.own_error; empty where not measured
    mesh_quality: Mapping[str, float] = field(default_factory=dict)
    small_strain: Mapping[str, ModelLimits] | None = None  # of each model, if [limits] asks for them
    measurement: Measurement | None = None  # comparison with measurements, if [[measured]] has any
    inputs: InputSpread | None = None  # effect of uncertain inputs, if [inputs] has any
    moved: Array | None = None  # (N,) how far remeshing moved the surface of the file near each node [m]

    @cached_property
    def full_load(self) -> int:
        """The step of the largest load, the last of several."""
        return full_load_step(self.load_factors)

    @cached_property
    def reached(self) -> int:
        """The step of the largest load that the reference reached: `full_load` unless it stopped before.

        -1 if it has no answer at all.
        """
        reference = self.models.get(str(self.reference))
        if reference is None:
            return self.full_load
        answered = np.flatnonzero([status.ok for status in reference.status])
        return int(answered[full_load_step(self.load_factors[answered])]) if len(answered) else -1


DAMAGED = "damaged"  # code of a failure: the case was done, but its file is unreadable


@dataclass(frozen=True, eq=False)
class Run:
    """A run directory as read back: the study, and the finished, failed and missing cases."""

    study: Study  # the study of all cases, SI; files by their names
    study_text: str  # the study file as the user wrote it
    cases: Sequence[CaseResult]
    failed: Sequence[Mapping[str, str]]  # each with "hash", "label", "code", "message", "remedy"
    missing: Sequence[str]  # labels of planned cases without a result
    plan: Mapping[str, Any]
    told: Mapping[str, Any] | None = None  # its `vdmbench.report.headline.summary`, if already made or kept

    @property
    def damaged(self) -> int:
        """Number of failed cases whose file is damaged."""
        return sum(entry.get("code") == DAMAGED for entry in self.failed)
