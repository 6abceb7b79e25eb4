"""What must hold in the regions and inclusions of a study; `checks` says how a lenient study reads."""

from __future__ import annotations

from collections.abc import Iterator

from .kinds import safe_name
from .problems import Finding, Loc
from .schema import Box, HalfSpace, Inclusion, Region, Study
from .units import shown
from .wording import given, listed, named_twice, unknown

_MOST_PARTS, _DEEPEST = 1000, 50  # regions that one region may be made of, and levels of them
_ONE_OF = "below, above, ball, box, cap, group, all, any, not"


def check_regions(study: Study) -> Iterator[Finding]:
    """Everything that is wrong with the regions, by themselves and with the body that they are on."""
    yield from _check_regions(study.regions or {})
    yield from _check_groups(study)
    yield from _check_coordinates(study)


def _check_regions(regions: dict[str, Region]) -> Iterator[Finding]:
    for name, region in regions.items():
        try:
            safe_name(name)
        except ValueError as error:
            yield ("regions", name), str(error)
        yield from _check_region(region, ("regions", name), regions)
        if name in _reached(name, regions):
            yield ("regions", name), "refers to itself, directly or through other regions"
        elif _is_too_large(region, regions):
            yield (
                ("regions", name),
                f"is made of more than {_MOST_PARTS} regions, or more than {_DEEPEST} levels",
            )


def _check_groups(study: Study) -> Iterator[Finding]:
    """Named groups of nodes where the body has none."""
    geometry = study.geometry
    if geometry is None or geometry.shape is None:
        return
    if geometry.shape == "file" and (geometry.path is None or geometry.path.suffix.lower() == ".msh"):
        return
    for name, region in (study.regions or {}).items():
        for loc in _groups_in(region, ("regions", name)):
            yield loc, "only a MSH file has named groups of nodes; say where the region is instead"
    for place, part in enumerate(study.inclusions or ()):
        if part.group is not None:
            yield (
                ("inclusions", place, "group"),
                "only a MSH file has named groups; give a ball or a box instead",
            )


def _check_coordinates(study: Study) -> Iterator[Finding]:
    """Coordinates in a body from a file, of which nothing says where they are measured from.

    Until version 0.2 that was the middle of the body: studies of that time must not change in silence.
    """
    geometry = study.geometry
    if geometry is None or geometry.shape != "file" or "coordinates" in given(geometry):
        return
    names = [
        f"region {shown(name)}" for name, part in (study.regions or {}).items() if _has_coordinates(part)
    ]
    names += [f"inclusion {shown(part.name)}" for part in study.inclusions or () if part.ball or part.box]
    names += [f"measured table {shown(table.name)}" for table in study.measured or () if table.name]
    if names:
        yield (
            ("geometry", "coordinates"),
            f'is missing, and {names[0]} has coordinates: give "file" where they are those of the '
            'file, in metres, or "centred" where they are from the middle of its bounding box, as they were '
            "before version 0.2",
        )


def _has_coordinates(region: Region) -> bool:
    planes = (region.below, region.above)
    own = region.ball or region.box or any("value" in given(plane) for plane in planes if plane is not None)
    return bool(own) or any(_has_coordinates(part) for _, part in _parts(region) if isinstance(part, Region))


def _groups_in(region: Region, loc: Loc) -> Iterator[Loc]:
    if region.group is not None:
        yield (*loc, "group")
    for part_loc, part in _parts(region):
        if isinstance(part, Region):
            yield from _groups_in(part, (*loc, *part_loc))


def _check_region(region: Region, loc: Loc, regions: dict[str, Region]) -> Iterator[Finding]:
    present = given(region)
    if len(present) != 1:
        have = f", not {listed(present)}" if present else ""
        yield loc, f"give exactly one of {_ONE_OF}{have}"
    for key in ("below", "above"):
        half_space: HalfSpace | None = getattr(region, key)
        if half_space is not None and len(given(half_space) & {"fraction", "value"}) != 1:
            yield (*loc, key), "give either fraction or value"
    yield from _check_box(region.box, (*loc, "box"))
    for part_loc, part in _parts(region):
        if isinstance(part, Region):
            yield from _check_region(part, (*loc, *part_loc), regions)
        elif part not in regions:
            yield (*loc, *part_loc), unknown(part, list(regions), "region")


def _parts(region: Region) -> Iterator[tuple[Loc, Region | str]]:
    """The regions that a region is made of, each with its place inside."""
    for key, parts in (("all", region.all_of), ("any", region.any_of)):
        yield from (((key, place), part) for place, part in enumerate(parts or ()))
    if region.not_of is not None:
        yield ("not",), region.not_of


def _reached(name: str, regions: dict[str, Region]) -> set[str]:
    """The names that a region refers to, directly or through others."""
    reached: set[str] = set()
    todo: list[Region] = [regions[name]]
    while todo:
        for _, part in _parts(todo.pop()):
            if isinstance(part, Region):
                todo.append(part)
            elif part in regions and part not in reached:
                reached.add(part)
                todo.append(regions[part])
    return reached


def _is_too_large(region: Region, regions: dict[str, Region]) -> bool:
    """Whether working out a region takes too many steps: doubling thirty times over fits in a small file."""
    count = 0
    todo: list[tuple[Region, int]] = [(region, 1)]
    while todo:
        whole, depth = todo.pop()
        count += 1
        if count > _MOST_PARTS or depth > _DEEPEST:
            return True
        parts = (part if isinstance(part, Region) else regions.get(part) for _, part in _parts(whole))
        todo += [(part, depth + 1) for part in parts if part is not None]
    return False


# --- inclusions ---


def check_inclusions(study: Study) -> Iterator[Finding]:
    """Everything that is wrong with the inclusions, and with the models that may leave them out."""
    yield from named_twice("inclusions", study.inclusions or (), "inclusion")
    for place, part in enumerate(study.inclusions or ()):
        loc: Loc = ("inclusions", place)
        yield from _check_place(part, loc)
        ratios = [part.poisson_ratio, study.tissue.poisson_ratio if study.tissue is not None else None]
        if part.poisson_ratio is not None and any(ratio is not None and ratio <= 0.0 for ratio in ratios):
            yield (
                (*loc, "poisson_ratio"),
                "where ratios differ each must be above 0; leave it out, or give others",
            )
    yield from _check_homogeneous(study)


def _check_place(part: Inclusion, loc: Loc) -> Iterator[Finding]:
    present = given(part) & {"ball", "box", "group"}
    if len(present) != 1:
        yield loc, f"give exactly one of ball, box, group{f', not {listed(present)}' if present else ''}"
    yield from _check_box(part.box, (*loc, "box"))


def _check_box(box: Box | None, loc: Loc) -> Iterator[Finding]:
    """What is wrong with a box: corners that are not lowest and highest."""
    if box is None or box.min is None or box.max is None:
        return
    for axis, low, high in zip("xyz", box.min, box.max, strict=True):
        if low >= high:
            yield (*loc, "max"), f"must be above min along {axis}: {high:g} m is not above {low:g} m"


def _check_homogeneous(study: Study) -> Iterator[Finding]:
    info = study.study
    for place, name in enumerate((info and info.homogeneous) or ()):
        loc = ("study", "homogeneous", place)
        if not study.inclusions:
            yield loc, "decides nothing without [[inclusions]]; leave it out"
        elif name not in (info.models or ()):
            yield loc, unknown(name, list(info.models or ()), "model of this study")
        elif name == info.reference:
            yield loc, f"{shown(name)} is the reference, which has to know the inclusions"
