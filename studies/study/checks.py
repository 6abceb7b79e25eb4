"""What must hold between the keys of a study, beyond each key by itself.

Every check works on a lenient study too, where a faulty or missing value is None: a value is `given` where the
file has it, usable where it is not None.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from .errors import MeshError
from .geometry_spec import (
    DISTORTIONS,
    LARGEST_EXTENT,
    SMALLEST_EXTENT,
    SURFACE_SUFFIXES,
    VOLUME_SUFFIXES,
    check_mesh_size,
    extent_key,
    extents,
)
from .geometry_spec import Geometry as GeometrySpec
from .geometry_table import Geometry
from .laws import check_law
from .loads import KINDS
from .measured_checks import check_measured
from .model_name import DISPLACEMENT_ELEMENTS, is_vdm, split
from .problems import Finding, Loc
from .region_checks import check_inclusions, check_regions
from .registry import all_models, reads
from .schema import (
    MOST_STEPS,
    Constraint,
    Load,
    Region,
    Study,
)
from .shapes import SHAPES
from .table import Table
from .units import shown
from .wording import given, listed, named_twice, unknown

SHAPE_KEYS: dict[str, tuple[set[str], set[str]]] = {  # shape -> keys that it needs, keys that it may have
    **{
        shape.name: ({"mesh_size", *shape.needed}, set(shape.parameters) - shape.needed)
        for shape in SHAPES.values()
    },
    "file": ({"path"}, {"mesh_size", "size", "scale", "coordinates"}),
}
_KIND_KEYS = {kind.name: set(kind.keys) for kind in KINDS.values()}


def check(study: Study) -> Iterator[Finding]:
    """Everything that is wrong with a study whose keys are right by themselves."""
    yield from _check_models(study)
    yield from _check_incompressible(study)
    yield from check_law(study)
    yield from _check_penalty(study)
    yield from _check_unread(study)
    yield from _check_calibration(study)
    yield from _check_geometry(study.geometry)
    yield from check_regions(study)
    yield from _check_constraints(study)
    yield from _check_indenters(study)
    yield from check_inclusions(study)
    yield from _check_history(study.load)
    yield from _check_loads(study)
    yield from _check_acceptance(study)
    yield from check_measured(study)


def fits_kind(data: Mapping[str, Any], loc: Loc) -> bool:
    """Whether a key's place in `data`, as parsed, is in no constraint, or in one of a kind that takes the key."""
    if loc[0] != "constraints":
        return True
    entry = data["constraints"][loc[1]]
    kind = entry.get("kind") if isinstance(entry, Mapping) else None
    others = set[str]().union(*(keys for name, keys in _KIND_KEYS.items() if name != kind))
    return loc[2] not in others - _KIND_KEYS.get(str(kind), others)


def _check_models(study: Study) -> Iterator[Finding]:
    info = study.study
    if info is None or info.models is None:
        return
    if not info.models:
        yield ("study", "models"), "name at least one model"
    for place, name in enumerate(info.models):
        if name in info.models[:place]:
            yield ("study", "models", place), f"{shown(name)} is listed twice"
    if info.reference is not None and info.reference not in info.models:
        yield (
            ("study", "reference"),
            f"{shown(info.reference)} is not among the models of this study; add it to models, or leave "
            "reference out to run without comparison",
        )
    for name in study.models or {}:
        if name not in info.models:
            yield ("models", name), unknown(name, info.models, "model of this study")


def _check_incompressible(study: Study) -> Iterator[Finding]:
    reference = study.study.reference if study.study is not None else None
    ratio = study.tissue.poisson_ratio if study.tissue is not None else None
    if ratio == 0.5 and reference is not None and split(reference)[0] in DISPLACEMENT_ELEMENTS:
        yield (
            ("tissue", "poisson_ratio"),
            f"{reference}, the reference, is a displacement element, which cannot be incompressible; "
            'use reference = "fem-linear", or a ratio below 0.5',
        )


def _check_penalty(study: Study) -> Iterator[Finding]:
    """Held nodes by penalty, equations (25) and (26), are solved by `lu`, whose answer no other may claim."""
    names = [name for name in (study.study and study.study.models) or () if name and "penalty" in reads(name)]
    others = [name for name in names if split(name)[1] not in ("linear", "lu")]
    tables: list[tuple[Loc, Table | None, list[str]]] = [(("vdm", "penalty"), study.vdm, others)]
    tables += [(("models", name, "penalty"), (study.models or {}).get(name), [name]) for name in others]
    for loc, table, answered in tables:
        if answered and getattr(table, "penalty", None) is not None:
            instead = f"[models.{split(answered[0])[0]}]"
            yield (
                loc,
                f"is solved by lu alone, not by {listed(set(answered))}; give it in {instead} or leave it out",
            )


def _check_unread(study: Study) -> Iterator[Finding]:
    """Parameters that decide nothing: [vdm] may serve several models, but one of them has to read each."""
    names = [name for name in (study.study and study.study.models) or () if name]
    if any(split(name)[0] not in all_models() for name in names):
        return  # a name that is wrong: nobody knows what it was to read
    tables: list[tuple[Loc, Table | None, set[str]]] = [
        (("models", name), (study.models or {}).get(name), set(reads(name))) for name in names
    ]
    tables.append((("vdm",), study.vdm, set().union(*map(reads, names))))
    for loc, table, known in tables:
        for key in sorted(given(table) - known) if table is not None else ():
            who = f"{loc[1]} does not read it" if len(loc) > 1 else "no model of this study reads it"
            yield (*loc, key), f"{who}; leave it out. Read here: {listed(known) if known else 'none'}"


def _check_calibration(study: Study) -> Iterator[Finding]:
    """Parameters to fit, where the study names them: a model of VDM has to read each, each model one of them."""
    names = [name for name in (study.study and study.study.models) or () if name and is_vdm(name)]
    asked = (study.calibration and study.calibration.parameters) or ()
    if not asked or not all(map(reads, names)):
        return  # left to the rules, or a name is wrong
    known = set().union(*map(reads, names)) & set(asked)
    for place, key in enumerate(asked):
        loc = ("calibration", "parameters", place)
        if key not in known:
            yield loc, f"no VDM model of this study reads {key}; leave it out"
        elif key in asked[:place]:
            yield loc, f"{key} is listed twice"
    for name in names:
        if known and known.isdisjoint(reads(name)):
            text = f"{name} reads none of them; add one that it reads, or leave parameters out to fit all"
            yield ("calibration", "parameters"), text


def _check_geometry(geometry: Geometry) -> Iterator[Finding]:
    if geometry is None or geometry.shape is None:
        return
    needed, allowed = SHAPE_KEYS[geometry.shape]
    present = given(geometry) - {"shape"}
    missing = sorted(needed - present)
    # of a faulty path nothing is known
    suffix = geometry.path.suffix.lower() if geometry.path is not None else ""
    if geometry.shape == "file" and suffix and suffix not in VOLUME_SUFFIXES and "mesh_size" not in present:
        missing.append("mesh_size")
    for key in missing:
        yield ("geometry", key), f"is missing; {_a(geometry.shape)} needs {listed(needed | {key})}"
    for key in sorted(present - needed - allowed - set(DISTORTIONS)):
        yield ("geometry", key), f"{_a(geometry.shape)} has no {key}; it takes {listed(needed | allowed)}"
    if "seed" in present and not present & {"slivers", "perturbation"}:
        yield ("geometry", "seed"), "decides nothing without slivers or perturbation; give one of them"
    if geometry.path is not None:
        yield from _check_suffix(geometry.path.name, suffix)
    if {"size", "scale"} <= present and geometry.shape == "file":
        yield ("geometry", "scale"), "give size or scale, not both"
    mistaken = list(_check_counts(geometry))
    yield from mistaken
    if not mistaken and needed - present <= {"mesh_size"}:
        yield from _check_extent(geometry)


def _check_counts(geometry: Geometry) -> Iterator[Finding]:
    """Keys that one shape takes as a number and another as a list."""
    shape = SHAPES.get(geometry.shape)
    counts = {name: about.count for name, about in shape.parameters.items()} if shape else {"size": 1}
    for key, count in counts.items():
        value = getattr(geometry, key)
        if value is not None and isinstance(value, tuple) != (count > 1):
            wanted = f"{count} lengths" if count > 1 else "one length"
            text = shape.parameters[key].help if shape else "its largest extent"
            yield ("geometry", key), f"{_a(geometry.shape)} takes {wanted}, {text}"


def _check_extent(geometry: Geometry) -> Iterator[Finding]:
    spec = geometry_spec(geometry)
    if None in spec.parameters.values():
        return  # a faulty one, which has been told
    if geometry.shape == "file" and geometry.size is None:
        return  # its extent is known once it is read
    sizes = (geometry.size,) if isinstance(geometry.size, float) else extents(spec)
    largest = max(sizes)
    key = "size" if geometry.shape == "file" else extent_key(spec)
    if not SMALLEST_EXTENT <= largest <= LARGEST_EXTENT:
        yield (
            ("geometry", key),
            f"the body would be {largest:g} m across, outside {SMALLEST_EXTENT:g} to {LARGEST_EXTENT:g} m: "
            'a mixed-up unit? A bare number is in metres; write "50 mm"',
        )
    elif geometry.mesh_size is not None:
        try:
            check_mesh_size(geometry.mesh_size, min(sizes))
        except MeshError as error:
            yield ("geometry", "mesh_size"), str(error)


def _check_suffix(name: str, suffix: str) -> Iterator[Finding]:
    if suffix == ".geo":
        yield (
            ("geometry", "path"),
            f"{shown(name)}: .geo files are scripts and are not run; give the mesh made from it",
        )
    elif suffix not in SURFACE_SUFFIXES + VOLUME_SUFFIXES:
        yield (
            ("geometry", "path"),
            f"{shown(name)}: unknown kind of file; give a surface ({', '.join(SURFACE_SUFFIXES)}) or "
            f"tetrahedra ({', '.join(VOLUME_SUFFIXES)})",
        )


def geometry_spec(geometry: Geometry) -> GeometrySpec:
    """The geometry as the mesher takes it; `mesh_size` 0 where a file with tetrahedra has none."""
    keys = set().union(*SHAPE_KEYS[geometry.shape], DISTORTIONS) - {"mesh_size", "coordinates"}
    present = {key: getattr(geometry, key) for key in sorted(keys & geometry.model_fields_set)}
    parameters = {key: value for key, value in present.items() if value is not None or key not in DISTORTIONS}
    if geometry.path is not None:
        parameters["path"] = str(geometry.path)
    return GeometrySpec(geometry.shape, geometry.mesh_size or 0.0, parameters)


def _check_constraints(study: Study) -> Iterator[Finding]:
    yield from named_twice("constraints", study.constraints or (), "constraint")
    for place, constraint in enumerate(study.constraints or ()):
        loc, region = ("constraints", place), constraint.region
        if region is not None and study.regions is not None and region not in study.regions:
            yield (*loc, "region"), unknown(region, list(study.regions), "region")
        if constraint.kind is not None:
            yield from _check_kind(constraint, loc, study.regions or {})


def _check_indenters(study: Study) -> Iterator[Finding]:
    places = [place for place, part in enumerate(study.constraints or ()) if part.kind == "indenter"]
    for place in places[1:]:
        yield ("constraints", place, "kind"), "is a second indenter; a study has one, so make it a contact"


def _check_kind(constraint: Constraint, loc: Loc, regions: dict[str, Region]) -> Iterator[Finding]:
    present = given(constraint) - {"kind", "region", "name"}
    allowed = _KIND_KEYS[constraint.kind]
    for key in sorted(present - allowed):
        takes = f"it takes {listed(allowed)}" if allowed else "it takes a region only"
        yield (*loc, key), f"{_a(constraint.kind)} constraint has no {key}; {takes}"
    kind = KINDS[constraint.kind]
    if len(loads := [name for name in kind.loads if name in present]) > 1:
        yield loc, f"has both {' and '.join(loads)}; keep one"
    elif not loads and len(kind.loads) > 1:
        yield loc, f"a {kind.name} needs either {' or '.join(kind.loads)}"
    elif not loads and kind.loads:
        yield (*loc, kind.loads[0]), f"is missing; give {kind.keys[kind.loads[0]].example or 'it'}"
    for name, about in kind.keys.items():
        if about.needed and name not in present:
            yield (*loc, name), f"is missing; give {about.example or 'it'}"
    region = regions.get(constraint.region)
    for key, text in kind.check(constraint, frozenset(given(region)) if region else frozenset()).items():
        yield (*loc, key), text


def _a(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _check_history(load: Load) -> Iterator[Finding]:
    steps = load.steps if load is not None else None
    count = len(load.factors or ()) * steps if steps else 0
    if count > MOST_STEPS:
        text = f"makes a load history of {count:,} steps, more than the {MOST_STEPS:,} allowed; take fewer"
        yield ("load", "steps"), text


def _check_loads(study: Study) -> Iterator[Finding]:
    """Loads that no body of this stiffness and size can mean: a unit has been mixed up."""
    modulus = study.tissue.youngs_modulus if study.tissue is not None else None
    extent = _largest_extent(study.geometry)
    factor = max(map(abs, study.load.factors)) if study.load is not None and study.load.factors else 1.0
    for place, constraint in enumerate(study.constraints or ()):
        loc = ("constraints", place)
        keys = KINDS[constraint.kind].keys.items() if constraint.kind is not None else ()
        for name, key in keys:
            value = getattr(constraint, name)
            if key.is_load and value is not None:
                size = factor * math.hypot(*(value if isinstance(value, tuple) else (value,)))
                if told := _mixed_up(size, key.unit, modulus, extent):
                    yield (*loc, name), told
    if modulus is not None and extent is not None and study.gravity is not None:
        weight = (study.tissue.density or 0.0) * math.hypot(*(study.gravity.acceleration or (0.0,))) * extent
        if weight > 10 * modulus:
            yield (
                ("gravity", "acceleration"),
                f"the weight of a body {extent:g} m across is a pressure of {weight:g} Pa, more than ten times "
                f"Young's modulus ({modulus:g} Pa): a mixed-up unit?",
            )


def _mixed_up(size: float, unit: str, modulus: float | None, extent: float | None) -> str:
    """What is wrong with a load of this size on a body of this stiffness [Pa] and extent [m], if anything."""
    if unit == "Pa" and modulus is not None and size > 10 * modulus:
        return f"{size:g} Pa is more than ten times Young's modulus ({modulus:g} Pa): a mixed-up unit?"
    if extent is None:
        return ""
    if unit == "N" and modulus is not None and size > 10 * modulus * extent**2:
        return (
            f"{size:g} N on a body {extent:g} m across is a pressure of more than ten times Young's "
            f"modulus ({modulus:g} Pa): a mixed-up unit?"
        )
    if unit == "m" and size > extent:
        return (
            f"{size:g} m is more than the body's extent ({extent:g} m): a mixed-up unit? "
            'A bare number is in metres; write "5 mm"'
        )
    return ""


def _check_acceptance(study: Study) -> Iterator[Finding]:
    """A region that is there, and has a limit to go with."""
    limits = study.acceptance
    region = limits.region if limits is not None else None
    if region is None:
        return
    if study.regions is not None and region not in study.regions:
        yield ("acceptance", "region"), unknown(region, list(study.regions), "region")
    if "largest_difference" not in given(limits):
        text = 'decides nothing without largest_difference; give that, such as "1 mm", or leave region out'
        yield ("acceptance", "region"), text


def _largest_extent(geometry: Geometry) -> float | None:
    """The body's largest extent where the keys tell it."""
    if geometry is None or geometry.shape is None or any(_check_geometry(geometry)):
        return None
    if geometry.shape == "file":
        return geometry.size if isinstance(geometry.size, float) else None
    spec = geometry_spec(geometry)
    return None if None in spec.parameters.values() else max(extents(spec))
