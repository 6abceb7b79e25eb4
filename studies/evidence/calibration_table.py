"""Calibrations as a table of texts, for a terminal and for a document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..study.registry import PARAMETERS
from ..verdict.formatting import NOT_MEASURED, NOTHING, percent, quantity
from .calibrate import Calibration
from .fit import Errors


def table(entries: Sequence[Calibration]) -> list[dict[str, str]]:
    """One row per model. Errors are mean displacement / mean deformation over the loads."""
    elsewhere = dict.fromkeys(study for entry in entries for study in entry.transfer)
    rows = []
    for entry in entries:
        fit = entry.fit
        row = {
            "model": fit.model,
            "fitted": ", ".join(
                f"{key} {quantity(value, PARAMETERS[key][1])}" for key, value in fit.parameters.items()
            ),
            "times its rule": _multiples(fit.multiples),
            "training loads": errors(fit.training),
            "held out, by rule": errors(fit.by_rule),
            "held out, fitted": errors(fit.held_out)
            + (f", {len(entry.repeated)} no test" if entry.repeated else ""),
            "reference's own": bars(fit.held_out),
        }
        row["fit of a finer mesh"] = _multiples(entry.finer) if entry.finer else NOT_MEASURED
        row["there, this fit"] = errors(entry.on_finer) if entry.on_finer else NOT_MEASURED
        for study in elsewhere:  # which need not have all the models
            found = entry.transfer.get(study)
            row[f"on {study}"] = errors(found) if found is not None else NOTHING
        rows.append(row)
    return rows


def errors(found: Errors) -> str:
    """Mean displacement error / mean deformation error."""
    return f"{percent(found.vector)} / {percent(found.deformation)}"


def bars(found: Errors) -> str:
    """The reference's own error for both, the largest over the loads."""
    if found.bar != found.bar:
        return NOT_MEASURED
    return f"± {percent(found.bar)} / {percent(found.bar_deformation)}"


def _multiples(multiples: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3g}" for value in multiples.values())
