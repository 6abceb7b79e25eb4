"""Bodies for tests, by their keys, and the models that tests of what acts on a body go through."""

from collections.abc import Mapping
from typing import Any

import pytest

from vdmbench.models import all_models
from vdmbench.study.shapes import Geometry


def shaped(shape: str, mesh_size: float, keys: Mapping[str, Any]) -> Geometry:
    """The [geometry] of these keys; a mesh size of 0 is left out."""
    size = {"mesh_size": mesh_size} if mesh_size else {}
    return Geometry.model_validate({"shape": shape, **size, **keys})


def telling_names() -> list[str]:
    """Every model by its first solver, and one model by each solver that comes to its load on a way of its own.

    Others have operator and load from these; `tests/vdm/test_vdm_solvers.py` holds them together.
    """
    of_vector = [f"vdm-vector:{solver}" for solver in ("quasi-linear", "nonlinear", "bicg")]
    others = ["fem-linear:plain", "fem:plain", "vdm-paper:incremental", "vdm-paper:figure-8", "bem:nonlinear"]
    return [*all_models(), *of_vector, *others]


def telling_params() -> list[Any]:
    """The same as parameters of tests that solve with each: scikit-fem's own forms take as long as all others."""
    slow = {"fem:plain": pytest.param("fem:plain", marks=pytest.mark.slow)}
    return [slow.get(name, name) for name in telling_names()]
