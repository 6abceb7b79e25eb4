"""Whether a load is beyond what a small-strain reference can judge."""

from __future__ import annotations

from ..measures.bars import at_full_load
from ..scene.warnings import MOST_DRIFT, MOST_MOVED, motion_share
from ..study.registry import FINITE_STRAIN, split
from .digest import Digest
from .formatting import listed, short_percent
from .loading import supports


def beyond_small_strain(digest: Digest) -> str:
    """Why the reference is outside its own theory at full load, and what to do; "" where it is not."""
    if digest.reference is None or split(digest.reference)[0] in FINITE_STRAIN:
        return ""
    moved_by = drift = 0.0
    for case in digest.cases:
        if (result := case.models.get(str(case.reference))) is None:
            continue
        displacement = result.displacement[case.full_load]
        extent = digest.surfaces[case.hash].smallest_extent
        moved_by = max(moved_by, motion_share(displacement, supports(case), extent))
        drift = max(drift, abs(at_full_load(case, str(case.reference), "volume_drift")))
    parts = []
    if moved_by > MOST_MOVED:
        parts.append(f"moves the body by {short_percent(moved_by)} of its smallest extent")
    if drift > MOST_DRIFT:
        whose = "its" if parts else "the body's"
        parts.append(f"changes {whose} volume by {short_percent(drift)}")
    if not parts:
        return ""
    where = " in some case" if len(digest.cases) > 1 else ""
    return (
        f"The load {listed(parts)}{where}. The reference holds for small strain and cannot judge that. "
        'Lower the load, or take reference = "fem".'
    )
