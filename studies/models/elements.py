"""The volumetric models: registers the finite elements of `fem_reference`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_reference.costs import superlu_bytes
from solver_common.arrays import Array, Index

from ..scene.inclusions import moduli
from ..scene.scene import Scene, SurfaceLoad
from ..study.registry import SCANNED, Family, Model, Size, split
from ..study.schema import LAW_KEYS, LAWS, NEO_HOOKEAN
from .model import SetUp, register
from .scanned import UNSTABLE, from_scan, no_rest_shape, rest_shape

if TYPE_CHECKING:
    from fem_reference.finite_strain import FiniteStrainProblem
    from fem_reference.linear import LinearProblem
    from fem_reference.loads import Load as FemLoad
    from fem_reference.mesh import TetMesh
    from fem_reference.newton import LoadPath
    from fem_reference.springs import ElasticSupport
    from solver_common.solution import Solution

Answer = Callable[[Sequence[SurfaceLoad]], "Solution"]

# scikit-fem's own assembly and a general LU factor: tests compare the fast path with it
PLAIN = "plain"
_ELEMENTS = {"fem-linear": "P2-P1", "fem-p1": "P1", "fem-p2": "P2"}
_LARGEST = ("max_det_f_deviation", "max_principal_strain", "p95_principal_strain")


def _small_strain(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:
    """Linear elements: one factorisation; the fast path solves independent loads as one batch."""
    if solver == PLAIN:
        from fem_reference.plain_linear import PlainLinearProblem

        plain = PlainLinearProblem(**_body(scene))
        return SetUp(lambda loads: plain.solve(fem_loads(loads, plain.body.checked)))
    from fem_reference.linear import LinearProblem

    touched = len(_touched(scene)) if scene.indenter else 0  # contact needs one solve for each
    problem = LinearProblem(
        **_body(scene), element=_ELEMENTS[split(name)[0]], expected_loads=n_loads + touched
    )
    if scene.indenter:
        return SetUp(_indented(scene, problem))
    return SetUp(lambda loads: problem.solve(fem_loads(loads, problem.mesh), _asked(scene)), problem)


def _condensed(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:  # noqa: ARG001
    """Linear elements, condensed to the contact nodes and to one motion of the held nodes."""
    from fem_reference.condensed import CondensedProblem
    from fem_reference.linear import LinearProblem

    body = _body(scene)
    if not scene.gravity.any():
        body["density"] = 0.0  # else the weight, which does not act, gets columns of its own
    # one motion of the held nodes, scaled by its largest component
    largest = scene.prescribed.flat[np.abs(scene.prescribed).argmax()]
    motions = scene.prescribed[None] / largest if largest else np.zeros((0, *scene.prescribed.shape))
    n_columns = 12 * int(scene.contact.sum())  # three components at the vertices and three edge middles each
    whole = LinearProblem(**body, expected_loads=n_columns + len(motions))
    problem = CondensedProblem(whole, scene.contact, motions=motions)
    return SetUp(lambda loads: problem.solve(fem_loads(loads, whole.mesh), _asked(scene)), problem)


def _finite_strain(
    scene: Scene,
    solver: str,
    name: str,  # noqa: ARG001
    n_loads: int,
    path: LoadPath | None = None,
) -> SetUp:
    """Hyperelastic elements; with a `path` each answer continues from the last one."""
    if solver == PLAIN:
        from fem_reference.plain_finite_strain import PlainFiniteStrainProblem

        plain = PlainFiniteStrainProblem(**_body(scene), **_material(scene))
        return SetUp(lambda loads: plain.solve(fem_loads(loads, plain.body.checked), frozenset(_LARGEST)))
    from fem_reference.finite_strain import FiniteStrainProblem

    if SCANNED in scene.extras:
        return _scanned(scene, n_loads, path)
    problem = FiniteStrainProblem(**hyperelastic(scene, n_loads))
    return SetUp(_at_finite_strain(scene, problem, problem.mesh, path))


def _at_finite_strain(
    scene: Scene, problem: FiniteStrainProblem, mesh: TetMesh, path: LoadPath | None
) -> Answer:
    """Answers of a problem at finite strain; `mesh` has the surface on which loads act."""
    if scene.indenter:
        return _indented_far(scene, problem, mesh)
    return lambda loads: problem.solve(fem_loads(loads, mesh), _asked(scene, *_LARGEST), path)


def _scanned(scene: Scene, n_loads: int, path: LoadPath | None) -> SetUp:
    """For a body scanned under its weight: find the rest shape, then measure displacements from the scanned one."""
    from fem_reference.finite_strain import FiniteStrainProblem
    from solver_common.jit import clock

    start, given = clock(), hyperelastic(scene, n_loads)
    problem = FiniteStrainProblem(**given)
    scanned, near = problem.mesh, None

    def sag(points: Array) -> Array:
        nonlocal problem, near
        if points is not scanned.points:
            problem = FiniteStrainProblem(**given | {"points": points})
        near = problem.sag(scene.gravity, near)
        return near.displacement[0][: len(points)]

    _, sagged = rest_shape(scanned.points, sag)
    assert near is not None
    if not problem.is_stable(scene.gravity, near):
        raise no_rest_shape(UNSTABLE)
    seconds = clock() - start
    answer = _at_finite_strain(scene, problem, scanned, path)
    return SetUp(lambda loads: from_scan(answer(loads), loads, sagged[scene.mesh.surface_nodes], seconds))


def _finite_strain_onward(scene: Scene, solver: str, name: str, n_loads: int) -> SetUp:
    from fem_reference.newton import LoadPath

    return _finite_strain(scene, solver, name, n_loads, LoadPath())


def _touched(scene: Scene) -> Index:
    """Surface nodes that an indenter can touch."""
    assert scene.indenter is not None
    return np.unique(scene.mesh.triangles[scene.indenter.facets])


def _indented(scene: Scene, problem: LinearProblem) -> Answer:
    """Unilateral contact of a linear body with a rigid indenter."""
    from fem_reference.contact import ContactProblem

    assert scene.indenter is not None
    region = np.zeros(len(scene.fixed), dtype=bool)
    region[_touched(scene)] = True
    contact = ContactProblem(problem, scene.indenter.indenter, region)

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        found = contact.solve([load.depth for load in loads], fem_loads(loads, problem.mesh))
        return _contact(found.solution, found.force, found.contact_area, status=found.status)

    return solve


def _indented_far(scene: Scene, problem: FiniteStrainProblem, mesh: TetMesh) -> Answer:
    """Unilateral contact at finite strain; each step starts from the one before it."""
    placed = scene.indenter
    assert placed is not None

    def solve(loads: Sequence[SurfaceLoad]) -> Solution:
        depths, given = [load.depth for load in loads], fem_loads(loads, mesh)
        found = problem.indent(placed.indenter, placed.facets, depths, given, frozenset(_LARGEST))
        return _contact(found.solution, found.force @ placed.indenter.axis, found.contact_area)

    return solve


def _contact(solution: Solution, force: Array, area: Array, **changed: Any) -> Solution:
    """A solution with the (S,) force along the push [N] and the (S,) area under pressure [m^2] of each step."""
    scalars = {**solution.scalars, "indenter_force": force, "contact_area": area}
    return dataclasses.replace(solution, scalars=scalars, **changed)


def hyperelastic(scene: Scene, n_loads: int) -> dict[str, Any]:
    return {**_body(scene), **_material(scene), "expected_loads": n_loads}


def _material(scene: Scene) -> dict[str, Any]:
    """The hyperelastic law and its parameters."""
    if scene.anisotropy:
        return {"material": "transversely-isotropic"}
    law = scene.tissue.law or NEO_HOOKEAN
    return {"material": law, "material_parameters": {key: getattr(scene.tissue, key) for key in LAWS[law]}}


def _body(scene: Scene) -> dict[str, Any]:
    """The arguments that every volumetric model takes."""
    mesh, tissue, fibres = scene.mesh, scene.tissue, scene.anisotropy
    return {
        "points": mesh.points,
        "tetrahedra": mesh.tetrahedra,
        "surface_nodes": mesh.surface_nodes,
        "triangles": mesh.triangles,
        "youngs_modulus": tissue.youngs_modulus,
        "poisson_ratio": tissue.poisson_ratio,
        "density": tissue.density,
        "held": scene.held,
        "elastic_supports": _springs(scene),
        **_inside(scene),
        **_filled(scene),
        **({"fibre_direction": fibres.fibre_direction, "contrast": fibres.contrast} if fibres else {}),
    }


def _inside(scene: Scene) -> dict[str, Any]:
    """The moduli of each tetrahedron, if the scene has inclusions."""
    if not scene.inclusions:
        return {}
    young, ratio, parts = moduli(scene.tissue, scene.inclusions)
    return {"youngs_modulus": young, "poisson_ratio": ratio, "parts": parts}


def _filled(scene: Scene) -> dict[str, Any]:
    """The walls of the fluid-filled cavities, if the scene has any."""
    if FLUID not in scene.extras:
        return {}
    shells = scene.mesh.shells
    return {"cavities": shells[:, None] == 1 + np.arange(shells.max())}


def _springs(scene: Scene) -> list[ElasticSupport]:
    from fem_reference.springs import ElasticSupport

    return [ElasticSupport(part.facets, part.stiffness, part.direction) for part in scene.springs]


def fem_loads(loads: Sequence[SurfaceLoad], mesh: TetMesh) -> list[FemLoad]:
    """Loads of a scene as loads of `fem_reference`; forces on lines and regions become nodal forces of `mesh`."""
    from fem_reference.forces import line_forces, region_forces
    from fem_reference.loads import Load

    def spread(parts: Index, force: Array) -> Array:
        if parts.shape[1] == 2:
            return line_forces(mesh, parts, force)
        powers = len(mesh.surface_nodes) ** np.arange(3)
        return region_forces(mesh, np.isin(mesh.triangles @ powers, parts @ powers), force)

    def dead(load: SurfaceLoad) -> Array | None:
        forces = [spread(parts, force) for parts, force in load.dead]
        return np.sum(forces, axis=0) if forces else None

    return [Load(load.facet_pressure, load.prescribed, load.gravity, dead(load)) for load in loads]


def _asked(scene: Scene, *outputs: str) -> frozenset[str]:
    """The further outputs that a volumetric model is asked for."""
    return frozenset({*outputs, "condition_estimate"} if scene.condition else outputs)


_BOTH, _ONE = ("linear", PLAIN), ("linear",)
DEAD, FLUID = "dead forces", "fluid in cavities"  # names in `vdmbench.study.registry.EXTRAS`


def _takes(solvers: tuple[str, ...], *more: str) -> dict[str, tuple[str, ...]]:
    """Scene features -> solvers that take them: those that all elements take, and `more`."""
    every = ("normal springs", "full springs", "inclusions", "cavities", "fibres")
    return dict.fromkeys((*every, *more), solvers)


# Peak memory of a process [bytes]: of multigrid, which solves where a factor has no room, and of an LU factor on
# the plain path. Measured on balls and slabs of 1,000 to 34,000 tetrahedra, within a quarter.


def _plain(size: Size) -> float:
    return superlu_bytes(4.7 * size.tetrahedra) + 6e4 * size.tetrahedra


def _quadratic(size: Size, solver: str) -> float:
    return _plain(size) if solver == "plain" else 1.2e4 * size.tetrahedra


def _finite(size: Size, solver: str) -> float:
    return _plain(size) if solver == "plain" else 5e7 + 3.3e4 * size.tetrahedra


_elements = partial(
    Model,
    family=Family.ELEMENTS,
    volumetric=True,
    solvers=("linear",),
    superposes=("linear",),
    tissue=("youngs_modulus", "poisson_ratio"),
    parameters=(),
    memory=_quadratic,
    takes=_takes(_ONE),
)
for _model in (
    _elements(
        name="fem-linear",
        version="3",
        prepare=_small_strain,
        takes=_takes(_BOTH, DEAD) | {"indenter": _ONE, FLUID: _ONE},
        solvers=_BOTH,
        superposes=_BOTH,
    ),
    _elements(
        name="fem-p1",
        version="2",
        prepare=_small_strain,
        memory=lambda size, _: 1.8e3 * size.tetrahedra,
        takes=_takes(_ONE, DEAD, "indenter", FLUID),
    ),
    _elements(
        name="fem-p2",
        version="2",
        prepare=_small_strain,
        takes=_takes(_ONE, DEAD, "indenter", FLUID),
    ),
    _elements(
        name="fem-condensed",
        version="4",
        prepare=_condensed,
        memory=lambda size, _: 9.4e4 * size.tetrahedra,
        contact_in_setup=True,
    ),
    _elements(
        name="fem",
        version="14",
        prepare=_finite_strain,
        memory=_finite,
        takes=_takes(_BOTH, DEAD) | {"law": _ONE, "indenter": _ONE, SCANNED: _ONE, FLUID: _ONE},
        tissue=("youngs_modulus", "poisson_ratio", "law", *LAW_KEYS),
        solvers=_BOTH,
        superposes=(),
        continues=_finite_strain_onward,
    ),
):
    register(_model)
