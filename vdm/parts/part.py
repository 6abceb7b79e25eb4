"""One part of a body: its stiffness, and its condensed stiffness at the nodes that it shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask
from vdm.deformed import DeformableSurface
from vdm.formulations.base import Factor
from vdm.peers.bem import BoundaryFormulation, DenseFactor, Swelling, SwollenFactor


@dataclass(frozen=True)
class Part:
    """One part of a body, with n of its nodes; I are the inner free nodes, C the shared free ones.

    Attributes
    ----------
    nodes : (n,) of the body
    form : its stiffness
    body : its surface, ready to be deformed
    inner, shared : masks (n,) of I and C
    owns : mask (n,) of the nodes of the body's surface that turn with the part
    walls : (F, k) whether a facet belongs to the wall of each fluid-filled cavity
    areas : (n,) area of each node on the part's surface
    places : (n_C,) position of the shared nodes among those of all parts
    block : factor of S_II
    follows : (3 n_I, 3 n_C) T
    carried : (3 n_C, 3 n_C) S_CC - S_CI T
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
        """The swelling of its form."""
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
    """A part with its inner nodes eliminated; `block` is their factor without the swelling, where known."""
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
    """The factor of no unknowns: for parts without free inner nodes, or parts that share none."""

    def solve(self, right_hand_side: Array) -> Array:
        return right_hand_side


def dofs(nodes: Index) -> Index:
    """(3n,) unknowns of nodes."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).reshape(-1), np.int64)
