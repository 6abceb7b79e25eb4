"""The registry of models: each declares all that a study, a plan and a report need to know.

The keys that a model reads decide its content keys; loads that superpose are combined instead of solved. Families
of models are loaded on demand: our own, and those of other packages by the entry point `vdmbench.models`. The
module of an entry point registers its models when it is imported. A model is one `register(Model(...))`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import iter_modules
from types import ModuleType
from typing import Any


def load_all(package: str, prefix: str) -> list[ModuleType]:
    """Import the modules of a package whose names begin with `prefix`, in the order of their names."""
    names = sorted(found.name for found in iter_modules(import_module(package).__path__))
    return [import_module(f"{package}.{name}") for name in names if name.startswith(prefix)]


# --- properties that follow from a model's name, for the report, which reads results alone ---


FINITE_STRAIN = ("fem",)  # models that can be the reference of the small-strain limits
DISPLACEMENT_ELEMENTS = ("fem-p1", "fem-p2")  # without an answer for an incompressible body
REFINED = " refined"  # suffix of the reference's name on refinements of the case's mesh
# solvers of nonlinear problems
_NOT_LINEAR = ("quasi-linear", "nonlinear", "incremental", "figure-8")


def split(name: str) -> tuple[str, str]:
    """Registered name and solver, by default "linear"; a suffix for a refined level is dropped."""
    base, _, solver = name.partition(" ")[0].partition(":")
    return base, solver or "linear"


# --- the models ---


EXTRAS = {  # features of a study that not every model takes -> the message for a model that does not
    "cavities": "knows no cavities; take bem, or finite elements",
    "fluid in cavities": "knows no fluid in cavities; take bem, fem-linear or fem",
    "dead forces": "takes no dead force along a line or over facets; use another model for it",
    "normal springs": "takes no springs along the normal; use another model for them",
    "full springs": "takes no springs that resist in every direction; use another model for them",
    "fibres": "is isotropic; use another model for fibres",
    "inclusions": "knows no inclusions; study.homogeneous lets it answer without them, or leave it out",
    "indenter": "takes no rigid indenter; use another model for it, or give its pressure as a contact",
    "law": "has no such law of large strain; leave out tissue.law, or the model",
    "scanned shape": "finds no rest shape for gravity.scanned; take fem or bem:nonlinear",
}
SCANNED = "scanned shape"
ENTRY_POINT = "vdmbench.models"


class Family(StrEnum):
    """The kind of a model; each family has its own verdict, in this order."""

    PRINTED = "vdm-printed"
    """Equations (1)-(38) of the paper, nothing added."""
    DERIVED = "vdm-derived"
    """Pascal's principle and one volume row on a better skin."""
    PEERS = "surface-peers"
    """Other models that need the surface alone."""
    ELEMENTS = "elements"
    """What one would take without the paper."""
    ENGINES = "engines"
    """Other people's programs: plug-ins and foreign results."""


SURFACE = (Family.PRINTED, Family.DERIVED, Family.PEERS)  # which need the surface of a body alone


_FAMILIES = ("vdmbench.models.surface", "vdmbench.models.elements")


@dataclass(frozen=True)
class Parameter:
    """A number in a model's own table, in `unit` (SI, "1" for a plain number), with its help."""

    unit: str
    help: str


@dataclass(frozen=True)
class Size:
    """Numbers of surface nodes and tetrahedra of a mesh, counted or expected."""

    nodes: float
    tetrahedra: float

    def refined(self, times: int) -> Size:
        """The size after so many refinements; results stay on the nodes of the case's mesh."""
        return Size(4.0**times * self.nodes, 8.0**times * self.tetrahedra)


@dataclass(frozen=True, kw_only=True)
class Model:
    """The declaration of a model, and its set-up.

    Attributes
    ----------
    prepare : (scene, solver, name, n_loads) -> `vdmbench.models.SetUp`: sets it up for the body of a scene and
        about so many load steps; raises ValueError with a sentence
    continues : the same for loads of one rising path, each solved from the last; None if not available
    name : as in a study, without the solver
    family : its family
    version : raised whenever its numbers change; part of every key
    volumetric : whether it needs tetrahedra
    solvers : its solvers, the default first
    superposes : solvers whose answers to loads superpose
    tissue : keys of [tissue] that it reads, without the density, which all read if weight acts
    parameters : keys of [vdm] and of its own table that it reads
    by_rule : those of these that are moduli, set from the tissue unless a study sets them
    most_nodes : solver -> largest number of surface nodes; no entry without a limit
    memory : (mesh, solver) -> approximate bytes of a set-up, for the check of a plan; None if small
    contact_in_setup : whether its set-up depends on the place of contact and the motion of the body
    takes : the `EXTRAS` that it takes, each with its solvers; others are refused
    of_solvers : parameters that only some of its solvers read, with these solvers
    own : parameters without a key in [vdm]: a study gives them in [models.NAME]
    """

    prepare: Callable[..., Any]
    name: str
    version: str
    volumetric: bool
    solvers: tuple[str, ...]
    superposes: tuple[str, ...]
    tissue: tuple[str, ...]
    parameters: tuple[str, ...]
    by_rule: tuple[str, ...] = ()
    most_nodes: Mapping[str, int] = field(default_factory=dict)
    memory: Callable[[Size, str], float] | None = None
    contact_in_setup: bool = False
    takes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    of_solvers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    own: Mapping[str, Parameter] = field(default_factory=dict)
    family: Family = Family.ENGINES
    continues: Callable[..., Any] | None = None


MODELS: dict[str, Model] = {}  # filled by `vdmbench.models.register`, see `all_models`

BROKEN: dict[str, str] = {}  # entry points that do not load -> the reason, as a sentence


def own_parameters() -> dict[str, Parameter]:
    """Parameters that models declare beside those of [vdm], for the families loaded so far."""
    return {key: parameter for model in MODELS.values() for key, parameter in model.own.items()}


@cache
def _load_families() -> None:
    for module in _FAMILIES:
        import_module(module)
    for entry in entry_points(group=ENTRY_POINT):
        known = dict(MODELS)
        try:
            entry.load()
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt | MemoryError):
                raise
            MODELS.clear()
            MODELS.update(known)
            told = f"{type(error).__name__}: {error}".rstrip(": ")
            BROKEN[entry.name] = f"the model package {entry.name!r} ({entry.value}) does not load: {told}"


def all_models() -> dict[str, Model]:
    """Every model by its name, including those of other packages."""
    _load_families()
    return MODELS


def model_names() -> list[str]:
    """Every name that a study can use, with and without solver."""
    return [
        name
        for model in all_models().values()
        for name in (model.name, *(f"{model.name}:{solver}" for solver in model.solvers))
    ]


def _known(name: str) -> tuple[Model | None, str]:
    """The registered model of a name, without a refined level's suffix, or None; and the solver."""
    base, _, solver = name.partition(REFINED)[0].partition(":")
    model = all_models().get(base)
    return model, solver or (model.solvers[0] if model is not None else "")


def find(name: str) -> tuple[Model, str]:
    """The model and solver behind "name" or "name:solver".

    Raises
    ------
    KeyError
        no such model or solver.
    """
    model, solver = _known(name)
    if model is None or solver not in model.solvers:
        raise KeyError(name)
    return model, solver


def lacks(name: str, extras: Collection[str]) -> list[str]:
    """A sentence with a remedy for each of these `EXTRAS` that a model does not take with its solver."""
    model, solver = find(name)
    if is_linear(name):
        extras = {*extras} - {"law"}  # a law of large strain has no effect
    wanted = [extra for extra in EXTRAS if extra in extras and solver not in model.takes.get(extra, ())]
    return [f"{name} {EXTRAS[extra]}" for extra in wanted]


def family_of(name: str) -> Family:
    """The family of a model or a refined level of it; an unregistered model is another program's."""
    model, _ = _known(name)
    return model.family if model is not None else Family.ENGINES


def is_linear(name: str) -> bool:
    """Whether a model solves the linear problem from rest; another program's does if it superposes."""
    base, solver = split(name)
    model = all_models().get(base)
    if model is not None and model.family is Family.ENGINES and solver not in model.superposes:
        return False
    return base not in FINITE_STRAIN and solver not in _NOT_LINEAR


def is_surface(name: str) -> bool:
    """Whether a model needs the surface alone: a form of VDM or a peer."""
    return family_of(name) in SURFACE


def reads(name: str) -> tuple[str, ...]:
    """Keys of [vdm] that a model reads with its solver; none if it is unknown."""
    model, solver = _known(name)
    if model is None:
        return ()
    return tuple(key for key in model.parameters if solver in model.of_solvers.get(key, (solver,)))


def superposes(name: str, *, penalty: bool = False) -> bool:
    """Whether a model's answers to loads superpose; not with a penalty, which leaves too much rounding."""
    model, solver = find(name)
    return solver in model.superposes and not penalty
