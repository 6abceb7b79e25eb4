"""Contact force against indentation, and volume drift against load."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ..case import CaseResult
from ..metrics import Surface, facet_area_vectors
from .blocks import Block, Figure, Figures, Section, Text
from .digest import Array, Digest, full_load, series
from .formatting import listed, quantity, scale_of, short_percent
from .plots import Plot, colour, line, log_axis, marker, percent_ticks

_DRIFT_FLOOR = 1e-16  # below what double precision can tell from zero


def force_against_indentation(digest: Digest) -> Section | None:
    """How stiff the body feels under the finger, for the key cases or, without a load history, over the cases."""
    figures = []
    if digest.has_steps:
        for k, (role, case) in enumerate(digest.key_cases):
            figure = _stiffness(
                digest, [case], f"{digest.case_name(case)}{f' ({role})' if role else ''}", f"f{k}"
            )
            figures += [figure] if figure else []
    elif len(digest.cases) > 1:
        figure = _stiffness(digest, list(digest.cases), "All cases", "f0")
        figures += [figure] if figure else []
    if not figures:
        return None
    note = (
        "Indentation: the largest inward displacement of the nodes in contact, along the undeformed normal."
    )
    return Section(
        "force", "Force against indentation", [Text(note, kind="note"), Figures(figures, digest.legend)]
    )


def contact_resultant(case: CaseResult) -> float | None:
    """Force of a case's only contact at load factor 1 [N]; None where the stored inputs do not tell.

    Given as `force`, or the integral of a uniform pressure over the facets whose three nodes are in its region.
    """
    contacts = [c for c in case.resolved.get("constraints") or () if c.get("kind") == "contact"]
    if len(contacts) != 1:
        return None
    contact: Mapping[str, object] = contacts[0]
    if isinstance(force := contact.get("force"), int | float):
        return float(force)
    mask = case.regions.get(str(contact.get("region")))
    pressure = contact.get("pressure")
    if (
        mask is None
        or not isinstance(pressure, int | float)
        or contact.get("profile", "uniform") != "uniform"
    ):
        return None
    loaded = mask[case.triangles].all(axis=1)
    vectors = facet_area_vectors(case.points, case.triangles)[loaded]
    return float(pressure * np.linalg.norm(vectors.sum(axis=0)))


def indentation(case: CaseResult, model: str) -> Array:
    """(S,) largest inward displacement of the nodes in contact, of all nodes where no contact is stored [m]."""
    mask = np.zeros(len(case.points), dtype=bool)
    for constraint in case.resolved.get("constraints") or ():
        if constraint.get("kind") == "contact" and str(constraint.get("region")) in case.regions:
            mask |= case.regions[str(constraint.get("region"))]
    if not mask.any():
        mask[:] = True
    normals = Surface(case.points, case.triangles).normals[mask]
    inward = -np.einsum("sij,ij->si", case.models[model].displacement[:, mask], normals)
    result: Array = inward.max(axis=1)
    return result


def _stiffness(digest: Digest, cases: list[CaseResult], title: str, salt: str) -> Figure | None:
    resultants = [contact_resultant(case) for case in cases]
    known = [r for r in resultants if r is not None]
    if known and len(known) < len(resultants):
        cases = [case for case, r in zip(cases, resultants, strict=True) if r is not None]
    if not known and len(cases) > 1:
        return None
    curves: dict[str, tuple[Array, Array]] = {}
    for model in digest.models:
        xs, ys = [], []
        for case, resultant in zip(cases, known or [1.0], strict=True):
            if model not in case.models:
                continue
            steps = slice(None) if len(cases) == 1 else slice(full_load(case), full_load(case) + 1)
            xs.append(indentation(case, model)[steps])
            ys.append(case.load_factors[steps] * resultant)
        if xs:
            x, y = np.concatenate(xs), np.concatenate(ys)
            keep = np.isfinite(x) & np.isfinite(y)
            if keep.any():
                curves[model] = (x[keep], y[keep])
    if not curves:
        return None
    length, length_unit = scale_of("m", np.concatenate([x for x, _ in curves.values()]))
    force, force_unit = scale_of("N", np.concatenate([y for _, y in curves.values()])) if known else (1.0, "")
    y_label = f"contact force [{force_unit}]" if known else "load factor"
    plot = Plot(f"indentation [{length_unit}]", y_label, salt)
    with plot as axes:
        for model, (x, y) in curves.items():
            k = digest.colour(model)
            style = line(k) if len(cases) == 1 else "none"
            axes.plot(x / length, y / force, linestyle=style, marker=marker(k), color=colour(k))
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
        axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    deepest = [
        f"{model} indents by up to {quantity(float(x.max()), 'm')}" for model, (x, _) in curves.items()
    ]
    alt = f"Force against indentation, {title}: {listed(deepest)}."
    return Figure(plot.drawn(alt), title)


def volume_drift(digest: Digest) -> Section | None:
    """Change of the exact enclosed volume, as a share of the volume and of the displaced volume."""
    if not digest.has_steps:
        return None  # one point per model: the headline has it
    quantities = (
        ("volume_drift", "|V − V0| / V0", "Drift as a share of the volume"),
        (
            "volume_drift_of_displaced",
            "|V − V0| / displaced volume",
            "Drift as a share of the displaced volume",
        ),
    )
    figures = [
        figure
        for k, (metric, label, title) in enumerate(quantities)
        if (figure := _drift(digest, metric, label, title, f"v{k}")) is not None
    ]
    if not figures:
        return None
    blocks: list[Block] = []
    if len(digest.cases) > 1:
        blocks.append(Text("Largest drift over all cases at each load, whatever its sign.", kind="note"))
    blocks.append(Figures(figures, digest.legend))
    return Section("volume", "Volume drift against load", blocks)


def _drift(digest: Digest, metric: str, label: str, title: str, salt: str) -> Figure | None:
    curves: dict[str, dict[float, float]] = {}
    for model in digest.models:
        for case in digest.cases:
            values = series(case, model, metric)
            for factor, value in zip(
                case.load_factors, () if values is None else values, strict=values is not None
            ):
                if math.isfinite(value):
                    curve = curves.setdefault(model, {})
                    curve[float(factor)] = max(curve.get(float(factor), _DRIFT_FLOOR), abs(float(value)))
    if not curves:
        return None
    described = []
    plot = Plot("load factor", label, salt)
    with plot as axes:
        for model, curve in curves.items():
            k = digest.colour(model)
            factors = sorted(curve)
            axes.plot(factors, [curve[f] for f in factors], line(k), marker=marker(k), color=colour(k))
            described.append(f"{model} up to {short_percent(max(curve.values()))}")
        log_axis(axes, "y")
        percent_ticks(axes)
        axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
    return Figure(plot.drawn(f"{title}: {listed(described)}."), title)
