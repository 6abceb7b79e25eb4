"""Records errors against mesh size and judges the observed order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.verification.records import Verified


@dataclass
class Convergence:
    """Errors of one quantity on ever finer meshes.

    `expected` comes from the method; the observed order of the last two meshes must lie within `slack` of it and
    the last error must be at most `cap`. An error at rounding passes whatever its order.
    """

    name: str
    expected: float
    cap: float
    slack: float = 0.15
    rounding: float = 1e-12
    rows: list[tuple[float, float]] = field(default_factory=list)

    def add(self, mesh_size: float, error: float) -> None:
        self.rows.append((mesh_size, error))

    @property
    def order(self) -> float:
        (h0, e0), (h1, e1) = self.rows[-2:]
        return float(np.log(e0 / e1) / np.log(h0 / h1))

    @property
    def table(self) -> str:
        lines = [f"{self.name} (expected {self.expected:g})", "| h | error | order |", "| --- | --- | --- |"]
        for k, (h, error) in enumerate(self.rows):
            order = ""
            if k:
                h0, e0 = self.rows[k - 1]
                order = f"{np.log(e0 / error) / np.log(h0 / h):.2f}"
            lines.append(f"| {h:.4g} | {error:.3e} | {order} |")
        return "\n".join(lines)

    def check(self, verified: Verified) -> None:
        """Record the finest error and the observed order."""
        print(self.table)
        h, error = self.rows[-1]
        verified.at_most(f"{self.name}: error at h = {h:.4g}", error, self.cap)
        if error > self.rounding:
            verified.equal(f"{self.name}: observed order", self.order, self.expected, atol=self.slack)
