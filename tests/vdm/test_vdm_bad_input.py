"""What means nothing is refused: one sentence each, before anything is solved. Supports: `test_vdm_model`."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from tests.vdm.vdm_shapes import BASE, BODY, POINTS, TRIANGLES, icosphere, model
from vdm import ConstraintError, Load, Model, ParameterError, Parameters, SolverError, SurfaceMesh
from vdm.incremental import IncrementalModel
from vdm.peers.bem import MAX_NODES
from vdm.peers.mass_spring import MassSpringFormulation

N = len(POINTS)
PUSH = np.where(POINTS[:, 2] > 0.03, 20.0, 0.0)
ZERO = Load(np.zeros(N), np.zeros((N, 3)), np.zeros((N, 3)))
FIRST = np.arange(N)  # numbers of the nodes, for masks of the first few
SOFT = Parameters(shear_modulus=1.0)
Refused = tuple[type[ValueError], str, Callable[[], object]]


def ball(level: int, formulation: str, parameters: Parameters, **options) -> Model:
    points, triangles = icosphere(level)
    fixed = points[:, 2] < 0.0
    return Model(points, triangles, parameters, formulation=formulation, fixed=fixed, **options)


def paper(**moduli) -> Model:
    return model("paper", Parameters(**moduli))


def parameters() -> Iterator[Refused]:
    """Moduli, rules and choices."""
    yield ParameterError, "needs connectivity_modulus", lambda: paper(bulk_modulus=1.0)
    yield ParameterError, "both zero", lambda: paper(bulk_modulus=0.0, connectivity_modulus=0.0)
    yield ParameterError, "162 entries", lambda: paper(bulk_modulus=np.ones(3), connectivity_modulus=1.0)
    stiffening = {"bulk_modulus": 1.0, "connectivity_modulus": 1.0, "tension_stiffening": 1.0}
    yield ParameterError, "nonlinear", lambda: paper(**stiffening)
    for value in ("stiff", 1.0 + 2.0j, [1.0, None], True, -1.0, np.nan):
        for name in ("bulk_modulus", "tension_stiffening"):
            told = f"{name} must be finite and not negative"
            yield ParameterError, told, lambda name=name, value=value: Parameters(**{name: value})
    for young in (0.0, -1.0, np.nan, np.inf):
        yield ParameterError, "youngs_modulus", lambda e=young: Parameters.from_tissue(e, BODY, "paper")
    for ratio in (-1.0, 0.51, np.nan):
        told = "poisson_ratio must be above -1 and at most 1/2"
        yield ParameterError, told, lambda nu=ratio: Parameters(shear_modulus=1.0, poisson_ratio=nu)
    for shape, value in (((4, 4), 1.0), ((3, 6), 1.0), ((3, 3), np.inf)):
        ground = sparse.csr_array(np.full(shape, value))
        told = r"ground must be finite and of shape \(3N, 3N\)"
        yield ParameterError, told, lambda g=ground: Parameters(shear_modulus=1.0, ground=g)
    told = "whole number from 200 to 2,000, not 100"
    yield ParameterError, told, lambda: Parameters(shear_modulus=1.0, coarse_nodes=100)
    yield ParameterError, "formulations are isotropic", lambda: SOFT.anisotropic(BODY, [0.0, 0.0, 1.0], 3.0)
    for soft in (Parameters(), Parameters(shear_modulus=0.0)):
        yield ParameterError, "shear_modulus", lambda soft=soft: model("bem", soft)
    told = "needs shear_modulus, one positive number"
    yield ParameterError, told, lambda: MassSpringFormulation(BODY, Parameters(surface_tension=50.0))
    for name, moduli in (
        ("consistent", ("foundation", "surface_tension")),
        ("vector", ("surface_tension",)),
        ("bem-sparse", ("shear_modulus",)),
    ):
        without, zero = (dict.fromkeys(moduli, value) for value in (None, 0.0))
        yield ParameterError, moduli[0], lambda n=name, m=without: model(n, Parameters(**m))
        yield ParameterError, f"{moduli[-1]}.*positive", lambda n=name, m=zero: model(n, Parameters(**m))
    yield ParameterError, 'needs solver "lu"', lambda: model("paper", constraint_method="penalty-added")
    for option, value in (("contact_sign", "outward"), ("volume_row", "exactly"), ("solver", "")):
        told = f"{option} must be one of .*, not '{value}'"
        yield ParameterError, told, lambda option=option, value=value: model("vector", **{option: value})
    yield ParameterError, "formulation must be one of .*, not 'paper '", lambda: ball(1, "paper ", SOFT)
    for solver, option, value in (
        ("linear", "stop", "printed"),
        ("lu", "volume_row", "printed"),
        ("figure-8", "stop", "never"),
    ):
        yield (
            ParameterError,
            option,
            lambda s=solver, o=option, v=value: model("paper", solver=s, **{o: v}),
        )
    yield ParameterError, "take the paper formulation", lambda: model("consistent", solver="figure-8")
    for tolerance in (0.0, 1.0, np.nan):
        told = "tolerance must lie between 0 and 1"
        yield ParameterError, told, lambda t=tolerance: model("paper", solver="bicg", tolerance=t)
    for solver in ("single", "refined"):
        yield SolverError, "double precision only", lambda s=solver: model("bem", solver=s)
    squeezed = Parameters(shear_modulus=1.0, poisson_ratio=0.3)
    told = "a fluid that keeps the volume"
    yield ParameterError, told, lambda: ball(1, "bem", squeezed, solver="quasi-linear")
    yield SolverError, f"2,562 nodes are more than the {MAX_NODES:,}", lambda: ball(4, "bem", SOFT)
    told = "10,242 nodes are too many; use a mesh of at most 5,000 nodes"
    many = SurfaceMesh(*icosphere(5))
    yield SolverError, told, lambda: MassSpringFormulation(many, SOFT)


def scenes() -> Iterator[Refused]:
    """Masks, weights and histories."""
    told = "^node 2 is both fixed and constrained; take it out"
    for words, options in (
        ("every node", {"fixed": FIRST >= 0}),
        ("mask of 162", {"fixed": np.ones(3, dtype=bool)}),
        ("mask of 162", {"fixed": np.zeros(N)}),
        ("density", {"density": -1.0}),
        ("gravity", {"gravity": (0.0, np.inf, 0.0)}),
        ("penalty", {"solver": "lu", "penalty": 0.0}),
        (told, {"fixed": FIRST < 3, "constrained": (FIRST >= 2) & (FIRST < 9)}),
        ("^node 0 is both .*, and 2 more; take", {"fixed": FIRST < 9, "constrained": FIRST < 3}),
        ("environment_pressure must be finite", {"environment_pressure": np.nan}),
        ("environment_pressure must be finite", {"environment_pressure": np.inf}),
    ):
        yield ConstraintError, words, lambda options=options: model("paper", **options)
    held = model("vector", constrained=PUSH > 0.0)
    yield ConstraintError, "prescribed displacement", lambda: held.solve([Load(PUSH)])
    told = r"solve takes a list of loads, .* solve\(\[load\]\)"
    yield ConstraintError, told, lambda: held.solve(ZERO)
    rule, weighs = Parameters.from_tissue(5000.0, BODY, "paper"), {"density": 1e3, "gravity": (0, 0, -9.8)}
    step_by_step = IncrementalModel(POINTS, TRIANGLES, rule, fixed=BASE)
    told = "no weight"
    yield ConstraintError, told, lambda: IncrementalModel(POINTS, TRIANGLES, rule, fixed=BASE, **weighs)
    dead = Load(np.zeros(N), dead_force=np.ones((N, 3)))
    yield ConstraintError, "along a line", lambda: step_by_step.solve([dead])


@pytest.mark.parametrize("refused", [parameters, scenes])
def test_what_means_nothing_is_refused(refused: Callable[[], Iterator[Refused]]) -> None:
    for error, words, call in refused():
        with pytest.raises(error, match=words):
            call()


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("contact_pressure", None, "contact_pressure is missing"),
        ("contact_pressure", "20", "contact_pressure must be real numbers"),
        ("contact_pressure", np.zeros(N, dtype=complex), "contact_pressure must be real numbers"),
        ("contact_pressure", [None] * N, "contact_pressure must be real numbers"),
        ("contact_pressure", [[1.0], [1.0, 2.0]], "contact_pressure must have shape"),
        ("contact_pressure", np.full(N, 1e200), r"contact_pressure has values beyond 1e\+100; check its"),
        ("contact_force", np.full((N, 3), -1e200), "contact_force has values beyond"),
        ("prescribed", np.full((N, 3), 1e200), "prescribed has values beyond"),
        ("prescribed", np.zeros((3, N)), "prescribed must have shape"),
        ("contact_pressure", np.full(N, np.nan), "nan or inf"),
        ("contact_force", np.zeros((N, 2)), "contact_force must have shape"),
        ("prescribed", np.full((N, 3), 1e-3), "moves nodes and none is constrained; name them in constr"),
    ],
)
def test_a_load_that_is_none(part, value, words, monkeypatch):
    body = model("vector")
    monkeypatch.setattr(body.solver, "step", lambda *_: pytest.fail("solved"))
    with pytest.raises(ConstraintError, match=words):
        body.solve([ZERO, replace(ZERO, **{part: value})])


def test_a_load_may_be_lists_of_whole_numbers():
    exact, listed = (model("vector").solve([Load(p)]).displacement for p in (PUSH, [int(p) for p in PUSH]))
    assert np.array_equal(exact, listed)


@pytest.mark.parametrize("solver", ["linear", "lu", "bicg"])
def test_an_answer_beyond_all_numbers_is_a_status(solver):
    body = model("vector", Parameters(surface_tension=1e-120), solver=solver)
    [status] = body.solve([Load(PUSH)]).status
    assert status.code == "not-finite"
    assert "check the size of the loads and moduli" in status.remedy
