"""What must hold in the inclusions of a study; `checks` says how a lenient study reads."""

from __future__ import annotations

from collections.abc import Iterator

from .problems import Finding, Loc
from .schema import Box, Inclusion, Study
from .units import shown
from .wording import given, listed, named_twice, unknown


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
    yield from check_box(part.box, (*loc, "box"))


def check_box(box: Box | None, loc: Loc) -> Iterator[Finding]:
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
