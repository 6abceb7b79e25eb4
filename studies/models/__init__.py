"""The models: who answers. A scene goes in, what a model answers to load steps comes out."""

from ..scene.result import REFUSED
from ..study.registry import (
    Parameter,
    all_models,
    model_names,
    reads,
    superposes,
)
from .elements import PLAIN
from .model import Model, Prepared, RegistrationError, SetUp, find, register, run_model

__all__ = [
    "PLAIN",
    "REFUSED",
    "Model",
    "Parameter",
    "Prepared",
    "RegistrationError",
    "SetUp",
    "all_models",
    "find",
    "model_names",
    "reads",
    "register",
    "run_model",
    "superposes",
]
