"""What the reference's own motion is made of, and what that costs models that move nodes along normals."""

from __future__ import annotations

import math

from .digest import Digest
from .formatting import listed, plural, short_percent

_ALONG_NORMALS = 1e-9  # of its motion that a model has in the surface
_NORMAL = "relative_l2_normal_error"


def motion_in_words(digest: Digest) -> tuple[str, ...]:
    """Sentences on the reference's rigid share and on the floor of scalar forms; none without a comparison."""
    if digest.reference is None or not digest.compared:
        return ()
    rigid, floor = (_median(digest, digest.reference, name) for name in ("rigid_share", "tangential_share"))
    sentences = []
    if rigid > math.sqrt(0.5):  # more than the change of shape has
        sentences.append(
            f"Rigid motion is {short_percent(rigid)} of the reference's displacement. "
            "The change of shape leaves it out."
        )
    scalar = [name for name in digest.compared if _moves_along_normals(digest, name)]
    if scalar and math.isfinite(floor):
        kind = plural(len(scalar), "model")
        own = listed(f"{name} {short_percent(_median(digest, name, _NORMAL))}" for name in scalar)
        sentences.append(
            f"{kind.capitalize()} can move nodes along normals only: the reference itself, moved so, is "
            f"{short_percent(floor)} off. Errors of the normal component alone: {own}."
        )
    return tuple(sentences)


def _moves_along_normals(digest: Digest, model: str) -> bool:
    share = digest.spread(model, "tangential_share")
    return share is not None and share.worst < _ALONG_NORMALS


def _median(digest: Digest, model: str, metric: str) -> float:
    found = digest.spread(model, metric)
    return math.nan if found is None else found.median
