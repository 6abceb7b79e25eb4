"""A body in parts at small displacements: sums the stiffnesses of the parts and condenses the inner nodes.

A is the sum of the parts' stiffnesses S_e at all nodes. In S_e, uniform swelling of a part costs no energy. H_e are
a part's area vectors, less the share V_e / V of the body's. Displacements of the surface nodes o determine those of
the nodes c of caps and rims, and the pressures q of the parts:

`A_cc u_c - H_c q = -A_co u_o`, `H_c^T u_c = -H_o^T u_o`

The second equation makes each part swell by the same share as the body. The force on the surface is
`A_oo u_o + A_oc u_c - H_o q`. Without rims, the last H_e depends on the others and is left out. For compressible
parts, H_e is b and `H_c^T u_c + a q = -H_o^T u_o` (`vdm.peers.bem.Swelling`): `S = S_0 + b b^T / a` as a bordered
system. Rims then have a column of their own, as the volume at rims does not change in sum. The matrix of the whole
body is never assembled: caps have few nodes, and free nodes are condensed part by part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Mask
from vdm.boundary.rims import Rims
from vdm.formulations.base import Factor, Factorise
from vdm.parts.part import Part, dofs
from vdm.peers.bem import BoundaryFormulation, DenseFactor
from vdm.solvers.cholesky import Cholesky
from vdm.surface import SurfaceMesh


class JoinedFormulation(BoundaryFormulation):
    """The `BoundaryFormulation` of a body, assembled from those of its parts."""

    has_matrix = False

    def __init__(
        self,
        whole: BoundaryFormulation,
        parts: Sequence[Part],
        shared: Mask,
        joined: Factor,
        *,
        has_rims: bool,
    ) -> None:
        """`shared` (n,) marks the nodes C of all parts; `joined` factors their condensed stiffness at rest.

        `has_rims` tells whether parts are cut along the rims of supports.
        """
        self._parts, self._shared_nodes, self._joined = parts, shared, joined
        super().__init__(whole.surface, whole.parameters)
        n_surface = whole.surface.n_nodes
        self._n_caps = len(shared) - n_surface
        volumes = np.array([part.form.surface.volume for part in parts])
        columns = np.zeros((len(shared), 3, len(parts)))
        own = np.zeros((3 * self._n_caps,) * 2)
        for e, part in enumerate(parts):
            columns[part.nodes, :, e] = part.form.surface.area_vectors
            on = np.flatnonzero(part.nodes >= n_surface)
            here, there = (dofs(nodes) for nodes in (on, part.nodes[on] - n_surface))
            own[np.ix_(there, there)] += part.form.swollen_block(here, here)
        of_body = np.zeros((len(shared), 3, 1))
        of_body[:n_surface, :, 0] = whole.surface.area_vectors
        if self.is_incompressible:
            self._apart = columns - of_body * (volumes / volumes.sum())
            if not has_rims:
                self._apart = self._apart[:, :, :-1]
            self._give = np.zeros((self._apart.shape[2],) * 2)
        else:
            at_rims = columns.sum(axis=2, keepdims=True) - of_body
            for e, part in enumerate(parts):
                columns[part.nodes, :, e] += part.swelling.beyond
            self._apart = np.concatenate([columns, at_rims], axis=2) if has_rims else columns
            give = np.zeros(self._apart.shape[2])
            give[: len(parts)] = [part.swelling.give for part in parts]
            self._give = np.diag(give)
        self._caps = DenseFactor(own, few=True)
        self._pressed = np.asfortranarray(self._apart[n_surface:].reshape(len(own), -1))
        self._moved = self._caps.solve(self._pressed)
        self._schur = self._give + self._pressed.T @ self._moved

    def _assemble(self, held: Mask) -> None:
        self._rims = Rims.of(self.surface, held)  # without cuts: the parts have their own

    @property
    def n_coarse(self) -> int:
        return self.surface.n_nodes

    def known_forces(self, forces: Callable[[SurfaceMesh], Array]) -> Array:
        """As in `BoundaryFormulation`, summed over the parts, which resolve the forces under their rims."""
        given = [part.form.known_forces(forces) for part in self._parts]
        force = np.zeros((len(self._shared_nodes), 3, len(given[0])))
        for part, own in zip(self._parts, given, strict=True):
            force[part.nodes] += own.transpose(1, 2, 0)
        apart = np.zeros((self._apart.shape[2], len(given[0])))
        return np.asarray(self._condensed(force, apart).transpose(2, 0, 1))

    def pressure_force(self, pressure: Array) -> Array:
        """As in `BoundaryFormulation`, with the response of caps, rims and compressible parts."""
        linear = np.column_stack([self.surface.points, np.ones(len(pressure))])
        fitted = np.linalg.lstsq(linear, pressure, rcond=None)[0]
        force = np.zeros((len(self._shared_nodes), 3))
        for part in self._parts:
            own = part.form.surface.points @ fitted[:3] + fitted[3]
            force[part.nodes] += part.form.pressure_force(own)
        return self._condensed(force[:, :, None], np.zeros((len(self._give), 1)))[:, :, 0]

    def elastic_force(self, x: Array) -> Array:
        return self.elastic_forces(x[:, :, None])[:, :, 0]

    def elastic_forces(self, x: Array) -> Array:
        k = x.shape[2]
        moved = np.concatenate([x, np.zeros((self._n_caps, 3, k))])
        force = self._of_parts(moved)
        pressed = self._apart.reshape(-1, self._apart.shape[2])
        return self._condensed(force, pressed.T @ moved.reshape(-1, k))

    def _condensed(self, force: Array, swells: Array) -> Array:
        """(N, 3, k) forces on the surface that condensation leaves of forces (n, 3, k) at all nodes.

        `swells` (p, k) is the excess volume of each part. The pressures remove it, or reduce it to what the
        compressibility `give` allows.
        """
        n, k = self.surface.n_nodes, force.shape[2]
        caps = self._caps.solve(np.asfortranarray(-force[n:].reshape(-1, k)))
        pressures = np.linalg.solve(self._schur, -swells - self._pressed.T @ caps)
        caps += self._moved @ pressures
        moved = np.concatenate([np.zeros((n, 3, k)), caps.reshape(-1, 3, k)])
        return np.asarray((force + self._of_parts(moved))[:n] - self._apart[:n] @ pressures)

    def _of_parts(self, x: Array) -> Array:
        """Elastic forces (n, 3, k) of displacements (n, 3, k) at all nodes, caps included."""
        force = np.zeros_like(x)
        for part in self._parts:
            force[part.nodes] += part.form.swollen_forces(x[part.nodes])
        return force

    def projected(self, spread: sparse.csr_array) -> Array:
        m = spread.shape[1]
        moved = spread.toarray().reshape(-1, 3, m)
        return np.asarray(spread.T @ self.elastic_forces(moved).reshape(-1, m))

    def factor(self, free: Mask, factorise: Factorise = Cholesky) -> Factor:  # noqa: ARG002 - it has its own
        return JoinedFactor(self._parts, self._shared_nodes, self._joined, self._apart, self._give, free)

    def diagonal(self) -> Array:
        """(3N,) diagonal of the stiffness with all caps held."""
        own = np.zeros((len(self._shared_nodes), 3))
        for part in self._parts:
            own[part.nodes] += np.diagonal(part.form.matrix).reshape(-1, 3)
        found: Array = own[: self.surface.n_nodes].reshape(-1)
        ground = self.parameters.ground
        return found if ground is None else found + ground.diagonal()


class JoinedFactor:
    """Factor of the stiffness of all parts at rest: condensed to the shared nodes, then solved inside each part.

    The pressures of the parts border the system; a Schur complement eliminates them.
    """

    def __init__(
        self, parts: Sequence[Part], shared: Mask, joined: Factor, apart: Array, give: Array, free: Mask
    ) -> None:
        self._parts, self._joined, self._shared = parts, joined, np.repeat(shared, 3)
        self._unknowns = np.zeros(3 * len(shared), np.bool_)
        self._unknowns[: 3 * len(free)] = np.repeat(free, 3)
        self._columns = apart.reshape(len(self._unknowns), -1)
        self._answers = self._answer(self._columns)
        self._schur = self._columns.T @ self._answers + give

    def solve(self, right_hand_side: Array) -> Array:
        """Solution of (n_free 3,) or (n_free 3, m) right-hand sides."""
        force = np.zeros((len(self._unknowns), *right_hand_side.shape[1:]))
        force[self._unknowns] = right_hand_side
        moved = self._answer(force)
        pressures = np.linalg.solve(self._schur, self._columns.T @ moved)
        return np.asarray(moved[self._unknowns] - self._answers[self._unknowns] @ pressures)

    def _answer(self, force: Array) -> Array:
        """Displacements of all nodes under forces (3n,) or (3n, m), without the pressures."""
        inside, right = list[Array](), force[self._shared]
        for part in self._parts:
            own = force[dofs(part.nodes[part.inner])]
            inside.append(np.asarray(part.block.solve(np.asfortranarray(own))))
            right[dofs(part.places)] -= part.follows.T @ own
        together = np.asarray(self._joined.solve(np.asfortranarray(right)))
        moved = np.zeros_like(force)
        moved[self._shared] = together
        for part, own in zip(self._parts, inside, strict=True):
            moved[dofs(part.nodes[part.inner])] = own - part.follows @ together[dofs(part.places)]
        return moved
