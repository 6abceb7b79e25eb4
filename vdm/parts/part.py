"""One of the parts of a body: its stiffness, and what is left of it at the nodes that it shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_common.arrays import Array, Index, Mask
from vdm.deformed import DeformableSurface
from vdm.formulations.base import Factor
from vdm.peers.bem import BoundaryFormulation, DenseFactor, Swelling, SwollenFactor


@dataclass(frozen=True)
class Part:
    """One of the parts: n nodes of the body, of which some are inner and free (I), some shared and free (C).

    Attributes
    ----------
    nodes : (n,) of the body
    form : its stiffness
    body : its surface, ready to be deformed
    inner, shared : masks (n,) of I and C
    owns : mask (n,) of the nodes of the body's surface that turn with it
    walls : (F, k) whether its facets are of the wall of each cavity that a fluid fills
    areas : (n,) shares of its nodes in its surface
    places : (n_C,) of the shared nodes among all shared ones
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
        """Of its form."""
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
    """A part whose inner nodes are eliminated; `block` is their factor, without the swelling, where it is known."""
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
    """The factor of no unknowns: of a part without inner nodes that are free, of parts that share none."""

    def solve(self, right_hand_side: Array) -> Array:
        return right_hand_side


def dofs(nodes: Index) -> Index:
    """(3n,) unknowns of nodes."""
    return np.asarray((3 * nodes[:, None] + np.arange(3)).reshape(-1), np.int64)
