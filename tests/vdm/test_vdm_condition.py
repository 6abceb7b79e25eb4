"""Condition estimates against numpy's condition number, and the factor in single precision."""

from __future__ import annotations

import numpy as np
import pytest

from solver_common.condition import estimated_norm, operator
from tests.vdm.vdm_shapes import WITH_MATRIX, model
from vdm import Model


def dense_operator(body: Model) -> tuple[np.ndarray, np.ndarray]:
    """Block and whole matrix of the free nodes, scaled as `condition_of_operator` says, by inverses in numpy."""
    form = body.formulation
    m, inside = form.columns.count, np.repeat(body.problem.free, form.components)
    block = form.stiffness().toarray()[np.ix_(inside, inside)]
    unit = 1.0 / np.sqrt(np.diag(block))
    block = block * np.outer(unit, unit)
    inverse, corner = np.linalg.inv(block), np.abs(np.diag(form.corner))
    columns, rows = (
        unit[:, None] * part.dense().reshape(-1, m)[inside] for part in (form.columns, form.rows)
    )
    of_column, of_row = (
        1.0 / np.sqrt(np.maximum(np.diag(b.T @ inverse @ b), corner)) for b in (columns, rows)
    )
    below = [(rows * of_row).T, form.corner * np.outer(of_row, of_column)]
    return block, np.block([[block, -columns * of_column], below])


def dense_state(body: Model, penalty: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Block and whole of the printed matrix, held nodes left out or given a diagonal of alpha."""
    form, held = body.formulation, np.repeat(~body.problem.free, body.formulation.components)
    m = form.columns.count
    held = np.append(held, np.zeros(m, dtype=bool))
    whole = form.state_matrix().toarray()
    if penalty is None:
        whole = whole[np.ix_(~held, ~held)]
    else:
        whole[held, held] = penalty * np.abs(np.diag(whole)).max()
    return whole[:-m, :-m], whole


def check(estimate: float, matrix: np.ndarray) -> None:
    truth = np.linalg.cond(matrix, 1)
    # a lower bound to rounding, which the inverses in both lose in proportion to the condition
    assert truth / 3.0 <= estimate <= truth * (1.0 + 1e-13 * truth), (estimate, truth)


@pytest.mark.parametrize("solver", ["linear", "lu", "bicg"])
@pytest.mark.parametrize("formulation", WITH_MATRIX)
def test_estimates_bound_the_condition_from_below(formulation, solver):
    body = model(formulation, solver=solver)
    estimate = body.condition_estimate()
    block, whole = dense_state(body, None) if solver != "linear" else dense_operator(body)
    check(estimate.block, block)
    check(estimate.system, whole)
    assert estimate == body.condition_estimate()


@pytest.mark.parametrize("penalty", [1e2, 1e5])
def test_a_penalty_is_in_the_estimate(penalty):
    body = model("consistent", solver="lu", constraint_method="penalty-replaced", penalty=penalty)
    block, whole = dense_state(body, penalty)
    check(body.condition_estimate().block, block)
    check(body.condition_estimate().system, whole)
    # alpha over the smallest pivot: the block's condition grows as the penalty
    assert body.condition_estimate().block > penalty


def test_the_walk_alone_would_miss_this_matrix():
    """Higham's example: from the middle of the simplex every column of the inverse looks alike."""
    n = 20
    inverse = np.eye(n) + 50.0 * np.outer(*(2 * [np.array([1.0, -1.0] + (n - 2) * [0.0])]))
    matrix = np.linalg.inv(inverse)

    def solve(b):
        return np.linalg.solve(matrix, b)

    assert estimated_norm(operator(n, solve, solve)) >= np.linalg.norm(inverse, 1) / 3.0
