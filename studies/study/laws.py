"""Laws of large strain, and their keys of [tissue]: numbers without a unit beside the moduli at small strain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .problems import Finding, Loc
from .units import shown
from .wording import listed

if TYPE_CHECKING:
    from .schema import Study
    from .tissue_table import Tissue

NEO_HOOKEAN = "neo-hookean"


@dataclass(frozen=True)
class Law:
    """A law: its name in `fem_reference.materials`, and the keys that it needs."""

    material: str
    keys: tuple[str, ...] = ()


LAWS: Mapping[str, Law] = {
    NEO_HOOKEAN: Law(NEO_HOOKEAN),
    "mooney-rivlin": Law("mooney-rivlin", ("second_share",)),
    "yeoh": Law("yeoh", ("second_ratio", "third_ratio")),
    "fung": Law("fung-demiray", ("exponent",)),
    "ogden": Law("ogden", ("exponents", "shares")),
}
LAW_KEYS = tuple(dict.fromkeys(key for law in LAWS.values() for key in law.keys))


def parameters_of(tissue: Tissue) -> dict[str, float | tuple[float, ...]]:
    """The numbers of a tissue's law by key; none of the neo-Hookean one."""
    return {key: getattr(tissue, key) for key in LAWS[tissue.law or NEO_HOOKEAN].keys}


def check_law(study: Study) -> Iterator[Finding]:
    """What is wrong with the law and its keys together."""
    tissue = study.tissue
    if tissue is None:
        return
    present = {key for key in LAW_KEYS if key in tissue.model_fields_set}
    law = tissue.law or NEO_HOOKEAN
    place: Loc = ("tissue",)
    for key in LAWS[law].keys:
        if key not in present:
            yield (*place, key), f"is missing; the law {shown(law)} needs {listed(set(LAWS[law].keys))}"
    for key in sorted(present - set(LAWS[law].keys)):
        owners = {name for name, other in LAWS.items() if key in other.keys}
        yield (*place, key), f"belongs to the law {listed(owners)}, not to {shown(law)}; leave it out"
    if law != NEO_HOOKEAN and study.anisotropy is not None:
        yield (*place, "law"), f"{shown(law)} has no fibres; leave out [anisotropy], or the law"
    exponents, shares = tissue.exponents, tissue.shares
    if exponents and shares:
        if len(exponents) != len(shares):
            yield (
                (*place, "shares"),
                f"has {len(shares)} numbers; give one for each of {len(exponents)} exponents",
            )
        if abs(sum(shares) - 1.0) > 1e-9:
            yield (*place, "shares"), f"must sum to 1, not {sum(shares):g}"
