"""What a study has that not every model takes: a model declares it, one that does not refuses it by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .laws import NEO_HOOKEAN

if TYPE_CHECKING:
    from .schema import Study

EXTRAS = {  # what there is -> what is said of a model that does not take it
    "normal springs": "takes no springs along the normal; use another model for them",
    "full springs": "takes no springs that resist in every direction; use another model for them",
    "inclusions": "knows no inclusions; study.homogeneous lets it answer without them, or leave it out",
    "law": "has no such law of large strain; leave out tissue.law, or the model",
}


def extras_of(study: Study) -> frozenset[str]:
    """Of `EXTRAS` those that a study has."""
    found = {f"{part.direction} springs" for part in study.constraints if part.kind == "elastic"}
    if study.tissue.law not in (None, NEO_HOOKEAN):
        found.add("law")
    if study.inclusions:
        found.add("inclusions")
    return frozenset(found)


def extras_for(name: str, study: Study) -> frozenset[str]:
    """Those that a model of the study is asked for: what it may leave out is not among them."""
    return extras_of(study) - ({"inclusions"} if name in study.study.homogeneous else set())
