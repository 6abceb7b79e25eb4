"""Checks between the keys of a study, beyond each key by itself: findings on a study with valid keys."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from pydantic import ValidationError

from .errors import MOST_TOLD, Finding, Loc, MeshError, Source, key_text, listed, named_twice, unknown
from .kinds import Table
from .measured import Measured, same_load
from .registry import BROKEN, DISPLACEMENT_ELEMENTS, FINITE_STRAIN, find, lacks, model_names, reads, split
from .schema import (
    LAW_KEYS,
    LAWS,
    MOST_STEPS,
    NEO_HOOKEAN,
    Inclusion,
    Region,
    Study,
    extras_for,
)
from .shapes import (
    SURFACE_SUFFIXES,
    VOLUME_SUFFIXES,
    FileBody,
    Geometry,
    Shape,
    check_extent,
    check_mesh_size,
)
from .units import shown


def check(study: Study) -> Iterator[Finding]:
    """All mistakes of a study whose single keys are valid."""
    yield from _check_models(study)
    yield from _check_law(study)
    of_body = list(_check_geometry(study.geometry))
    yield from of_body
    yield from _check_regions(study)
    yield from _check_constraints(study)
    yield from _check_inclusions(study)
    count = len(study.load.history)
    if count > MOST_STEPS:
        text = f"makes a load history of {count:,} steps, more than the {MOST_STEPS:,} allowed; take fewer"
        yield ("load", "steps"), text
    yield from _check_loads(study, None if of_body else max(_sizes(study.geometry), default=None))
    yield from _check_limits(study)
    yield from _check_measured(study)


# --- models, and what they read ---


def _check_models(study: Study) -> Iterator[Finding]:
    info, known = study.study, model_names()
    if not info.models:
        yield ("study", "models"), "name at least one model"
    for place, name in enumerate(info.models):
        if name not in known:
            names = known if ":" in name else [one for one in known if ":" not in one]
            text = "; ".join([unknown(name, names, "model"), *BROKEN.values()])
            yield ("study", "models", place), text
        elif name in info.models[:place]:
            yield ("study", "models", place), f"{shown(name)} is listed twice"
    if info.reference is not None and info.reference not in info.models:
        yield (
            ("study", "reference"),
            f"{shown(info.reference)} is not among the models of this study; add it to models, or leave "
            "reference out to run without comparison",
        )
    for name in study.models:
        if name not in info.models:
            yield ("models", name), unknown(name, info.models, "model of this study")
    if study.uncertainty is not None and info.reference is None:
        yield ("uncertainty",), "decides nothing without study.reference; name one, or leave this out"
    if set(info.models) <= set(known):  # the keys of an unknown model are unknown
        yield from refusals(study, info.reference) if info.reference in info.models else ()
        yield from _check_read(study)


def refusals(study: Study, name: str) -> Iterator[Finding]:
    """Reasons why a model cannot answer a study, at the model's name and at the key that causes it."""
    model, _ = find(name)
    if model.volumetric and not any(part.holds or part.supports for part in study.constraints):
        yield ("study", "models"), f"{name}: nothing is held; hold a region, by kind fixed or constrained"
    if split(name)[0] in DISPLACEMENT_ELEMENTS and study.tissue.poisson_ratio == 0.5:
        told = "a displacement element cannot be incompressible; use fem-linear, or a ratio below 0.5"
        yield ("tissue", "poisson_ratio"), f"{name}: {told}"
    for told in lacks(name, extras_for(name, study)):
        yield ("study", "models"), told


def _check_read(study: Study) -> Iterator[Finding]:
    """Parameters that no model reads."""
    names = study.study.models
    tables: list[tuple[Loc, Table, Sequence[str]]] = [(("vdm",), study.vdm, names)]
    tables += [(("models", name), table, [name]) for name, table in study.models.items() if name in names]
    for loc, table, readers in tables:
        known = set().union(*map(reads, readers))
        for key in sorted(table.model_fields_set - known):
            who = f"{loc[1]} does not read it" if len(loc) > 1 else "no model of this study reads it"
            yield (*loc, key), f"{who}; leave it out. Read here: {listed(known) if known else 'none'}"


# --- tissue and body ---


def _check_law(study: Study) -> Iterator[Finding]:
    tissue = study.tissue
    law = tissue.law or NEO_HOOKEAN
    present, needed = tissue.model_fields_set.intersection(LAW_KEYS), set(LAWS[law])
    for key in sorted(needed - present):
        yield ("tissue", key), f"is missing; the law {shown(law)} needs {listed(needed)}"
    for key in sorted(present - needed):
        owners = {name for name, other in LAWS.items() if key in other}
        yield ("tissue", key), f"belongs to the law {listed(owners)}, not to {shown(law)}; leave it out"
    if law != NEO_HOOKEAN and study.anisotropy is not None:
        yield ("tissue", "law"), f"{shown(law)} has no fibres; leave out [anisotropy], or the law"
    exponents, shares = tissue.exponents, tissue.shares
    if exponents and shares:
        if len(exponents) != len(shares):
            text = f"has {len(shares)} numbers; give one for each of {len(exponents)} exponents"
            yield ("tissue", "shares"), text
        if abs(sum(shares) - 1.0) > 1e-9:
            yield ("tissue", "shares"), f"must sum to 1, not {sum(shares):g}"


def _check_geometry(geometry: Geometry) -> Iterator[Finding]:
    if geometry.seed is not None and geometry.slivers is None and geometry.perturbation is None:
        yield ("geometry", "seed"), "decides nothing without slivers or perturbation; give one of them"
    if isinstance(geometry, FileBody):
        name = shown(geometry.path.name)
        if geometry.suffix == ".geo":
            text = f"{name}: .geo files are scripts and are not run; give the mesh made from it"
            yield ("geometry", "path"), text
        elif geometry.suffix not in SURFACE_SUFFIXES + VOLUME_SUFFIXES:
            kinds = f"a surface ({', '.join(SURFACE_SUFFIXES)}) or tetrahedra ({', '.join(VOLUME_SUFFIXES)})"
            yield ("geometry", "path"), f"{name}: unknown kind of file; give {kinds}"
        if geometry.mesh_size is None and not geometry.has_own_tetrahedra:
            yield ("geometry", "mesh_size"), "is missing; only a file with tetrahedra does without"
        if geometry.size is not None and geometry.scale is not None:
            yield ("geometry", "scale"), "give size or scale, not both"
        if geometry.repair is not None and geometry.has_own_tetrahedra:
            yield ("geometry", "repair"), "is for surfaces; a file with tetrahedra is used as it is"
    try:
        sizes, key = _sizes(geometry), "size" if isinstance(geometry, FileBody) else geometry.extent_key()
        if sizes:
            check_extent(max(sizes), 'a bare number is in metres: write "50 mm"', key)
        if sizes and geometry.mesh_size is not None:
            check_mesh_size(geometry.mesh_size, min(sizes))
    except MeshError as error:
        yield ("geometry", *error.place), str(error)


def _sizes(geometry: Geometry) -> tuple[float, ...]:
    """The extents of a body that its keys determine [m]."""
    if isinstance(geometry, Shape):
        return geometry.extents()
    return (geometry.size,) if geometry.size is not None else ()


# --- constraints and loads ---


def _check_constraints(study: Study) -> Iterator[Finding]:
    yield from named_twice("constraints", study.constraints, "constraint")
    for place, constraint in enumerate(study.constraints):
        loc = ("constraints", place)
        if constraint.region not in study.regions:
            yield (*loc, "region"), unknown(constraint.region, list(study.regions), "region")
        region = study.regions.get(constraint.region)
        for inside, text in constraint.faults(
            frozenset(region.model_fields_set if region is not None else ())
        ):
            yield (*loc, *inside), text
    for place in [place for place, part in enumerate(study.constraints) if part.kind == "indenter"][1:]:
        yield ("constraints", place, "kind"), "is a second indenter; a study has one, so make it a contact"


def _check_loads(study: Study, extent: float | None) -> Iterator[Finding]:
    """Loads that are implausible for a body of this stiffness and size [m]: probably a wrong unit."""
    modulus, gravity = 10 * study.tissue.youngs_modulus, study.gravity
    most = {"Pa": (modulus, "ten times Young's modulus")}
    if extent is not None:
        most["N"] = modulus * extent**2, f"ten times Young's modulus over a body {extent:g} m across"
        most["m"] = extent, "the body's extent"
    factor = max(map(abs, study.load.factors))
    for loc, values, unit in _loads(study):
        size = factor * math.hypot(*values)
        if loc[0] == "gravity" and extent is not None:
            size, unit = study.tissue.density * math.hypot(*values) * extent, "Pa"
        limit, told = most.get(unit, (math.inf, ""))
        if size > limit:
            what = "the weight" if loc[0] == "gravity" else "it"
            text = f"{what} comes to {size:g} {unit}, more than {told} ({limit:g} {unit})"
            yield loc, f"{text}: a mixed-up unit? Bare numbers are in SI units"
    if study.geometry.cavities == "fluid" and gravity is not None:
        text = "no model knows the fluid's weight; leave gravity out, or take empty ones"
        yield ("geometry", "cavities"), text


def _loads(study: Study) -> Iterator[tuple[Loc, tuple[float, ...], str]]:
    """The place of each load, its components at load factor 1 [SI], and their unit."""
    for place, part in enumerate(study.constraints):
        for name in part.loads:
            value = getattr(part, name) or 0.0
            values = value if isinstance(value, tuple) else (value,)
            yield ("constraints", place, name), values, part.unit(name)
    if study.gravity is not None:
        yield ("gravity", "acceleration"), study.gravity.acceleration, study.gravity.unit("acceleration")


def only_load(study: Study) -> tuple[str, float, str] | None:
    """Key, value [SI] and unit of the only number that loads a study; None if there are several or none."""
    found = [(loc, value, unit) for loc, values, unit in _loads(study) for value in values if value]
    if len(found) != 1:
        return None
    ((loc, value, unit),) = found
    return key_text(loc, study.model_dump()), value, unit


def _check_limits(study: Study) -> Iterator[Finding]:
    if study.limits is None:
        return
    if not any(any(values) for _, values, _ in _loads(study)):
        yield ("limits",), "a search needs a load to start from, and all of this study are zero"
    reference = study.study.reference
    if reference is None or split(reference)[0] not in FINITE_STRAIN:
        wanted = " or ".join(f'"{name}"' for name in FINITE_STRAIN)
        yield ("limits",), f"the limits are those against finite strain: they need study.reference = {wanted}"


# --- regions and inclusions ---


def _check_regions(study: Study) -> Iterator[Finding]:
    for name, region in study.regions.items():
        yield from _check_places(region, ("regions", name), study.geometry)


def _check_places(part: Region | Inclusion, loc: Loc, geometry: Geometry) -> Iterator[Finding]:
    """Mistakes in the places of a region or an inclusion."""
    keys = [key for key in type(part).model_fields if key in Region.model_fields]
    if part.model_fields_set.isdisjoint(keys):
        yield loc, f"selects nothing; give {', '.join(keys)}, or several, all of which are to hold"
    for key, half_space in (("below", part.below), ("above", part.above)):
        if half_space is not None and (half_space.fraction is None) == (half_space.value is None):
            yield (*loc, key), "give either fraction or value"
    for axis, low, high in zip("xyz", part.box.min, part.box.max, strict=True) if part.box else ():
        if low >= high:
            text = f"must be above min along {axis}: {high:g} m is not above {low:g} m"
            yield (*loc, "box", "max"), text
    if part.group is not None and not (isinstance(geometry, FileBody) and geometry.suffix == ".msh"):
        yield (*loc, "group"), "only a MSH file has named groups; say where it is instead"


def _check_inclusions(study: Study) -> Iterator[Finding]:
    """Mistakes in the inclusions, and in the models that may ignore them."""
    inclusions, info = study.inclusions or (), study.study
    yield from named_twice("inclusions", inclusions, "inclusion")
    for place, part in enumerate(inclusions):
        yield from _check_places(part, ("inclusions", place), study.geometry)
        if part.poisson_ratio is not None and min(part.poisson_ratio, study.tissue.poisson_ratio) <= 0.0:
            text = "where ratios differ each must be above 0; leave it out, or give others"
            yield ("inclusions", place, "poisson_ratio"), text
    for place, name in enumerate(info.homogeneous):
        loc = ("study", "homogeneous", place)
        if not inclusions:
            yield loc, "decides nothing without [[inclusions]]; leave it out"
        elif name not in info.models:
            yield loc, unknown(name, list(info.models), "model of this study")
        elif name == info.reference:
            yield loc, f"{shown(name)} is the reference, which has to know the inclusions"


# --- measured tables ---


def _check_measured(study: Study) -> Iterator[Finding]:
    """Mistakes in the measured tables, each with the rest of the study."""
    yield from named_twice("measured", study.measured or (), "table")
    for place, table in enumerate(study.measured or ()):
        loc = ("measured", place)
        own: Sequence[Any] = table.points or [table] * bool(table.surface)
        yield from _check_uncertainty("uncertainty", table.uncertainty, own, loc)
        if table.forces:
            yield from _check_forces(study, table, loc)
        yield from _check_factors(study, table, place)


def pushing(study: Study) -> list[str]:
    """Names of the constraints with a curve of force against depth: contacts, indenters and moved regions."""
    return [
        part.name
        for part in study.constraints
        if part.kind in ("contact", "indenter")
        or (part.kind == "constrained" and any(part.displacement or ()))
    ]


def _check_forces(study: Study, table: Measured, loc: Loc) -> Iterator[Finding]:
    yield from _check_uncertainty("force_uncertainty", table.force_uncertainty, table.forces, loc)
    names = pushing(study)
    if table.constraint is not None and table.constraint not in names:
        yield (*loc, "constraint"), unknown(table.constraint, names, "contact, indenter or movement")
        return
    if table.constraint is None and len(names) != 1:
        told = f"several push: {', '.join(names)}; name one" if names else "nothing pushes the body"
        yield (*loc, "constraint"), told
        return
    name = table.constraint or names[0]
    part = next(part for part in study.constraints if part.name == name)
    if part.kind == "contact" and part.force is None and part.profile not in (None, "uniform"):
        yield (
            (*loc, "constraint"),
            f"{shown(name)} has a pressure of a {part.profile} profile; give its force instead",
        )


def _check_uncertainty(key: str, given: float | None, rows: Sequence[Any], loc: Loc) -> Iterator[Finding]:
    bare = next((row for row in rows if row.uncertainty is None), None)
    if given is None and bare is not None:
        where = f" (line {bare.line})" if getattr(bare, "line", None) else ""
        text = (
            f"is missing{where}: without u_D nobody can tell an error from noise; give a standard uncertainty"
        )
        yield (*loc, key), text


def _check_factors(study: Study, table: Measured, place: int) -> Iterator[Finding]:
    history = study.load.history
    largest = max(map(abs, history))
    for point in (None, *table.points):
        factor = table.factor(point)
        if factor is not None and not any(same_load(factor, step, largest) for step in history):
            where = f" (line {point.line} of its file)" if point is not None and point.line else ""
            steps = ", ".join(f"{step:g}" for step in history[:8])
            text = f"{factor:g}{where} is no step of the load history, which has {steps}"
            yield ("measured", place, "load_factor"), text
            return


# --- one pass over the data of a study: a Study, or every problem in plain words ---


def validate(data: Mapping[str, Any], source: Source) -> tuple[Study | None, list[Finding]]:
    """The study in `data`, as parsed from TOML, or None and its mistakes, in single keys or between them.

    The search stops after one problem more than are reported: some take a search for the intended name.
    """
    try:
        study = Study.model_validate(data, context=source)
    except ValidationError as error:
        found: list[Finding] = [
            (details["loc"], details["msg"]) for details in error.errors(include_url=False)
        ]
        return None, sorted(found, key=lambda finding: source.line(finding[0]))[: MOST_TOLD + 1]
    findings = list(islice(check(study), MOST_TOLD + 1))
    study._source = source
    return (None if findings else study), findings
