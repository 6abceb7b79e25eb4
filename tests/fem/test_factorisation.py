"""The library that factorises: the same numbers, and a clear record, where rslab cannot be loaded."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fem_reference import costs
from fem_reference.condensed import CondensedProblem
from fem_reference.costs import direct_bytes, direct_seconds
from fem_reference.finite_strain import FiniteStrainProblem
from fem_reference.linear_algebra import DirectSolver, choose_solver
from fem_reference.loads import held_nodes
from fem_reference.mesh import TetMesh
from fem_reference.solution import Solution, SolverError
from fem_reference.system import LinearSystem, build_system
from tests.fem.shapes import ball, cube

_HIDE = "import sys\nsys.modules['rslab'] = None\n"  # what an import meets on a machine without the wheel
_BREAK = """
import sys
class Broken:
    def find_spec(self, name, path=None, target=None):
        if name == "rslab":
            raise OSError("librslab.so: cannot open shared object file")
sys.meta_path.insert(0, Broken())
"""
_ANSWER = """
import json
import warnings
warnings.simplefilter("error")
from tests.fem.test_factorisation import answers
print(json.dumps(answers()))
"""


def answers() -> dict[str, dict[str, object]]:
    """A pressed and pulled ball by every way that factorises."""
    b = ball(1, 0.05)
    held = b.surface[:, 2] < -0.03
    top = b.facets_where(lambda x: x[:, 2] > 0.02)
    load = b.load(np.where(top, 300.0, 0.0))
    moved = b.load(0.0, prescribed=(0.0, 0.0, -0.002), gravity=(0.0, 0.0, -9.81))
    solutions = {}
    for nu in (0.3, 0.5):
        linear = b.problem(held, youngs_modulus=5e3, poisson_ratio=nu, density=1e3, solver="direct")
        solutions[f"linear {nu}"] = linear.solve([load, moved])
    condensed = CondensedProblem(linear, b.surface[:, 2] > 0.01)
    solutions["condensed"] = condensed.solve([load])
    finite = FiniteStrainProblem(
        *b.arrays, youngs_modulus=5e3, poisson_ratio=0.4999, density=1e3, held=held, solver="direct"
    )
    solutions["finite"] = finite.solve([load, moved])
    iterative = b.problem(held, poisson_ratio=0.4999, solver="iterative").solve([b.load(1.0)])
    return {name: _told(s) for name, s in solutions.items()} | {"iterative": _told(iterative)}


def _told(solution: Solution) -> dict[str, object]:
    return {
        "displacement": solution.displacement.tolist(),
        "reaction_force": solution.reaction_force.tolist(),
        "fluid_pressure": solution.fluid_pressure.tolist(),
        "status": [s.code for s in solution.status],
        "factorisation": solution.parameters["factorisation"],
    }


def _elsewhere(prelude: str) -> dict[str, dict[str, object]]:
    run = subprocess.run(
        [sys.executable, "-c", prelude + _ANSWER], capture_output=True, text=True, check=True, timeout=300
    )
    found: dict[str, dict[str, object]] = json.loads(run.stdout)
    return found


@pytest.mark.parametrize(
    "prelude", [pytest.param(_HIDE, marks=pytest.mark.slow), _BREAK], ids=["missing", "broken"]
)
def test_without_rslab_the_numbers_are_the_same(prelude: str) -> None:
    found = _elsewhere(prelude)
    for name, expected in answers().items():
        used = "none" if name == "iterative" else "rslab"
        assert expected["factorisation"] == used
        assert found[name]["factorisation"] == used.replace("rslab", "SuperLU")
        assert found[name]["status"] == expected["status"]
        assert set(expected["status"]) == {"converged"}  # type: ignore[call-overload]
        for field in ("displacement", "reaction_force", "fluid_pressure"):
            value = np.array(expected[field])
            atol = 1e-8 * np.abs(value).max()
            assert_allclose(np.array(found[name][field]), value, rtol=0, atol=atol, err_msg=f"{name} {field}")


def _system(n: int, poisson_ratio: float) -> LinearSystem:
    b = cube(n, distort=0.2)
    mesh = TetMesh(*b.arrays, order=2)
    return build_system(
        mesh, held_nodes(mesh, b.surface[:, 2] < 1e-12), mixed=True, poisson_ratio=poisson_ratio
    )


def test_superlu_is_taken_for_smaller_bodies_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """It needs more time and memory, so the iterative path is chosen earlier, and a lack of memory is foreseen."""
    system = _system(5, 0.4999)
    assert choose_solver(system, "auto", 40, None).name == "direct"
    ours = [(direct_seconds(n, 10), direct_bytes(n)) for n in (16_000, 91_000, 357_000)]
    rslab_needs = DirectSolver(system, None, "").estimated_bytes
    monkeypatch.setattr(costs, "rslab", None)
    theirs = [(direct_seconds(n, 10), direct_bytes(n)) for n in (16_000, 91_000, 357_000)]
    assert (np.array(theirs) > 2.0 * np.array(ours)).all()
    large = _system(8, 0.4999)
    assert choose_solver(large, "auto", 1, None).name == "iterative"
    solver = DirectSolver(system, None, "")
    assert solver.estimated_bytes > rslab_needs
    with pytest.raises(SolverError, match=r"the direct solver needs about \d+ MB but \d+ MB are available"):
        DirectSolver(system, 0.5 * rslab_needs, "")


def test_a_singular_matrix_is_told_by_superlu_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(costs, "rslab", None)
    system = _system(2, 0.3)
    system.stiffness.data[:] = 0.0
    assert system.gradient is not None
    system.gradient.data[:] = 0.0
    with pytest.raises(SolverError, match="the stiffness matrix is singular; hold more of the surface"):
        DirectSolver(system, None, "")
