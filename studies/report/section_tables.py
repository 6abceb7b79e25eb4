"""Tables: small-strain limits, all measures, all cases, failures, and how to reproduce the run."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from typing import Any, NamedTuple

from ..measures.case import CaseResult, Limit, ModelLimits
from ..measures.frame import where_reached
from ..measures.limits import CLOSE, LARGEST, MOST_STRAIN
from ..measures.metrics import METRICS, VECTOR
from ..measures.uncertainty import reference_bar
from ..study.checks import only_load
from ..study.errors import plural
from ..study.registry import Family
from ..verdict.digest import DRIFT, Digest, failed_steps, first_failed
from ..verdict.formatting import (
    NOTHING,
    capital,
    first_of,
    parameter_name,
    percent,
    quantity,
    short_percent,
    swept_value,
)
from ..verdict.verdict import Verdict, verdicts
from ..verdict.words import TITLES
from .blocks import Block, Cell, Code, Field, Section, bar_detail, frame_table, note, spread_cell

_WHY = {
    "unresolved": "unresolved: a finer mesh does not bear it out",
    "beyond": "not reached",
    "model-stopped": "the model has no solution beyond",
    "reference-stopped": "the reference has no solution beyond",
}


class _Row(NamedTuple):
    """One model's limit at one threshold in one case."""

    case: CaseResult
    model: str
    entry: ModelLimits
    limit: Limit


def small_strain_limits(digest: Digest) -> Section | None:
    """Structural error and limits of growth, for each model and case."""
    rows = [
        _Row(case, model, entry, limit)
        for case in digest.cases
        for model, entry in (case.small_strain or {}).items()
        for limit in entry.limits
    ]
    if not rows:
        return None
    alone = {row.case.hash: only_load(row.case.study) for row in rows}
    units = {one[2] if one else "1" for one in alone.values()}
    unit = units.pop() if len(units) == 1 else "1"
    raised = {one[0] if one and unit != "1" else "every load, in proportion" for one in alone.values()}

    def load(row: _Row) -> Cell:
        one = alone[row.case.hash]
        return _load(row.limit, row.limit.load * (one[1] if one and unit != "1" else 1.0), unit)

    fields = [
        *([Field("Case", lambda row: digest.case_name(row.case))] if len(digest.cases) > 1 else []),
        Field("Model", lambda row: row.model),
        Field(
            "Structural error",
            lambda row: row.entry.structural_error,
            "1",
            bar=lambda row: row.entry.structural_bar,
        ),
        Field(
            "Growth",
            lambda row: Cell(f"+ {short_percent(row.limit.threshold)}", value=row.limit.threshold),
            "1",
        ),
        Field("Load" if unit != "1" else "Times the study's loads", load, unit),
        Field(
            "Indentation",
            lambda row: row.limit.indentation,
            "m",
            bar=lambda row: row.limit.indentation_bar * abs(row.limit.indentation),
        ),
        Field(
            "Strain",
            lambda row: row.limit.strain,
            "1",
            bar=lambda row: row.limit.strain_bar * abs(row.limit.strain),
        ),
        Field("Largest strain", lambda row: row.limit.largest_strain, "1", "of any point"),
    ]
    table = frame_table(rows, fields, "limits", mark=lambda row: digest.mark(row.model))
    small_print = note("limits", sorted(raised), CLOSE, LARGEST, MOST_STRAIN)
    return Section("limits", "Small-strain limits", [table, small_print])


def _load(limit: Limit, load: float, unit: str) -> Cell:
    if math.isnan(load):
        return Cell(NOTHING, _WHY[limit.state], tone="muted")
    text = quantity(load, unit)
    if limit.state == "found":
        return Cell(text, bar_detail(1.0, limit.bar), load, bar=limit.bar * load)
    prefix = {"beyond": "≥ ", "unresolved": ""}.get(limit.state, "to ")
    return Cell(f"{prefix}{text}", _WHY[limit.state], load, tone="muted")


def all_measures(digest: Digest) -> Section | None:
    """Every metric with its definition, for all compared models and the reference, at full load."""
    found = dict.fromkeys(
        name for case in digest.cases for model in digest.compared for name in case.metrics.get(model, {})
    )
    rows = [name for name in found if name != DRIFT and any(digest.spread(m, name) for m in digest.models)]
    if not rows:
        return None

    def of(model: str) -> Any:
        return lambda name: spread_cell(digest.spread(model, name), METRICS[name].unit)

    def in_words(metric: str) -> str:
        return capital(metric.replace("relative_l2_", "").replace("p95_", "95 % ").replace("_", " "))

    fields = [
        Field("Measure", lambda name: Cell(in_words(name), METRICS[name].definition)),
        *(Field(model, of(model), "#", "median") for model in digest.compared),
        Field(str(digest.reference), of(str(digest.reference)), "#", "reference"),
    ]
    table = frame_table(rows, fields, "measures")
    return Section("measures", "All measures at full load", [note("measures"), table])


_OPEN_ROWS = 12
_MOST_CELLS = 9000  # most cells on the page; metrics.csv has all


def case_table(digest: Digest) -> Section | None:
    """One row for each finished case, the worst of the focus model first."""
    if not digest.cases:
        return None
    roles = {case.hash: role for role, case in digest.key_cases if role}
    fields = [
        Field(
            "Case",
            lambda case: Cell(
                case.hash[:8] if digest.swept_keys else digest.case_name(case), roles.get(case.hash, "")
            ),
        ),
        *(_swept(digest, key) for key in digest.swept_keys),
        Field("Nodes", lambda case: Cell(str(len(case.points)), value=float(len(case.points))), "#"),
        *(field for one in verdicts(digest).asked for field in _family(digest, one)),
    ]
    sizes = digest.full_loads(digest.focus or "", VECTOR)
    order = sorted(range(len(sizes)), key=lambda k: -abs(sizes[k]) if math.isfinite(sizes[k]) else -math.inf)
    ranked = [digest.cases[k] for k in order]
    rows = ranked[: max(_OPEN_ROWS, _MOST_CELLS // len(fields))]
    first = digest.focus if digest.compared else None
    small_print = note("cases", digest.unreached, first, len(rows), len(ranked))
    table = frame_table(rows, fields, "cases", open_rows=_OPEN_ROWS)
    return Section("cases", "Cases", [small_print, table])


def _swept(digest: Digest, key: str) -> Field:
    """The column of a swept key."""
    unit = digest.unit(key)
    texts = any(isinstance(case.swept.get(key), str) for case in digest.cases)

    def value(case: CaseResult) -> Cell | str | None:
        found = case.swept.get(key)
        if found is None or isinstance(found, str):
            return found
        return Cell(swept_value(found, unit), value=float(found))

    return Field(parameter_name(key), value, "" if texts else "#" if unit == "1" else unit)


def _family(digest: Digest, one: Verdict) -> list[Field]:
    """The columns of a family: error and word of the deciding model; if none decides, the errors of all."""
    models = (one.model,) if one.model else one.models
    errors = [Field(model, _error(digest, model, VECTOR), "1", "displacement") for model in models]
    word = Field(TITLES[Family(one.family)], lambda case: one.states[case.hash], detail="within limits?")
    return [*errors, *([word] if one.model else [])]


def _error(digest: Digest, model: str, metric: str) -> Callable[[CaseResult], Cell | None]:
    def of(case: CaseResult) -> Cell | None:
        value, result = digest.at(case, model, metric), case.models.get(model)
        bar = reference_bar(case.reference_error, metric)
        if math.isfinite(value):
            return Cell(percent(value), value=value, bar=bar)
        if case.reached != case.full_load and math.isfinite(value := where_reached(case, model, metric)):
            factor = float(case.load_factors[case.reached])
            return Cell(f"{percent(value)} at {factor:.3g}", value=value, bar=bar)
        return Cell("failed", tone="bad") if result is not None and failed_steps(result) else None

    return of


# --- what failed ---


class Stopped(NamedTuple):
    """A message of a model or a case that failed, where it came up, and what to do."""

    model: str
    where: str
    message: str
    remedy: str


def failures(digest: Digest) -> Section | None:
    """Cases without a result and models that stopped short, each with reason and remedy."""
    blocks: list[Block] = []
    failed = [
        Stopped(one["label"] or one["hash"][:8], one["code"], one["message"], one["remedy"])
        for one in digest.run.failed
    ]
    for name, caption, first, rows in (
        ("failed", "Cases that failed", "Case", failed),
        ("stopped", "Models that stopped in a finished case", "Model and case", stopped_models(digest)),
    ):
        fields = [
            Field(first, lambda row: Cell(row.model, row.where)),
            Field("What happened", lambda row: row.message),
            Field("What to do", lambda row: row.remedy),
        ]
        if rows:
            blocks.append(frame_table(rows, fields, name, caption=caption))
    if digest.run.missing:
        names = [label or "a case" for label in digest.run.missing]
        blocks.append(note("missing", names, kind="plain"))
    return Section("failures", "What failed or is missing", blocks) if blocks else None


def stopped_models(digest: Digest) -> list[Stopped]:
    """The first failed step of each model, one entry for each reason."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for case in digest.cases:
        for model, result in case.models.items():
            for step in first_failed(case, model):
                status, factor = result.status[step], float(case.load_factors[step])
                reason = (model, status.message or status.code, status.remedy)
                found.setdefault(reason, []).append(f"{digest.case_name(case)}, load factor {factor:g}")
    return [
        Stopped(
            model,
            places[0] + (f", and in {plural(len(places) - 1, 'other case')}" if len(places) > 1 else ""),
            message,
            remedy,
        )
        for (model, message, remedy), places in found.items()
    ]


_SHORT = 16  # shown digits of a hash


def how_to_reproduce(digest: Digest) -> Section:
    """The commands, the study file, and the versions of packages and models."""
    plan, name = digest.run.plan, digest.run.study.study.name
    words = plan.get("command") or ["run", name]
    given = words[words.index("--out") + 1] if "--out" in words else "results/runs"
    directory = (
        given if "--out" in words and words[0] != "bench" else f"{given}/{name}"
    )  # bench: one per study
    commands = [words, ["report", directory]]
    blocks: list[Block] = [
        note("reproduce", kind="plain"),
        Code("\n".join(shlex.join(["vdmbench", *words]) for words in commands)),
        note("files"),
    ]
    if digest.run.study_text.strip():
        instead = ", whose geometry --surface replaced" if "--surface" in words else ""
        blocks.append(Code(digest.run.study_text.rstrip(), summary=f"The study file{instead}"))
    if told := "\n".join(f"{what}: {values}" for what, values in _provenance(digest)):
        blocks.append(Code(told, summary="Packages, machine and meshes"))
    return Section("reproduce", "How to reproduce", blocks)


def _provenance(digest: Digest) -> list[tuple[str, str]]:
    """(what, values over all cases) for packages, machine, meshes and versions of models."""
    found: dict[str, dict[str, None]] = {}
    for case in digest.cases:
        # file names without directories, which may be private
        files = {"geometry file": path.name} if (path := case.study.geometry.path) is not None else {}
        versions = {f"version of {name}": result.version for name, result in case.models.items()}
        for key, value in {**files, **case.provenance, **versions}.items():
            found.setdefault(key, {})[value[:_SHORT] if key.endswith("hash") else value] = None
    return [
        (
            key.removeprefix("package.").replace("_", " "),
            " to ".join(dict.fromkeys((min(told), max(told)))) if key == "date" else first_of(list(told), 3),
        )
        for key, told in found.items()
    ]
