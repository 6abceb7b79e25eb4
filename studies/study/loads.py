"""Supports, motions and loads of a body: [[constraints]] as typed tables, one for each kind.

A further kind is a class, here or in a file `load_NAME.py`. Its checks, its effect on a mesh and the sharing of
answers follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from .errors import Loc, listed
from .kinds import (
    SI,
    Direction,
    Enters,
    Force,
    Key,
    Length,
    Name,
    OneOf,
    Position,
    Pressure,
    positive,
)
from .registry import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


VERSION = (
    "4"  # part of all keys; raised whenever a constraint, a profile or a scanned shape changes its numbers
)
PROFILES: dict[str, Callable[[Array], Array]] = {}


def profile(function: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """Register pressure over its peak at rho, 0 in the middle and 1 at the rim; zero beyond."""
    PROFILES[function.__name__] = function
    return function


# numpy is slow to load: not where a study is only checked


@profile
def hertz(rho: Array) -> Array:
    """Pressure over its peak: sqrt(1 - rho^2), zero beyond the rim rho = 1."""
    import numpy as np

    return np.asarray(np.sqrt(np.clip(1.0 - rho**2, 0.0, None)))


@profile
def gaussian(rho: Array) -> Array:
    """Pressure over its peak: exp(-9/2 rho^2), the third standard deviation at the rim rho = 1, zero beyond."""
    import numpy as np

    return np.where(rho < 1.0, np.exp(-4.5 * rho**2), 0.0)


load_all("vdmbench.study", "profile_")  # last: they use what is above

if TYPE_CHECKING:
    Profile = str
else:
    Profile = Literal[("uniform", *PROFILES)]


# --- effects on a mesh ---


Placed = (
    Any  # a `vdmbench.scene.placed.PlacedConstraint`, a floor above: N surface nodes, F facets, Q points each
)


@dataclass(frozen=True)
class Springs:
    """Springs between some facets and the ground.

    Attributes
    ----------
    facets : (F,) mask
    stiffness : per area of the undeformed surface [Pa/m]
    direction : "normal" resists along the normal, "full" in every direction
    """

    facets: Any
    stiffness: float
    direction: str


@dataclass(frozen=True)
class Acts:
    """The effect of a constraint at load factor 1: one or several of these, or none.

    Attributes
    ----------
    displacement : (N, 3) or (3,) displacement of the nodes of its region, if it moves them [m]
    pressure : (F, Q) into the body [Pa]
    dead : (k, 2) edges or (k, 3) facets, and (3,) the force that is spread evenly over them [N]
    springs : under some of its facets
    pushed : (F,) mask of the facets that a rigid frictionless indenter can touch, and its table
    """

    displacement: Any = None
    pressure: Any = None
    dead: Any = None
    springs: Springs | None = None
    pushed: tuple[Any, Indenter] | None = None

    @property
    def extras(self) -> set[str]:
        """The entries of `vdmbench.study.registry.EXTRAS` that it contains: other models would ignore it."""
        found = {"dead forces": self.dead, "indenter": self.pushed}
        springs = {f"{self.springs.direction} springs"} if self.springs is not None else set()
        return {name for name, part in found.items() if part is not None} | springs


# --- The tables ---


class Constraint(OneOf):
    """[[constraints]]; nodes in none are free

    Attributes
    ----------
    holds : whether the displacement of its nodes is known; nothing may press on those
    supports : whether it resists what moves the body and leaves the displacement open: it belongs to a set-up
    loads : its keys that say how much acts, and are raised by load factors; of several one is given
    """

    by = "kind"
    kinds: ClassVar[dict[str, Any]] = {}
    holds: ClassVar[bool] = False
    supports: ClassVar[bool] = False
    loads: ClassVar[tuple[str, ...]] = ()

    kind: str = Key("what happens to the region")
    region: str = Key("name of the region")
    name: Annotated[Name, Enters.CASE] = Key(
        "names it in sweeps and reports; the region's name where left out",
        default_factory=lambda given: given["region"],
    )

    @property
    def extra(self) -> str:
        """The entry of `vdmbench.study.registry.EXTRAS` that a model must take; "" if every model can."""
        return ""

    def act(self, on: Placed) -> Acts:
        """The effect on a mesh. Raises SceneError."""
        raise NotImplementedError(f"{self.kind}: a constraint acts")

    def faults(self, region: frozenset[str]) -> Iterator[tuple[Loc, str]]:  # noqa: ARG002
        """(place inside, mistake there); `region` has the keys of its region."""
        yield from ()


# --- the kinds ---


class Fixed(Constraint):
    """held at rest"""

    kind: Literal["fixed"]
    holds = True

    def act(self, on: Placed) -> Acts:  # noqa: ARG002
        return Acts()


class Contact(Constraint):
    """pressed"""

    kind: Literal["contact"]
    loads = ("pressure", "force")
    pressure: Pressure | None = Key("(peak) pressure, positive into the body", None)
    force: Annotated[float, SI("N")] | None = Key("resultant, instead of the pressure", None)
    profile: Profile = Key("shape of the pressure; all but uniform need a cap or ball", "uniform")

    def act(self, on: Placed) -> Acts:
        shape = on.pressure(self.profile)
        if self.force is not None:
            return Acts(pressure=shape * (self.force / on.resultant(shape)))
        return Acts(pressure=shape * (self.pressure or 0.0))

    def faults(self, region: frozenset[str]) -> Iterator[tuple[Loc, str]]:
        if (self.pressure is None) == (self.force is None):
            yield (), "give either pressure or force"
        if self.profile in PROFILES and region and region - {"cavity"} not in ({"cap"}, {"ball"}):
            told = f"a {self.profile} profile needs a region that is a cap or a ball and no more"
            yield ("profile",), f'{told}, and "{self.region}" has {listed(set(region))}'


class Constrained(Constraint):
    """moved by a displacement"""

    kind: Literal["constrained"]
    holds = True
    loads = ("displacement",)
    displacement: Position = Key('displacement at load factor 1, such as ["0 mm", "0 mm", "-5 mm"]')

    def act(self, on: Placed) -> Acts:  # noqa: ARG002
        return Acts(displacement=self.displacement)


class _Dead(Constraint):
    loads = ("resultant",)

    @property
    def extra(self) -> str:
        return "dead forces"


class Line(_Dead):
    """pulled along a line of edges"""

    kind: Literal["line"]
    resultant: Force = Key('dead force at load factor 1, over its edges, such as ["0 N", "0 N", "-1 N"]')

    def act(self, on: Placed) -> Acts:
        return Acts(dead=(on.edges(), self.resultant))


class Traction(_Dead):
    """pulled or sheared by a traction of any direction"""

    kind: Literal["traction"]
    resultant: Force = Key('dead force at load factor 1, over its facets, such as ["0.1 N", "0 N", "0 N"]')

    def act(self, on: Placed) -> Acts:
        return Acts(dead=(on.triangles[on.facets()], self.resultant))


class Elastic(Constraint):
    """on springs"""

    kind: Literal["elastic"]
    supports = True
    stiffness: Annotated[float, SI("Pa/m"), positive] = Key('spring constant per area, such as "1 kPa/mm"')
    direction: Literal["normal", "full"] = Key("what the springs resist: normal motion, or any", "normal")

    @property
    def extra(self) -> str:
        return f"{self.direction} springs"

    def act(self, on: Placed) -> Acts:
        return Acts(springs=Springs(on.facets(), self.stiffness, self.direction))


class Indenter(Constraint):
    """touched by a rigid indenter, without friction"""

    kind: Literal["indenter"]
    loads = ("depth",)
    depth: Length = Key('way of the indenter at load factor 1, from its first touch, such as "5 mm"')
    shape: Literal["sphere", "flat-punch", "capsule"] = Key(
        "of the indenter, whose axis goes through the middle of its region: sphere, flat-punch or capsule"
    )
    radius: Length = Key('of the indenter, such as "10 mm"')
    length: Length | None = Key("of a capsule, between the middles of its ends", None)
    along: Direction | None = Key("axis of a capsule, across the push", None)
    push: Direction | None = Key("direction of the push; left out: against the region's mean normal", None)

    @property
    def extra(self) -> str:
        return "indenter"

    def act(self, on: Placed) -> Acts:
        return Acts(pushed=(on.facets(), self))

    def faults(self, region: frozenset[str]) -> Iterator[tuple[Loc, str]]:  # noqa: ARG002
        for key in ("length", "along"):
            if (getattr(self, key) is None) == (self.shape == "capsule"):
                missing = self.shape == "capsule"
                yield (key,), "is missing; a capsule needs it" if missing else "is of a capsule; leave it out"


KINDS: dict[str, type[Constraint]] = Constraint.kinds
load_all("vdmbench.study", "load_")  # last: they use what is above
