"""Reservations about a correct solution: the form does not fit its body, or the mesh is too coarse."""

from __future__ import annotations

import numpy as np

from vdm.formulations.base import Formulation
from vdm.material import COARSE_NODES_RANGE
from vdm.peers.bem import MAX_NODES, BoundaryFormulation
from vdm.peers.bem_sparse import SparseFormulation
from vdm.solution import Status

# smallest relative error that is reported. On bodies that it was not tuned for, the form of boundary integrals
# was wrong by 1.1 to 2.2 times the error of the known bendings, and by 0.4 to 1.1 times that of its mesh
LIMIT = 0.1

_INSIDE = (
    "take boundary elements or finite elements where the size of the displacement matters, or fit the parameters to"
    " loads like yours"
)


def reserved(
    status: Status,
    bending: float,
    mesh: float,
    form: Formulation,
    parts: float = np.nan,
    shape: float = np.nan,
) -> Status:
    """The status of a step, with a reservation where one of three errors exceeds `LIMIT`; NaN counts as none.

    The first error is `bending`, from `vdm.bending`. The second is `mesh`, from `vdm.mesh_error` for this load,
    plus the change by twice as many `parts`, in shape too. The third is `shape`, from `vdm.mesh_error`.
    """
    left = float(np.nansum([mesh, parts]))
    if not status.ok:
        return status
    if bending > LIMIT:
        wrong = f"a known bending comes out {100 * bending:.0f} % wrong"
        if isinstance(form, BoundaryFormulation):
            message = f"the mesh is too coarse for the body's thin parts: {wrong}"
            remedy = _finer(form, bending, "above all where it is thin")
        else:
            message = f"the {form.name} form does not know what is inside this body: {wrong}"
            remedy = _INSIDE
    elif left > LIMIT and isinstance(form, BoundaryFormulation):
        of_parts = parts > mesh
        leave = "parts leave" if of_parts else "mesh leaves"
        open_ = "displacement" if np.isnan(parts) else "displacement or of the change of shape"
        message = f"the {leave} about {100 * left:.0f} % of the {open_} open"
        remedy = _finer(form, left, "above all at the edges of supports and loads")
        if of_parts:
            remedy = "give more parts"
    elif shape > LIMIT and isinstance(form, BoundaryFormulation):
        message = (
            f"the mesh leaves about {100 * shape:.0f} % of the displacement or of the change of shape open"
        )
        remedy = _finer(form, shape, "above all where walls are thin")
    else:
        return status
    return status.telling(message, remedy)


def _finer(form: BoundaryFormulation, error: float, where: str) -> str:
    # the error goes as the square of the mesh size, and so as one over the nodes
    nodes = form.n_coarse
    most = COARSE_NODES_RANGE[1] if isinstance(form, SparseFormulation) else MAX_NODES
    wanted = 100 * int(np.ceil(nodes * error / (100.0 * LIMIT)))
    if wanted > most:
        return f"solve the body with finite elements: it takes some {wanted:,} nodes of this form"
    if nodes < form.surface.n_nodes:
        return f"set coarse_nodes to {wanted:,}"
    return f"refine the surface, {where}, to about {wanted:,} nodes"
