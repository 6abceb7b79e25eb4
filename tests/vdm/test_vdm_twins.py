"""A body that lies otherwise in space, or whose nodes are numbered otherwise, has the same answer."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.vdm.vdm_shapes import icosphere
from vdm import FORMULATIONS, Load, Model, Parameters, SurfaceMesh

RANDOM = np.random.default_rng(5)
REGULAR, TRIANGLES = icosphere(2, (0.06, 0.045, 0.03))
POINTS = REGULAR + 2e-3 * RANDOM.standard_normal(REGULAR.shape)
BASE, TIP = POINTS[:, 2] < -0.02, POINTS[:, 0] > 0.05
# a sixth of the stiffness: second-order terms are some percent
PUSH = np.where((POINTS[:, 2] > 0.015) & ~TIP, 300.0, 0.0)
PULL = np.where(TIP[:, None], [1e-3, 2e-3, 0.0], 0.0)
ALL = np.arange(len(POINTS))
STILL = np.eye(3)
TURN = np.linalg.qr(RANDOM.standard_normal((3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))
MIRROR = np.diag([1.0, -1.0, 1.0])
# where the nodes go to, the order in which they come, and that the facets turn inside out
TWIN = (TURN @ MIRROR, RANDOM.permutation(len(POINTS)), True)


def answer(
    formulation: str, solver: str, motion: np.ndarray = STILL, order: np.ndarray = ALL, flip: bool = False
) -> tuple[np.ndarray, np.ndarray, float]:
    """Displacement and reaction (N, 3) [m, N] and pressure [Pa], taken back to how the body was."""
    place = np.argsort(order)
    triangles = place[TRIANGLES[:, ::-1] if flip else TRIANGLES]
    points = POINTS[order] @ motion.T
    held = (BASE | TIP)[order]
    rule = Parameters.from_tissue(5000.0, SurfaceMesh(points, triangles), formulation, "global", held)
    model = Model(
        points,
        triangles,
        rule,
        formulation=formulation,
        fixed=BASE[order],
        constrained=TIP[order],
        density=1060.0,
        gravity=motion @ [0.0, 1.0, -3.0],
        solver=solver,
    )
    solution = model.solve([Load(PUSH[order], prescribed=PULL[order] @ motion.T)])
    assert solution.status[0].ok, solution.status[0].message
    fields = (solution.displacement[0], solution.reaction_force[0])
    displacement, reaction = (values[place] @ motion for values in fields)
    return displacement, reaction, float(solution.fluid_pressure[0])


@pytest.mark.parametrize(
    ("formulation", "solver"),
    [(name, "linear") for name in FORMULATIONS] + [(name, "nonlinear") for name in ("vector", "mass-spring")],
)
def test_the_answer_does_not_depend_on_how_the_body_lies(formulation: str, solver: str) -> None:
    """Nor on the order of its nodes, nor on left and right."""
    plain, other = answer(formulation, solver), answer(formulation, solver, *TWIN)
    # a nonlinear balance is found to 1e-8 of its forces, an answer to that times its condition
    # quadrature over the slender facets at a rim depends by 4e-8 on which corner of a facet comes first
    by_facet = 1e-6 if formulation in ("bem", "bem-sparse") else 1e-9
    tolerance = by_facet if solver == "linear" else 2e-6
    for a, b in zip(other, plain, strict=True):
        assert_allclose(a, b, rtol=0, atol=tolerance * np.abs(b).max())
