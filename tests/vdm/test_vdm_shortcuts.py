"""What a model does not do twice: factors of a history or of a changing border; and a weight it does not have."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.vdm.vdm_shapes import BASE, POINTS, TRIANGLES, model
from vdm import FORMULATIONS, Load, Model, Parameters, SurfaceMesh

FINGER = Load(np.where(POINTS[:, 2] > 0.035, 20.0, 0.0))
NAMES = list(FORMULATIONS)


@pytest.mark.parametrize("solver", ["linear", "quasi-linear", "nonlinear"])
@pytest.mark.parametrize("formulation", NAMES)
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


def test_a_rule_for_the_parameters_is_a_part_of_the_set_up():
    seen: list[SurfaceMesh] = []

    def rule(surface: SurfaceMesh) -> Parameters:
        seen.append(surface)
        time.sleep(0.05)
        return Parameters.from_tissue(5e3, surface, "vector", held=BASE)

    ruled = Model(POINTS, TRIANGLES, rule, formulation="vector", fixed=BASE)
    assert len(seen) == 1
    assert seen[0] is ruled.surface, "the surface is not checked twice"
    plain = Model(POINTS, TRIANGLES, rule(ruled.surface), formulation="vector", fixed=BASE)
    first, second = (body.solve([FINGER]) for body in (ruled, plain))
    assert first.seconds_setup > 0.05
    assert np.array_equal(first.displacement, second.displacement)
