"""What a study has that not every model takes: a model declares it, one that does not refuses it by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .schema import Study

EXTRAS = {  # what there is -> how it is said
    "normal springs": "springs along the normal",
    "full springs": "springs that resist in every direction",
}


def extras_of(study: Study) -> frozenset[str]:
    """Of `EXTRAS` those that a study has."""
    return frozenset(f"{part.direction} springs" for part in study.constraints if part.kind == "elastic")
