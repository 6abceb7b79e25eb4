"""Kinds of constraints: what holds, moves and loads a body.

One more is a `register(LoadKind(...))`, here or in a file `load_NAME.py`. Its keys of [[constraints]], the checks,
its unit loads (which decide what answers are shared) and what it does on a mesh follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, get_args

from pydantic import Field

from .kinds import SI, Direction, Enters, Force, Length, Name, Position, Pressure, Table, positive
from .registry import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


PROFILES: dict[str, Callable[[Array], Array]] = {}
VERSIONS = {"uniform": "1"}


def profile(function: Callable[[Array], Array], version: str = "1") -> Callable[[Array], Array]:
    """Register pressure over its peak at rho, 0 in the middle and 1 at the rim, beyond which it is nothing.

    Parameters
    ----------
    version : raised whenever its values change; part of the keys of results

    Raises
    ------
    ValueError
        a name that is taken.
    """
    name = function.__name__
    if name in VERSIONS:
        raise ValueError(f"a profile {name!r} is registered already")
    PROFILES[name], VERSIONS[name] = function, version
    return function


# numpy is slow to load: not where a study is only checked


@profile
def hertz(rho: Array) -> Array:
    """Pressure over its peak: sqrt(1 - rho^2), nothing beyond the rim rho = 1."""
    import numpy as np

    return np.asarray(np.sqrt(np.clip(1.0 - rho**2, 0.0, None)))


@profile
def gaussian(rho: Array) -> Array:
    """Pressure over its peak: exp(-9/2 rho^2), the third standard deviation at the rim rho = 1, nothing beyond."""
    import numpy as np

    return np.where(rho < 1.0, np.exp(-4.5 * rho**2), 0.0)


load_all("vdmbench.study", "profile_")  # last: they use what is above

if TYPE_CHECKING:
    Profile = str
else:
    Profile = Literal[("uniform", *PROFILES)]


# --- Kinds of constraints: what holds, moves and loads a body ---


class AnyConstraint(Table):
    """What every table of [[constraints]] has; the keys that kinds declare are added to it."""

    kind: str
    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    region: str = Field(description="name of the region")
    name: Annotated[Name, Enters.CASE] = Field(
        "", description="names it in sweeps and reports; the region's name where left out"
    )


@dataclass(frozen=True)
class LoadKey:
    """A key of [[constraints]] that a kind takes.

    Attributes
    ----------
    type : of its value, with its unit, as the tables of `vdmbench.study.schema` have it
    help : what it is
    is_load : whether it says how much acts, and is raised by load factors; of several such keys one is given
    needed : whether a constraint has to have it, and it is no load
    default : its value where it is left out
    example : what to give where it is missing
    versions : of its words, where they stand for functions; part of the keys of answers
    """

    type: Any
    help: str
    is_load: bool = False
    needed: bool = False
    default: Any = None
    example: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """SI unit, "" of a word."""
        return next((item.unit for item in get_args(self.type) if isinstance(item, SI)), "")


class Placed(Protocol):
    """A constraint on its mesh: N surface nodes, F facets with Q quadrature points each."""

    @property
    def points(self) -> Array:
        """(N, 3) surface nodes [m]."""

    @property
    def triangles(self) -> Any:
        """(F, 3) nodes of the facets."""

    @property
    def nodes(self) -> Any:
        """(N,) mask of its region."""

    def pressure(self, profile: str | None) -> Array:
        """(F, Q) pressure of peak 1 over the region, uniform or by a profile. Raises SceneError."""

    def resultant(self, pressure: Array) -> float:
        """Size of the resultant of a pressure, over its unit [m^2]. Raises SceneError where it has none."""

    def at_quadrature(self, values: Array) -> Array:
        """(F, Q) from (N,) values, linear on each facet of the region, 0 on the others."""

    def edges(self) -> Any:
        """(k, 2) edges of the surface between nodes that have no facet of their own. Raises SceneError."""

    def facets(self) -> Any:
        """(F,) mask of the facets whose three nodes are in the region. Raises SceneError where there is none."""


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
class Pushed:
    """A rigid frictionless indenter.

    Attributes
    ----------
    facets : (F,) mask of those that it can touch
    shape : "sphere", "flat-punch" or "capsule"
    radius, length, along : of the shape; the last two of a capsule [m], [m], (3,)
    direction : (3,) of the push, None for against the mean normal
    depth : from where it first touches [m]
    """

    facets: Any
    shape: str
    radius: float
    length: float
    along: tuple[float, float, float] | None
    direction: tuple[float, float, float] | None
    depth: float


@dataclass(frozen=True)
class Acts:
    """What a constraint does at load factor 1: one or several of these, or nothing.

    Attributes
    ----------
    displacement : (N, 3) or (3,) of the nodes of its region, where it moves them [m]
    pressure : (F, Q) into the body [Pa]
    dead : (k, 2) edges or (k, 3) facets, and (3,) the force that is spread evenly over them [N]
    springs : under some of its facets
    pushed : an indenter
    """

    displacement: Any = None
    pressure: Any = None
    dead: Any = None
    springs: Springs | None = None
    pushed: Pushed | None = None

    @property
    def needs_an_extra(self) -> bool:
        """Whether it does what not every model takes: a model that does not would ignore it."""
        return not (self.dead is None and self.springs is None and self.pushed is None)


@dataclass(frozen=True, kw_only=True)
class LoadKind:
    """A kind of the registry.

    Attributes
    ----------
    name : what a study writes
    help : what happens to the region, in some words
    version : raised whenever it acts otherwise; part of the keys of answers
    keys : its keys of [[constraints]] besides kind, region and name
    holds : whether the displacement of its nodes is known; nothing may press on those
    supports : whether it resists what moves the body and leaves the displacement open: it belongs to a set-up
    extra : which of `vdmbench.study.registry.EXTRAS` a model takes that takes it; "" where every model does
    act : what it does on a mesh
    check : what is wrong with the keys, beyond what they declare: key -> sentence
    """

    name: str
    help: str
    version: str
    keys: Mapping[str, LoadKey] = field(default_factory=dict)
    holds: bool
    supports: bool = False
    extra: Callable[[AnyConstraint], str] = lambda _: ""
    act: Callable[[AnyConstraint, Placed], Acts]
    check: Callable[[AnyConstraint, frozenset[str]], Mapping[str, str]] = lambda *_: {}

    @property
    def loads(self) -> list[str]:
        """The keys that say how much acts."""
        return [name for name, key in self.keys.items() if key.is_load]

    def versions(self, entry: Mapping[str, Any]) -> dict[str, str]:
        """Its own version, and those of the words that a constraint has."""
        found = {name: key.versions.get(str(entry.get(name))) for name, key in self.keys.items()}
        words = {name: version for name, version in found.items() if version is not None}
        return {"kind": self.version, **words}

    def unit_loads(self, entry: Mapping[str, Any], described: str) -> Iterator[tuple[str, float]]:
        """Load of size 1 -> how much of it a constraint has, component by component.

        Parameters
        ----------
        described : the rest of the constraint, its region spelt out
        """
        for name in self.loads:
            value = entry.get(name)
            parts = value if isinstance(value, tuple | list) else [value]
            for axis, part in enumerate(parts if value is not None else ()):
                yield f"{self.name} {name} {axis} {described}", float(part)


KINDS: dict[str, LoadKind] = {}


def register(kind: LoadKind) -> None:
    """Add a kind.

    Raises
    ------
    ValueError
        a name that is taken, no version, a key that another kind declares otherwise, or nothing to hold or load by.
    """
    if kind.name in KINDS:
        raise ValueError(f"a kind of constraint {kind.name!r} is registered already")
    if not kind.version or not (kind.holds or kind.supports or kind.loads):
        raise ValueError(
            f"{kind.name}: a kind declares its version, and holds, supports or has a key that is a load"
        )
    for name, key in kind.keys.items():
        others = [other.keys[name] for other in KINDS.values() if name in other.keys]
        if name in ("kind", "region", "name") or any(key.type != other.type for other in others):
            raise ValueError(f"{kind.name}: {name} is declared already, as something else")
    KINDS[kind.name] = kind


def keys_of_all() -> dict[str, list[tuple[str, LoadKey]]]:
    """Key of [[constraints]] -> the kinds that take it, with what they declare."""
    found: dict[str, list[tuple[str, LoadKey]]] = {}
    for kind in KINDS.values():
        for name, key in kind.keys.items():
            found.setdefault(name, []).append((kind.name, key))
    return found


# --- the kinds ---


def _press(constraint: AnyConstraint, on: Placed) -> Acts:
    shape = on.pressure(constraint.profile)
    if constraint.force is not None:
        return Acts(pressure=shape * (constraint.force / on.resultant(shape)))
    return Acts(pressure=shape * (constraint.pressure or 0.0))


def _check_profile(constraint: AnyConstraint, region: frozenset[str]) -> Mapping[str, str]:
    if constraint.profile in PROFILES and region and not region & {"cap", "ball"}:
        told = f"a {constraint.profile} profile needs a region that is a cap or a ball"
        return {"profile": f'{told}, and "{constraint.region}" is neither'}
    return {}


register(LoadKind(name="fixed", help="held at rest", version="1", holds=True, act=lambda *_: Acts()))
register(
    LoadKind(
        name="contact",
        help="pressed",
        version="1",
        keys={
            "pressure": LoadKey(Pressure, "(peak) pressure, positive into the body", is_load=True),
            "force": LoadKey(Annotated[float, SI("N")], "resultant, instead of the pressure", is_load=True),
            "profile": LoadKey(
                Profile,
                "shape of the pressure, uniform where left out; the others need a cap or ball",
                default="uniform",
                versions=VERSIONS,
            ),
        },
        holds=False,
        act=_press,
        check=_check_profile,
    )
)
register(
    LoadKind(
        name="constrained",
        help="moved by a displacement",
        version="1",
        keys={
            "displacement": LoadKey(
                Position,
                "displacement at load factor 1",
                is_load=True,
                example='three lengths, such as ["0 mm", "0 mm", "-5 mm"]',
            )
        },
        holds=True,
        act=lambda constraint, _: Acts(displacement=constraint.displacement),
    )
)
register(
    LoadKind(
        name="line",
        help="pulled along a line of edges",
        version="1",
        keys={
            "resultant": LoadKey(
                Force,
                "dead force at load factor 1, over its edges",
                is_load=True,
                example='three forces, such as ["0 N", "0 N", "-1 N"]',
            )
        },
        holds=False,
        extra=lambda _: "dead forces",
        act=lambda constraint, on: Acts(dead=(on.edges(), constraint.resultant)),
    )
)
register(
    LoadKind(
        name="traction",
        help="pulled or sheared by a traction of any direction",
        version="1",
        keys={
            "resultant": LoadKey(
                Force,
                "dead force at load factor 1, spread evenly over its facets",
                is_load=True,
                example='three forces, such as ["0.1 N", "0 N", "0 N"]',
            )
        },
        holds=False,
        extra=lambda _: "dead forces",
        act=lambda constraint, on: Acts(dead=(on.triangles[on.facets()], constraint.resultant)),
    )
)
register(
    LoadKind(
        name="elastic",
        help="on springs",
        version="2",
        keys={
            "stiffness": LoadKey(
                Annotated[float, SI("Pa/m"), positive],
                "spring constant per area",
                needed=True,
                example='a pressure per length, such as "1 kPa/mm"',
            ),
            "direction": LoadKey(
                Literal["normal", "full"],
                "what the springs resist: motion along the normal, or any",
                default="normal",
            ),
        },
        holds=False,
        supports=True,
        extra=lambda constraint: f"{constraint.direction or 'normal'} springs",
        act=lambda constraint, on: Acts(
            springs=Springs(on.facets(), constraint.stiffness or 0.0, constraint.direction or "normal")
        ),
    )
)
# --- The kind `indenter`: a rigid frictionless body that is pushed in along an axis, and touches where it will ---


_CAPSULE = ("length", "along")  # keys of a capsule alone


def _push(constraint: AnyConstraint, on: Placed) -> Acts:
    return Acts(
        pushed=Pushed(
            facets=on.facets(),
            shape=constraint.shape or "sphere",
            radius=constraint.radius or 0.0,
            length=constraint.length or 0.0,
            along=constraint.along,
            direction=constraint.push,
            depth=constraint.depth or 0.0,
        )
    )


def _check(constraint: AnyConstraint, region: frozenset[str]) -> Mapping[str, str]:  # noqa: ARG001
    if constraint.shape is None:
        return {}
    given = [key for key in _CAPSULE if key in constraint.model_fields_set]
    if constraint.shape == "capsule":
        return {key: "is missing; a capsule needs length and along" for key in _CAPSULE if key not in given}
    return dict.fromkeys(given, f"belongs to a capsule, not to a {constraint.shape}; leave it out")


register(
    LoadKind(
        name="indenter",
        help="touched by a rigid indenter, without friction",
        version="1",
        keys={
            "depth": LoadKey(
                Length,
                "way of the indenter at load factor 1, from where it first touches the region",
                is_load=True,
                example='a length, such as "5 mm"',
            ),
            "shape": LoadKey(
                Literal["sphere", "flat-punch", "capsule"],
                "of the indenter, whose axis goes through the middle of its region",
                needed=True,
                example="sphere, flat-punch or capsule",
            ),
            "radius": LoadKey(Length, "of the indenter", needed=True, example='a length, such as "10 mm"'),
            "length": LoadKey(Length, "of a capsule, between the middles of its ends"),
            "along": LoadKey(Direction, "axis of a capsule, across the push"),
            "push": LoadKey(
                Direction, "direction of the push, against the region's mean normal where left out"
            ),
        },
        holds=False,
        extra=lambda _: "indenter",
        act=_push,
        check=_check,
    )
)


load_all("vdmbench.study", "load_")  # last: they use what is above
LOAD_KEYS = {name for kind in KINDS.values() for name in kind.loads}
