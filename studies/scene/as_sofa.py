"""A scene for SOFA: linear tetrahedra that turn with the body (corotational), as a Python scene beside mesh.msh."""

from __future__ import annotations

import numpy as np

from solver_common.arrays import Array, Index

from .handout import Handout, remarks

NAME = "SOFA (Python scene)"
TAKES = frozenset({"dead forces"})  # of the extras of a study what it writes
_HEAD = (
    "For SOFA 24.06 or newer: runSofa scene_sofa.py. Its law is linear in a frame that turns with a tetrahedron.",
    "The weight is in the forces. Moved supports go to their place in the first step, of 1 s.",
)
_TEMPLATE = '''"""{head}
"""

from pathlib import Path

MESH = Path(__file__).with_name("mesh.msh")
HELD = {held}
FORCES = {{  # point: force [N]
{forces}
}}
MOVES = [  # points, and where they go [m]
{moves}
]


def createScene(root):
    root.addObject("RequiredPlugin", pluginName="Sofa.Component")
    root.addObject("DefaultAnimationLoop")
    root.gravity = [0.0, 0.0, 0.0]
    root.dt = 1.0
    body = root.addChild("body")
    body.addObject("MeshGmshLoader", name="loader", filename=str(MESH))
    body.addObject("NewtonRaphsonSolver", name="newton", maxNbIterationsNewton=50)
    body.addObject("SparseLDLSolver", name="linear", template="CompressedRowSparseMatrixMat3x3d")
    body.addObject("StaticSolver", newtonSolver="@newton", linearSolver="@linear")
    body.addObject("TetrahedronSetTopologyContainer", name="topology", src="@loader")
    body.addObject("MechanicalObject", name="points", template="Vec3d", src="@loader")
    body.addObject(
        "TetrahedronFEMForceField", method="large", youngModulus={young!r}, poissonRatio={poisson!r}
    )
    body.addObject("FixedProjectiveConstraint", indices=HELD)
    for points, way in MOVES:
        body.addObject(
            "LinearMovementProjectiveConstraint",
            indices=points,
            keyTimes=[0.0, 1.0, 1e9],
            movements=[[0.0, 0.0, 0.0], way, way],
        )
    if FORCES:
        body.addObject("ConstantForceField", indices=list(FORCES), forces=list(FORCES.values()))
    return root
'''


def sofa(body: Handout) -> str:
    """The scene as the text of a Python module."""
    force = np.where(body.held[:, None], 0.0, body.whole_force)
    told = "\n".join((*remarks(body), *_HEAD)).replace("\\", "/").replace('"', "'")
    return _TEMPLATE.format(
        head=told,
        held=np.flatnonzero(body.held & ~body.moved).tolist(),
        forces="\n".join(
            f"    {k}: {force[k].tolist()}," for k in np.flatnonzero(force.any(axis=1)).tolist()
        ),
        moves="\n".join(f"    ({points.tolist()}, {way.tolist()})," for points, way in _moves(body)),
        young=body.tissue.youngs_modulus,
        poisson=body.tissue.poisson_ratio,
    )


def _moves(body: Handout) -> list[tuple[Index, Array]]:
    """The moved points by where they go."""
    points = np.flatnonzero(body.moved)
    ways, which = np.unique(body.displacement[points], axis=0, return_inverse=True)
    return [(points[which.ravel() == k], way) for k, way in enumerate(ways)]
