"""Claim 1: the volume that every solver leaves, in the loads that the paper gives it and beyond them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..measures.bars import series
from ..measures.case import CaseResult
from ..report.judgement import FAILS, HOLDS, WITHIN_LIMITS, Judgement
from ..study.registry import is_linear, split
from ..verdict.digest import Digest
from ..verdict.formatting import percent, plain, short_percent
from .claim_figures import curves, histories
from .claim_shared import EXACT, PRINTED, SMALL_DRIFT, SMALL_STRAIN, is_tried, largest

RULE = (
    "Each solver is judged in the loads that the paper gives it: the linear ones up to a largest principal strain "
    f"of {short_percent(SMALL_STRAIN)} in the reference, the others at all loads. Holds where no solver's volume "
    f"drifts by more than {EXACT:g} of the volume; within limits where the nonlinear solvers keep to that and the "
    f"others to {short_percent(SMALL_DRIFT)} of the displaced volume. The printed form is one of the others: its "
    "fluid keeps the sum of A_i L_i, not the volume. What the linear ones do beyond is told beside."
)
_STRAIN = "max_principal_strain"


@dataclass(frozen=True)
class _Drift:
    """Of a model the largest drift over all cases: of the volume, and of the displaced volume."""

    volume: float
    displaced: float


def volume(digests: Sequence[Digest]) -> Judgement | None:
    """The judgement of claim 1; None where no model of VDM has a load of its own range."""
    meant = _drifts(digests, beyond=False)
    if not meant:
        return None
    further = _drifts(digests, beyond=True)
    exact = [m for m in meant if split(m)[1] == "nonlinear" and split(m)[0] != PRINTED]
    others = [m for m in meant if m not in exact]
    worst = largest({m: found.volume for m, found in meant.items()})
    if meant[worst].volume <= EXACT:
        verdict = HOLDS
    elif all(meant[m].volume <= EXACT for m in exact) and all(
        meant[m].displaced <= SMALL_DRIFT for m in others
    ):
        verdict = WITHIN_LIMITS
    else:
        verdict = FAILS
    number = f"{percent(meant[worst].displaced)} of the displaced volume ({worst})"
    if further:
        number += f"; beyond {short_percent(SMALL_STRAIN)} strain {_most(further)}"
    lines = [line for digest in digests for line in histories(digest, "volume_drift_of_displaced", meant)]
    figure = curves(digests[0], lines, "load factor", "|drift| / displaced volume", "claim1", log_y=True)
    return Judgement(verdict, number, _reason(digests, meant, further, exact, others), figure)


def _reason(
    digests: Sequence[Digest],
    meant: Mapping[str, _Drift],
    further: Mapping[str, _Drift],
    exact: Sequence[str],
    others: Sequence[str],
) -> str:
    told = []
    if exact:
        kept = plain(max(meant[m].volume for m in exact), 1)
        told.append(f"The nonlinear solver keeps the volume to {kept} of itself.")
    if others:
        most = largest({m: meant[m].displaced for m in others})
        told.append(
            f"The others conserve it to first order only: {most} gains or loses "
            f"{short_percent(meant[most].displaced)} of the volume that it displaces, in the loads that the paper "
            "gives it."
        )
    if further:
        strains = [strain.max() for d in digests for case in d.cases if (strain := _strain(case)) is not None]
        told.append(
            f"Beyond, up to a strain of {short_percent(max(strains))}, it is {_most(further)}: the linear solvers "
            "are not meant for that."
        )
    return " ".join(told)


def _most(drifts: Mapping[str, _Drift]) -> str:
    most = largest({m: found.displaced for m, found in drifts.items()})
    return f"{percent(drifts[most].displaced)} ({most})"


def _drifts(digests: Sequence[Digest], *, beyond: bool) -> dict[str, _Drift]:
    """Of each model of VDM with a load in the range that the paper gives it, or beyond it."""
    found: dict[str, _Drift] = {}
    for digest in digests:
        for model in filter(is_tried, digest.models):
            for case in digest.cases:
                steps = _meant(case, model) ^ beyond
                values = [
                    _largest_of(case, model, m, steps) for m in ("volume_drift", "volume_drift_of_displaced")
                ]
                if steps.any() and np.isfinite(values).all():
                    known = found.get(model, _Drift(0.0, 0.0))
                    found[model] = _Drift(max(known.volume, values[0]), max(known.displaced, values[1]))
    return found


def _meant(case: CaseResult, model: str) -> NDArray[np.bool_]:
    """(S,) the load steps for which the paper means a solver; all where the reference tells no strain."""
    strain = _strain(case)
    if strain is None or not is_linear(model):
        return np.ones(len(case.load_factors), dtype=np.bool_)
    return np.asarray(strain <= SMALL_STRAIN)


def _strain(case: CaseResult) -> NDArray[np.float64] | None:
    """(S,) largest principal strain of the reference, where it is of finite strain."""
    scalars = case.models[case.reference].scalars if case.reference is not None else {}
    found = scalars.get(_STRAIN)
    return None if found is None or not np.isfinite(found).all() else np.asarray(found)


def _largest_of(case: CaseResult, model: str, metric: str, steps: NDArray[np.bool_]) -> float:
    values = series(case, model, metric)
    kept = np.abs(values[steps]) if values is not None else np.empty(0)
    kept = kept[np.isfinite(kept)]
    return float(kept.max()) if len(kept) else 0.0
