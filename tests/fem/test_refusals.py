"""What means nothing is refused before anything is solved: one sentence each, and what to do."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from fem_reference.condensed import CondensedProblem
from fem_reference.contact import ContactProblem
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.forces import line_forces, region_forces, traction_forces
from fem_reference.indenter import Capsule, FlatPunch, Indenter, Sphere
from fem_reference.linear import LinearProblem
from fem_reference.loads import held_nodes
from fem_reference.materials import make_law
from fem_reference.mesh import TetMesh
from fem_reference.plain_finite_strain import PlainFiniteStrainProblem
from fem_reference.plain_linear import PlainLinearProblem
from fem_reference.solution import SolverError
from fem_reference.springs import ElasticSupport
from tests.fem.shapes import body, cube

Refused = tuple[str, Callable[[], object]]
CUBE, DOWN, ORIGIN, TIP = cube(1), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (0.5, 0.5, 1.0)
ABOVE = CUBE.surface[:, 2] == 1.0


def meshes() -> Iterator[Refused]:
    corners = CUBE.tetrahedra[0, :3]
    with_flat = {
        "points": np.vstack([CUBE.points, CUBE.points[corners].mean(axis=0)]),
        "tetrahedra": np.vstack([CUBE.tetrahedra, [[*corners, len(CUBE.points)]]]),
    }
    turned = np.where(np.arange(6)[:, None] == 2, CUBE.tetrahedra[:, [1, 0, 2, 3]], CUBE.tetrahedra)
    infinite = CUBE.points.copy()
    infinite[3, 1] = np.inf
    for words, change in (
        ("1 of 7 tetrahedra have no volume .the first is number 6", with_flat),
        ("1 of 6 tetrahedra are inverted .the first is number 2", {"tetrahedra": turned}),
        ("the triangles leave a hole", {"triangles": CUBE.triangles[1:]}),
        ("the triangles enclose -1", {"triangles": CUBE.triangles[:, ::-1]}),
        ("1 of 9 points belong to no tetrahedron", {"points": np.vstack([CUBE.points, [[2.0, 2.0, 2.0]]])}),
        ("not finite", {"points": infinite}),
        ("tetrahedra has an index outside 0..7", {"tetrahedra": CUBE.tetrahedra + 1}),
        (r"tetrahedra has shape \(0, 4\)", {"tetrahedra": CUBE.tetrahedra[:0]}),
    ):
        yield words, lambda change=change: TetMesh(*replace(CUBE, **change).arrays)
    # the surface of the mirrored cube: the same vertices and volume, but other diagonals
    mirror = np.argmin(
        np.linalg.norm(CUBE.points[:, None] * [-1, 1, 1] + [1, 0, 0] - CUBE.points, axis=2), axis=1
    )
    other = replace(CUBE, triangles=mirror[CUBE.triangles][:, ::-1])
    yield "an edge that no tetrahedron has", lambda: TetMesh(*other.arrays)


def supports() -> Iterator[Refused]:
    b = cube(2)
    x, mesh = b.surface, TetMesh(*b.arrays)
    for words, held in (
        ("nothing is held", np.zeros(len(x), dtype=bool)),
        ("can still move or turn", (x == 0.0).all(axis=1)),
        ("can still move or turn", (x[:, :2] == 0.0).all(axis=1)),
        ("can still move", np.column_stack([x[:, 0] == 0.0, np.zeros((len(x), 2), dtype=bool)])),
        ("held has shape", np.ones(len(x) - 1, dtype=bool)),
    ):
        yield words, lambda held=held: held_nodes(mesh, held)
    two = body(
        np.vstack([CUBE.points, CUBE.points + np.array([3.0, 0.0, 0.0])]),
        np.vstack([CUBE.tetrahedra, CUBE.tetrahedra + len(CUBE.points)]),
    )
    both = TetMesh(*two.arrays)
    held_nodes(both, two.bottom)
    yield "body 1 of 2 can still move", lambda: held_nodes(both, two.bottom & (two.surface[:, 0] < 2.0))
    bottom = CUBE.facets_where(lambda x: x[:, 2] == 0.0)
    for words, facets, constant, *direction in (
        (r"give a mask of shape \(12,\)", bottom[1:], 1.0),
        ("array of int64", bottom * 1, 1.0),
        ("an elastic support has no facet", bottom & False, 1.0),
        ("a spring constant is 0.0; give a positive", bottom, 0.0),
        ("a spring constant is nan", bottom, np.nan),
        ("'sideways' is unknown; use one of normal, full", bottom, 1.0, "sideways"),
    ):
        bed = [ElasticSupport(facets, constant, *direction)]
        yield words, lambda bed=bed: CUBE.problem(CUBE.bottom, elastic_supports=bed)
    sliding = [ElasticSupport(bottom, 1.0)]
    yield "too little is held", lambda: CUBE.problem(CUBE.bottom & False, elastic_supports=sliding)


def settings() -> Iterator[Refused]:
    """Moduli, elements and solvers, at small strain and at finite strain."""
    each = np.ones(len(CUBE.tetrahedra))
    bad = np.where(np.arange(len(each)) == 2, -1.0, each)
    fibres = {"fibre_direction": (1, 0, 0), "contrast": 2.0}
    for words, change in (
        ("youngs_modulus is 0.0; give a positive", {"youngs_modulus": 0.0}),
        ("youngs_modulus is nan", {"youngs_modulus": np.nan}),
        (r"poisson_ratio is -1.0; give a number in \(-1, 0.5\]", {"poisson_ratio": -1.0}),
        ("poisson_ratio is 0.5000001", {"poisson_ratio": 0.5000001}),
        ("poisson_ratio is nan", {"poisson_ratio": np.nan}),
        ("a displacement element cannot be incompressible", {"poisson_ratio": 0.5, "element": "P2"}),
        ("element 'P3' is unknown; use one of P2-P1, P2, P1", {"element": "P3"}),
        ("solver 'magic' is unknown", {"solver": "magic"}),
        ("MB are available", {"memory_limit": 10.0}),
        (r"youngs_modulus has shape \(5,\); give one number or one for", {"youngs_modulus": each[1:]}),
        ("youngs_modulus is -1.0 in tetrahedron 2; give a positive", {"youngs_modulus": bad}),
        ("poisson_ratio is -0.3 in tetrahedron 2; where it varies", {"poisson_ratio": 0.3 * bad}),
        ("nor take a poisson_ratio that varies", {"poisson_ratio": 0.3 * each, "element": "P2"}),
        ("has one poisson_ratio", {"poisson_ratio": 0.3 * each, **fibres}),
        ("parts is an array of float64", {"parts": each}),
        ("give a whole number for each of 6 tetrahedra", {"parts": [0, 1]}),
    ):
        yield words, lambda change=change: CUBE.problem(CUBE.bottom, **change)
    for words, change in (
        ("pressure 'wind' is unknown; use one of follower, dead", {"pressure": "wind"}),
        ("max_newton is 0; give 1 or more", {"max_newton": 0}),
        ("tolerance is 0.0; give a number between 0 and 1", {"tolerance": 0.0}),
        ("tolerance is nan", {"tolerance": np.nan}),
        ("solver 'magic' is unknown; use one of auto, direct, iterative", {"solver": "magic"}),
        ("material 'rubber' is unknown", {"material": "rubber"}),
        ("the direct solver needs about", {"solver": "direct", "memory_limit": 1e3}),
        ("the iterative solver needs about", {"solver": "iterative", "memory_limit": 1e3}),
    ):
        yield words, lambda change=change: CUBE.finite(CUBE.bottom, **change)


def problems() -> Iterator[Refused]:
    """What every kind of problem refuses alike."""
    all_over = np.ones(len(CUBE.surface), dtype=bool)
    good, turned = CUBE.load(1.0), CUBE.tetrahedra[:, [1, 0, 2, 3]]
    given = {"youngs_modulus": 1.0, "poisson_ratio": 0.3, "held": CUBE.bottom}
    for kind in (LinearProblem, FiniteStrainProblem, PlainLinearProblem, PlainFiniteStrainProblem):
        for words, change in (
            ("move freely", {"held": ~all_over}),
            ("held is an array of float64, not of true", {"held": np.full(len(all_over), np.nan)}),
            ("held over its whole surface", {"held": all_over, "poisson_ratio": 0.5}),
            ("poisson_ratio is 0.6", {"poisson_ratio": 0.6}),
            ("density is -1.0", {"density": -1.0}),
            ("inverted", {"tetrahedra": turned}),
        ):
            mesh = dict(zip(("points", "tetrahedra", "surface_nodes", "triangles"), CUBE.arrays, strict=True))
            yield words, lambda kind=kind, options=mesh | given | change: kind(**options)
        solve = kind(*CUBE.arrays, **given).solve
        told = "facet_pressure of load step 2 has values that are not finite"
        yield told, lambda solve=solve: solve([good, CUBE.load(np.nan)])
        yield "there is no load step", lambda solve=solve: solve([])
        yield "output 'colour' is unknown", lambda solve=solve: solve([good], frozenset({"colour"}))


def materials() -> Iterator[Refused]:
    isotropic, fibres = (None, 1.0), ((1.0, -2.0, 0.5), 2.0)
    yeoh = {"second_ratio": 0.7, "third_ratio": 0.4}
    for words, name, (direction, contrast), *shape in (
        ("material 'rubber' is unknown; use one of neo-hookean", "rubber", isotropic),
        ("a neo-hookean body has no fibres", "neo-hookean", fibres),
        ("a yeoh body has no fibres", "yeoh", (None, 2.0), yeoh),
        ("a yeoh body has no parameter 'exponent'; give", "yeoh", isotropic, {"exponent": 1.0}),
        ("has no parameter 'exponent'; leave it out", "neo-hookean", isotropic, {"exponent": 1.0}),
        ("there is no third_ratio of a yeoh body", "yeoh", isotropic, {"second_ratio": 1.0}),
        ("is 1.2; give a number from 0 to 1", "mooney-rivlin", isotropic, {"second_share": 1.2}),
        ("give one number", "mooney-rivlin", isotropic, {"second_share": (0.5, 0.5)}),
        ("exponent is 0.0; give a positive number", "fung", isotropic, {"exponent": 0.0}),
        ("exponent is nan; give one number", "fung", isotropic, {"exponent": np.nan}),
        ("give a list of numbers", "ogden", isotropic, {"exponents": 2.0, "shares": (1.0,)}),
        ("other than zero", "ogden", isotropic, {"exponents": (2.0, 0.0), "shares": (0.5, 0.5)}),
        ("sum 1", "ogden", isotropic, {"exponents": (2.0, 1.0), "shares": (0.5, 0.6)}),
        ("not equally many", "ogden", isotropic, {"exponents": (2.0, 1.0), "shares": (1.0,)}),
        ("there is no fibre_direction", "transversely-isotropic", (None, 2.0)),
        (r"fibre_direction \[0.0, 0.0, 0.0\] is no", "transversely-isotropic", ((0.0, 0.0, 0.0), 2.0)),
        (r"fibre_direction \[1.0, 0.0\] is no direction", "transversely-isotropic", ((1.0, 0.0), 2.0)),
        ("is no direction", "transversely-isotropic", ((np.nan, 0.0, 1.0), 2.0)),
        ("contrast is 0.9; give 1 or more", "transversely-isotropic", (fibres[0], 0.9)),
        ("contrast is inf", "transversely-isotropic", (fibres[0], np.inf)),
    ):
        yield words, lambda given=(name, 1.0, 1.0, direction, contrast, *shape): make_law(*given)


def loads() -> Iterator[Refused]:
    """Pressures, forces at nodes and forces given to a region."""
    problem, mesh = CUBE.problem(CUBE.bottom), TetMesh(*CUBE.arrays)
    good = CUBE.load(1.0 * CUBE.top)
    infinite = np.array(good.prescribed)
    infinite[0, 0] = np.inf
    for words, load in (
        ("prescribed of load step 2 has values that are not", replace(good, prescribed=infinite)),
        (r"facet_pressure of load step 2 has values beyond 1e\+100; give a load", CUBE.load(1e300)),
        (r"gravity of load step 2 has shape \(2,\); give shape \(3,\)", replace(good, gravity=np.zeros(2))),
        (
            "facet_pressure of load step 2 has shape",
            replace(good, facet_pressure=good.facet_pressure[:, :1]),
        ),
        (r"forces of load step 2 has shape \(3,\)", replace(good, forces=np.zeros(3))),
    ):
        yield words, lambda load=load: problem.solve([good, load])
    zero = np.zeros((1, mesh.n_nodes, 3))
    bad = zero.copy()
    bad[0, -1, 2] = np.inf
    for words, forces, prescribed in (
        ("prescribed at the nodes has values that are not finite", zero, bad),
        ("forces at the nodes has values that are not finite", bad, zero),
        ("forces at the nodes has shape", zero[:, 1:], zero),
        ("prescribed at the nodes has shape", zero, np.repeat(zero, 2, axis=0)),
        ("forces at the nodes has shape", zero[:0], zero[:0]),
    ):
        yield words, lambda f=forces, u=prescribed: problem.solve_nodal(f, u)
    yield "traction has shape", lambda: traction_forces(mesh, np.zeros((3, 2)))
    yield "a region of given forces has no facet", lambda: region_forces(mesh, CUBE.top & False, DOWN)
    yield "give .k, 2. surface nodes", lambda: line_forces(mesh, np.zeros((0, 2)), DOWN)
    yield "no triangle joins the surface nodes 0 and 99", lambda: line_forces(mesh, [[0, 99]], DOWN)


def contacts() -> Iterator[Refused]:
    """Rigid indenters, at small strain and at finite strain, and the nodes of a condensed contact."""
    problem, finite, ball = (
        CUBE.problem(CUBE.bottom),
        CUBE.finite(CUBE.bottom),
        Indenter(Sphere(1.0), TIP, DOWN),
    )
    yield "give positive numbers of metres", lambda: Indenter(Sphere(0.0), ORIGIN, DOWN)
    yield "a direction that is not zero", lambda: Indenter(Sphere(1.0), ORIGIN, ORIGIN)
    along = Capsule(1.0, 1.0, (0, 0, 1))
    yield "does not lie across its axis", lambda: Indenter(along, ORIGIN, DOWN)
    yield "region has shape", lambda: ContactProblem(problem, ball, ABOVE[1:])
    yield "no facet of the region lies under", lambda: ContactProblem(problem, ball, ABOVE & False)
    for depths in ([], [np.nan]):
        yield "give one finite number", lambda d=depths: ContactProblem(problem, ball, ABOVE).solve(d)
    for words, shape, facets, depths in (
        ("falls between the points of facets of 1.41 m; use facets of at most", Sphere(0.4), CUBE.top, [0.1]),
        ("use a sphere or a capsule", FlatPunch(0.5), CUBE.top, [0.1]),
        (r"give a mask of \(12,\)", Sphere(0.5), CUBE.top[1:], [0.1]),
        ("give one finite number", Sphere(0.5), CUBE.top, []),
        ("give one finite number", Sphere(0.5), CUBE.top, [np.inf]),
    ):
        given = Indenter(shape, TIP, DOWN), facets, depths
        yield words, lambda given=given: finite.indent(*given)
    still, wrong = np.zeros((len(CUBE.surface), 3)), np.full((1, len(CUBE.surface), 3), np.nan)
    for words, contact, options in (
        (r"contact has shape \(3,\); give shape", ABOVE[:3], {}),
        ("contact has no whole facet; choose more nodes", np.arange(len(ABOVE)) == 0, {}),
        ("the compliance matrix needs .* MB but 0 MB are available", ABOVE, {"memory_limit": 1e3}),
        (r"motions has shape \(\d+, 3\); give shape \(M, \d+, 3\)", ABOVE, {"motions": still}),
        ("motions has values that are not finite; give metres", ABOVE, {"motions": wrong}),
    ):
        yield words, lambda c=contact, o=options: CondensedProblem(problem, c, **o)


@pytest.mark.parametrize("refused", [meshes, supports, settings, problems, materials, loads, contacts])
def test_what_means_nothing_is_refused(refused: Callable[[], Iterator[Refused]]) -> None:
    for words, call in refused():
        with pytest.raises(SolverError, match=words) as caught:
            call()
        assert caught.value.status.remedy, words
        assert not caught.value.status.ok
