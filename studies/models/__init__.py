"""The models: who answers. A scene goes in, what a model answers to load steps comes out."""

from ..study.registry import (
    MODELS,
    Cost,
    Model,
    Parameter,
    RegistrationError,
    SetUp,
    all_models,
    benched_names,
    find,
    model_names,
    reads,
    register,
    superposes,
)
from .elements import PLAIN
from .prepared import REFUSED, Prepared, run_model
from .surface import VDM_SOLVERS

__all__ = [
    "MODELS",
    "PLAIN",
    "REFUSED",
    "VDM_SOLVERS",
    "Cost",
    "Model",
    "Parameter",
    "Prepared",
    "RegistrationError",
    "SetUp",
    "all_models",
    "benched_names",
    "find",
    "model_names",
    "reads",
    "register",
    "run_model",
    "superposes",
]
