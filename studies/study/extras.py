"""What a study has that not every model takes."""

from __future__ import annotations

from .laws import NEO_HOOKEAN
from .loads import KINDS
from .schema import Study


def extras_of(study: Study) -> frozenset[str]:
    """Of `vdmbench.study.registry.EXTRAS` those that a study has."""
    found = {KINDS[part.kind].extra(part) for part in study.constraints if part.kind in KINDS} - {""}
    if study.tissue.law not in (None, NEO_HOOKEAN):
        found.add("law")
    if study.inclusions:
        found.add("inclusions")
    return frozenset(found)


def extras_for(name: str, study: Study) -> frozenset[str]:
    """Those that a model of the study is asked for: what it may leave out is not among them."""
    return extras_of(study) - ({"inclusions"} if name in study.study.homogeneous else set())
