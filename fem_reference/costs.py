"""What the paths through the linear system are expected to cost, for the choice between them."""

from __future__ import annotations

import math
from dataclasses import dataclass

RESTART = 80  # vectors that GMRES keeps
# Entries of SuperLU's L and U of a P2-P1 system with 1e5 unknowns and the exponent of their growth, and the bytes
# that an entry takes at the peak: balls and cubes of 4,000 to 28,000 unknowns.
_FILL, _FILL_EXPONENT, _BYTES_PER_ENTRY = 5.5e8, 1.6, 13.0
# Measured on a pressed sphere: Newton steps in a load step, preconditioners made, and the work of an inexact solve
# over that of a linear problem (a dozen solves with a factor, half the GMRES steps).
NEWTON_STEPS = 4
_PREPARATIONS = {"direct": 1.5, "iterative": 1.0}
_EFFORT = {"direct": 12.0, "iterative": 0.5}


@dataclass(frozen=True)
class Estimate:
    """What a path is expected to cost: seconds on one core, and bytes on top of the assembled system."""

    seconds: float
    bytes: float


def estimate_costs(unknowns: int, vertices: int, loads: int, stiffening: float = 1.0) -> dict[str, Estimate]:
    """Cost of each path by name.

    Power laws fitted to bodies of 16,000 to 1,100,000 unknowns; the choice between the paths needs their ratio
    only. `stiffening` is lambda over the shear modulus where no pressure field takes it out of the displacement
    matrix: the iterations grow with its root.
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
    """Cost of the tangent systems of some load steps of finite strain on each path, by name."""
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
    """The faster path for a task, by name, the iterative one where a factor takes more bytes; and why."""
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
    """Estimate: memory of SuperLU's factors of the mixed system, by which the plain path solves it [B]."""
    return _BYTES_PER_ENTRY * _FILL * (unknowns / 1e5) ** _FILL_EXPONENT
