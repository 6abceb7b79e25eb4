"""One part of a body: its stiffness, condensed to the nodes that it shares with other parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask
from vdm.deformed import DeformableSurface
from vdm.formulations.base import Factor
from vdm.peers.bem import BoundaryFormulation, DenseFactor, Swelling, SwollenFactor


@dataclass(frozen=True)
class Part:
    """One part of a body, with n nodes; I are the inner free nodes, C the free nodes shared with other parts.

    Attributes
    ----------
    nodes : (n,) their numbers in the body
    form : the stiffness S of the part
    body : the deformable surface of the part
    inner, shared : masks (n,) of I and C
    places : (n_C,) position of the shared nodes among those of all parts
    owns : mask (n,) of the surface nodes whose loads turn with this part
    walls : (F, k) whether each facet belongs to the wall of each fluid-filled cavity
    areas : (n,) nodal area on the part's surface, over the total
    block : factor of S_II
    follows : (3 n_I, 3 n_C) T = S_II^-1 S_IC
    carried : (3 n_C, 3 n_C) condensed stiffness S_CC - S_CI T
    """

    nodes: Index
    form: BoundaryFormulation
    body: DeformableSurface
    inner: Mask
    shared: Mask
    places: Index
    owns: Mask
    walls: Mask
    areas: Array
    block: Factor
    follows: Array
    carried: Array

    @property
    def swelling(self) -> Swelling:
        """The `Swelling` of `form`, which a part always has."""
        assert self.form.swelling is not None
        return self.form.swelling


def condensed(
    form: BoundaryFormulation,
    nodes: Index,
    inner: Mask,
    shared: Mask,
    owns: Mask,
    walls: Mask,
    places: Index,
    block: Factor | None,
) -> Part:
    """A `Part` with its inner nodes condensed; `block` is their factor without the swelling, if it is known."""
    i, c = dofs(np.flatnonzero(inner)), dofs(np.flatnonzero(shared))
    follows, carried = np.zeros((len(i), 0)), np.zeros((0, 0))
    swelling = form.swelling
    assert swelling is not None
    if not len(i):
        solver: Factor = Nothing()
    elif shared.any():
        solver = DenseFactor(form.swollen_block(i, i))
    else:
        solver = SwollenFactor(block or form.factor(inner), swelling, i)
    if shared.any():
        coupling = form.swollen_block(i, c)
        follows = np.asarray(solver.solve(np.asfortranarray(coupling)))
        carried = form.swollen_block(c, c)
        carried -= coupling.T @ follows
        carried += carried.T
        carried *= 0.5
    areas = form.surface.nodal_areas / form.surface.area
    body = DeformableSurface(form.surface)
    return Part(nodes, form, body, inner, shared, places, owns, walls, areas, solver, follows, carried)


class Nothing:
    """The factor of an empty matrix, for parts without free inner nodes, or bodies without shared nodes."""

    def solve(self, right_hand_side: Array) -> Array:
        return right_hand_side


def dofs(nodes: Index) -> Index:
    """(3n,) degrees of freedom of nodes (n,)."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).reshape(-1), np.int64)
