"""Modules that are found by their names, so that adding one needs no edit of another."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType


def load_all(package: str, prefix: str) -> list[ModuleType]:
    """Import the modules of a package whose names begin with `prefix`, in the order of their names."""
    names = sorted(found.name for found in iter_modules(import_module(package).__path__))
    return [import_module(f"{package}.{name}") for name in names if name.startswith(prefix)]
