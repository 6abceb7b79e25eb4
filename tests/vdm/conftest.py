"""The integrals over a body's facets, which many tests of this folder ask for, are made once for each body."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from vdm.boundary import operators
from vdm.boundary.operators import Facets, Operators, assembled

KNOWN: dict[tuple[object, ...], Operators] = {}
MOST = 6  # bodies that are kept, the last that were asked for: 25 MB each


@pytest.fixture(autouse=True)
def _assembled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operators, "assembled", known)


def known(facets: Facets, nu: float, dtype: type[np.floating[Any]] = np.float64) -> Operators:
    """See `assembled`, which the tests of the operators themselves call."""
    key = (*(part.tobytes() for part in (facets.points, facets.triangles, facets.numbers)), nu, dtype)
    found = KNOWN[key] = KNOWN.pop(key, None) or assembled(facets, nu, dtype)
    if len(KNOWN) > MOST:
        del KNOWN[next(iter(KNOWN))]
    # copies: what is made of them is made in place
    return Operators(**{field.name: getattr(found, field.name).copy() for field in dataclasses.fields(found)})
