"""What the reference's own motion is made of, and what that costs models that move nodes along normals."""

from __future__ import annotations

import math

from .digest import Digest
from .formatting import listed, plural, short_percent

ALONG_NORMALS = 1e-9  # of its motion that a model has in the surface
NORMAL = "relative_l2_normal_error"


def mostly_rigid(digest: Digest) -> bool:
    """Whether the reference's displacement is more rigid motion than change of shape: at the median."""
    reference = digest.reference
    return reference is not None and _median(digest, reference, "rigid_share") > math.sqrt(0.5)


def motion_in_words(digest: Digest) -> tuple[str, ...]:
    """Sentences on the reference's rigid share and on the floor of scalar forms; none without a comparison."""
    if digest.reference is None or not digest.compared:
        return ()
    rigid, floor = (_median(digest, digest.reference, name) for name in ("rigid_share", "tangential_share"))
    sentences = []
    if mostly_rigid(digest):
        sentences.append(
            f"Rigid motion is {short_percent(rigid)} of the reference's displacement. "
            "The change of shape leaves it out."
        )
    own = {name: found[1] for name in digest.compared if (found := along_normals(digest, name)) is not None}
    if own:
        told = listed(f"{name} {short_percent(error)}" for name, error in own.items())
        sentences.append(
            f"{plural(len(own), 'model').capitalize()} can move nodes along normals only: the reference itself, "
            f"moved so, is {short_percent(floor)} off. Errors of the normal component alone: {told}."
        )
    return tuple(sentences)


def along_normals(digest: Digest, model: str) -> tuple[float, float] | None:
    """Of a model that moves nodes along normals only, medians over the cases; None of any other.

    Returns
    -------
    the displacement error of the reference itself, moved so, below which the model cannot be, and the model's error
    in the normal component, which is what it predicts
    """
    share = digest.spread(model, "tangential_share")
    if digest.reference is None or share is None or not share.worst < ALONG_NORMALS:
        return None
    floor = _median(digest, digest.reference, "tangential_share")
    return (floor, _median(digest, model, NORMAL)) if math.isfinite(floor) else None


def _median(digest: Digest, model: str, metric: str) -> float:
    found = digest.spread(model, metric)
    return math.nan if found is None else found.median
