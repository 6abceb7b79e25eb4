"""What a model does not do twice: factors of a history or of a changing border."""

from __future__ import annotations

import numpy as np
import pytest

from tests.vdm.vdm_shapes import BASE, POINTS, model
from vdm import FORMULATIONS, Load

FINGER = Load(np.where(POINTS[:, 2] > 0.035, 20.0, 0.0))


@pytest.mark.parametrize("solver", ["linear", "quasi-linear", "nonlinear"])
@pytest.mark.parametrize("formulation", ["vector", "bem"])
def test_the_block_is_factored_once_for_a_whole_history(formulation, solver, monkeypatch):
    made: list[tuple[str, int]] = []
    original = FORMULATIONS[formulation].factor

    def counted(self, free, *options):
        made.append((type(self).__name__, int(free.sum())))
        return original(self, free, *options)

    monkeypatch.setattr(FORMULATIONS[formulation], "factor", counted)
    body = model(formulation, solver=solver)
    history = body.solve([FINGER.scaled(s) for s in (0.5, 1.0, 0.2)])
    body.solve([FINGER])
    assert [status.code for status in history.status] == ["converged"] * 3
    assert len(set(made)) == len(made)  # the error of the mesh needs a body of its own, once
    assert made[0] == (FORMULATIONS[formulation].__name__, np.count_nonzero(~BASE))
