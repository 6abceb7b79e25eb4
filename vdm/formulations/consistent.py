"""The consistent form: a membrane on a foundation with exact area vectors, symmetric and convergent."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Mask
from vdm.constraints import Load
from vdm.deformed import DeformedSurface, follow
from vdm.formulations.base import ScalarFormulation
from vdm.formulations.border import DenseColumns
from vdm.material import ParameterError, Parameters, per_item
from vdm.surface import SurfaceMesh


class ConsistentFormulation(ScalarFormulation):
    """`k a_i L_i + T (Lc L)_i - a_i dP = a_i rho g delta_i + F_i . n_i`, `sum a_i L_i = 0`.

    L_i is the displacement along n_i = g_i / |g_i|. a_i = |g_i| replaces every area, so that `sum a_i L_i` is the
    exact first-order change of volume. Lc is the cotangent Laplacian (negative weights set to zero); with it T
    does not depend on the mesh. The contact's force is projected on the normal; it is -a_i p_i where only a nodal
    pressure is given.

    Raises
    ------
    ParameterError
        k or T missing, of the wrong length, or both zero.
    """

    name = "consistent"
    remedy = "hold a node, or make foundation positive somewhere"

    @classmethod
    def free_motions(cls, surface: SurfaceMesh, parameters: Parameters, nodes: Mask) -> Array:  # noqa: ARG003
        """A uniform unknown, where the foundation is zero everywhere."""
        tied = np.any(np.asarray(parameters.foundation, dtype=np.float64))
        return np.ones((np.count_nonzero(nodes), 1, 0 if tied else 1))

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        super().__init__(surface, parameters)
        foundation = per_item(parameters.foundation, "foundation", surface.n_nodes, self.name)
        tension = per_item(parameters.surface_tension, "surface_tension", len(surface.edges), self.name)
        if not (foundation.any() or tension.any()):
            raise ParameterError("foundation and surface_tension are both zero; make one positive")
        areas = surface.vector_areas
        self.scale = np.ones(surface.n_nodes)
        membrane = surface.laplacian(tension * surface.cotangent_weights)
        self.operator = sparse.csr_array(membrane + sparse.diags_array(foundation * areas))
        self.columns = DenseColumns(areas[:, None, None])
        self.rows = self.columns
        self.corner = np.zeros((1, 1))

    def contact_force(self, load: Load) -> Array:
        if load.contact_force is None:
            return (-self.surface.vector_areas * load.contact_pressure)[:, None]
        return np.einsum("ic,ic->i", load.contact_force, self.surface.normals)[:, None]

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:  # noqa: ARG002 - rest metric
        return self.apply(x)

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:  # noqa: ARG002 - rest metric
        return 0.5 * float(np.vdot(x, self.apply(x)))

    def deformed_columns(self, state: DeformedSurface) -> tuple[Array, Array]:
        gradient = self.volume_gradient(state)
        return gradient, gradient

    def deformed_contact_force(self, load: Load, state: DeformedSurface) -> Array:
        normals = self.surface.normals
        if load.contact_force is None:
            return -load.contact_pressure[:, None] * self.volume_gradient(state)
        force = follow(load.contact_force, self.surface.area_vectors, state)
        return np.einsum("ic,ic->i", force, normals)[:, None]
