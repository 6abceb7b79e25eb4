"""What a model is: what it declares, and how it is set up and asked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, cast

from ..scene.scene import Scene, SurfaceLoad
from ..study import registry
from ..study.registry import EXTRAS, MODELS, Declared, own_parameters
from ..study.schema import VdmTable
from ..study.tissue_table import Tissue
from ..study.units import DIMENSIONS

if TYPE_CHECKING:
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem
    from fem_reference.solution import Solution as FemSolution
    from vdm.solution import Solution as VdmSolution
    from vdm.solvers.linear import LinearSolver

    Solution = FemSolution | VdmSolution
    PressureProblem = LinearSolver | LinearProblem | CondensedProblem


@dataclass(frozen=True)
class SetUp:
    """A model made ready for a body: its operators and factors.

    Attributes
    ----------
    solve : load steps -> Solution; the steps are independent where the model superposes, else one load path
    problem : what answers contact pressures linearly; None where nothing does
    of_modulus : the set-up of the same body with another Young's modulus [Pa], on the same factor; None where it is
        another set-up
    """

    solve: Callable[[Sequence[SurfaceLoad]], Solution]
    problem: PressureProblem | None = None
    of_modulus: Callable[[float], SetUp] | None = None


class Prepare(Protocol):
    """Sets a model up on the body of a scene, for about so many load steps. Raises ValueError with a sentence."""

    def __call__(self, scene: Scene, solver: str, name: str, n_loads: int) -> SetUp: ...


@dataclass(frozen=True, kw_only=True)
class Model(Declared):
    """A model of the registry.

    Attributes
    ----------
    prepare : sets it up
    continues : set up for loads of one rising path, each solved from the last: as `prepare`; None where it cannot
    """

    prepare: Prepare
    continues: Prepare | None = None


class RegistrationError(ValueError):
    """A model that cannot be registered; the message says what is missing."""


def register(model: Model) -> None:
    """Add a model.

    Raises
    ------
    RegistrationError
        a name that is taken, or a declaration that does not fit together or names keys that no study has.
    """
    if model.name in MODELS:
        raise RegistrationError(f"a model {model.name!r} is registered already")
    if not model.version or not model.solvers:
        raise RegistrationError(f"{model.name}: a model declares its version and its solvers")
    for what, keys, known in (
        ("superposes", model.superposes, model.solvers),
        ("benched", model.benched, model.solvers[1:]),
        ("of_any_modulus", model.of_any_modulus, model.superposes),
        ("takes", model.takes, EXTRAS),
        ("takes", {solver for solvers in model.takes.values() for solver in solvers}, model.solvers),
        ("parameters", model.parameters, {**VdmTable.model_fields, **model.own}),
        ("own", model.own, model.parameters),
        ("by_rule", model.by_rule, model.parameters),
        ("tissue", model.tissue, Tissue.model_fields),
    ):
        if unknown := [key for key in keys if key not in known]:
            raise RegistrationError(
                f"{model.name} declares {what} that there are none of: {', '.join(unknown)}"
            )
    for key, parameter in model.own.items():
        if key in VdmTable.model_fields or own_parameters().get(key, parameter) != parameter:
            raise RegistrationError(f"{model.name}: {key} is declared already, as something else")
        if parameter.unit not in DIMENSIONS:
            raise RegistrationError(f"{model.name}: {key} has none of the units {', '.join(DIMENSIONS)}")
    MODELS[model.name] = model


def find(name: str) -> tuple[Model, str]:
    """The model and solver behind "name" or "name:solver". Raises KeyError where there is none."""
    declared, solver = registry.find(name)
    return cast(Model, declared), solver  # `register` takes nothing else
