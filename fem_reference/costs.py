"""Expected costs of the paths through the linear system, for the choice between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

RESTART = 80  # vectors that GMRES keeps
# SuperLU's L and U of a P2-P1 system: entries at 1e5 unknowns, the exponent of their growth, and peak bytes per
# entry; from balls and cubes of 4,000 to 28,000 unknowns
_FILL, _FILL_EXPONENT, _BYTES_PER_ENTRY = 5.5e8, 1.6, 13.0
# On a pressed sphere: Newton steps and preconditioners per load step, and the work of an inexact solve over that
# of a linear problem (a dozen solves with a factor, half the GMRES steps)
NEWTON_STEPS = 4
_PREPARATIONS = {"direct": 1.5, "iterative": 1.0}
_EFFORT = {"direct": 12.0, "iterative": 0.5}


@dataclass(frozen=True)
class Estimate:
    """Expected cost of a path: seconds on one core, and bytes in addition to the assembled system."""

    seconds: float
    bytes: float


def estimate_costs(unknowns: int, vertices: int, loads: int, stiffening: float = 1.0) -> dict[str, Estimate]:
    """Cost of each path by name.

    Power laws, fitted to bodies of 16,000 to 1,100,000 unknowns; only the ratio of two paths matters.
    `stiffening` is lambda over the shear modulus, where lambda is in the displacement matrix (no pressure field).
    The iterations grow with its root.
    """
    size = unknowns / 1e5
    vectors = 8.0 * unknowns * (0.5 * RESTART + 12.0)
    coarse = 3000.0 * vertices
    iterations = math.sqrt(max(1.0, stiffening))
    return {
        "direct": Estimate(direct_seconds(unknowns, loads), direct_bytes(unknowns)),
        "iterative": Estimate(0.8 * size + loads * 2.8 * iterations * size**1.1, vectors + coarse),
    }


def estimate_newton_costs(unknowns: int, vertices: int, loads: int) -> dict[str, Estimate]:
    """Cost of the tangent systems of `loads` load steps at finite strain, by name of the path."""
    solves = NEWTON_STEPS * max(1, loads)
    first, second = (estimate_costs(unknowns, vertices, n) for n in (0, 1))
    return {
        name: Estimate(
            _PREPARATIONS[name] * first[name].seconds
            + _EFFORT[name] * solves * (second[name].seconds - first[name].seconds),
            second[name].bytes,
        )
        for name in first
    }


def faster_that_fits(costs: dict[str, Estimate], task: str, allowed: float) -> tuple[str, str]:
    """The faster path, or the iterative one where a factor needs more than `allowed` bytes; and the reason."""
    direct, iterative = costs["direct"], costs["iterative"]
    told = ", ".join(f"{name} about {cost.bytes / 1e6:.0f} MB" for name, cost in costs.items())
    faster = "direct" if direct.seconds <= iterative.seconds else "iterative"
    fits = faster == "iterative" or direct.bytes <= allowed
    return faster if fits else "iterative", f"{task}: {told}; {faster} is expected to be faster"


def direct_seconds(unknowns: float, loads: float) -> float:
    """Estimate for one core: a factorisation and the solves of the mixed system [s]."""
    size = unknowns / 1e5
    return 10.0 * size**1.6 + loads * 0.1 * size**1.3


def direct_bytes(unknowns: float) -> float:
    """Estimate: memory of a factor of the mixed system in single precision [B]."""
    return 8.4e8 * (unknowns / 1e5) ** 1.3


def superlu_bytes(unknowns: float) -> float:
    """Estimate: memory of SuperLU's factors of the mixed system, on the plain path [B]."""
    return _BYTES_PER_ENTRY * _FILL * (unknowns / 1e5) ** _FILL_EXPONENT
