"""The models. A scene goes in; a model's answers to its load steps come out."""

from ..scene.result import REFUSED
from ..study.registry import Model, Parameter, all_models, find, model_names, reads, superposes
from .elements import PLAIN
from .model import Prepared, SetUp, register, run_model

__all__ = [
    "PLAIN",
    "REFUSED",
    "Model",
    "Parameter",
    "Prepared",
    "SetUp",
    "all_models",
    "find",
    "model_names",
    "reads",
    "register",
    "run_model",
    "superposes",
]
