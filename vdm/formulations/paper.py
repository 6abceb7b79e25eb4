"""The model as printed (equations 5-8, 16-22): nodal volumes tied by B_i and B_ij, one fluid pressure."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import sparse

from solver_common.arrays import Array, Mask
from vdm.constraints import Load
from vdm.deformed import DeformedSurface
from vdm.formulations.base import ScalarFormulation
from vdm.formulations.border import DenseColumns
from vdm.material import ParameterError, Parameters, per_item
from vdm.surface import SurfaceMesh


class PaperFormulation(ScalarFormulation):
    """Row i of equation 27, times A_i, in the nodal volume change x_i = dV_i = A_i L_i (21):

    `(1/H) [B_i x_i + sum_j B_ij (x_i - x_j)] - A_i dP = A_i (rho g delta_i - P_cp,i)`, H = V / A, with the border
    `sum x_i = 0` (19, 28). The printed matrix of L is not symmetric. In x it is symmetric positive definite, and a
    Cholesky factor exists. `state_matrix` gives the printed matrix: rows in Pa, columns L_1..L_N [m] and dP [Pa].

    Raises
    ------
    ParameterError
        B_i or B_ij missing, of the wrong length, or all zero.
    """

    name = "paper"
    remedy = "hold a node, or make bulk_modulus positive somewhere"

    @classmethod
    def free_motions(cls, surface: SurfaceMesh, parameters: Parameters, nodes: Mask) -> Array:  # noqa: ARG003
        """A uniform unknown, where bulk_modulus is zero everywhere."""
        tied = np.any(np.asarray(parameters.bulk_modulus, dtype=np.float64))
        return np.ones((np.count_nonzero(nodes), 1, 0 if tied else 1))

    def __init__(self, surface: SurfaceMesh, parameters: Parameters) -> None:
        super().__init__(surface, parameters)
        self.bulk_modulus = per_item(parameters.bulk_modulus, "bulk_modulus", surface.n_nodes, self.name)
        self.connectivity_modulus = per_item(
            parameters.connectivity_modulus, "connectivity_modulus", len(surface.edges), self.name
        )
        if not (self.bulk_modulus.any() or self.connectivity_modulus.any()):
            raise ParameterError("bulk_modulus and connectivity_modulus are both zero; make one positive")
        self.scale = surface.nodal_areas
        height = surface.volume / surface.area
        coupling = surface.laplacian(self.connectivity_modulus)
        self.operator = sparse.csr_array((coupling + sparse.diags_array(self.bulk_modulus)) / height)
        self.columns = DenseColumns(surface.nodal_areas[:, None, None])
        self.rows = DenseColumns(np.ones((surface.n_nodes, 1, 1)))
        self.corner = np.zeros((1, 1))

    def contact_force(self, load: Load) -> Array:
        return (-self.surface.nodal_areas * load.contact_pressure)[:, None]

    def volumic_pressure(self, displacement: Array) -> Array:
        """(N,) P_vp = (B_i / V_i) dV_i [Pa] of normal displacements L (N,) (equations 6, 7, 21)."""
        surface = self.surface
        pressure: Array = self.bulk_modulus / surface.nodal_volumes * surface.nodal_areas * displacement
        return pressure

    def volumic_tension(self, displacement: Array) -> Array:
        """(N,) P_vt = sum_j (B_ij / V_i) (dV_i - dV_j) [Pa] of normal displacements L (N,) (equation 8)."""
        surface = self.surface
        change = surface.nodal_areas * displacement
        tension: Array = surface.laplacian(self.connectivity_modulus) @ change / surface.nodal_volumes
        return tension

    def nodal_stress(self, displacement: Array) -> Array:
        """(N,) sigma_i = (B_i / V_i) (dV_i - sum_j dV_j) [Pa] as printed in equation 9.

        For a uniform displacement this is 1 - valence times the pressure, not zero. The normal traction that
        balances fluid and contact is the sum of `volumic_pressure` and `volumic_tension`.
        """
        surface = self.surface
        change = surface.nodal_areas * displacement
        i, j = surface.edges.T
        neighbours = np.bincount(i, change[j], surface.n_nodes) + np.bincount(j, change[i], surface.n_nodes)
        stress: Array = self.bulk_modulus / surface.nodal_volumes * (change - neighbours)
        return stress

    @property
    def row_scale(self) -> Array:
        """(N,) 1 / A_i: the printed rows are pressures."""
        inverse: Array = 1.0 / self.surface.nodal_areas
        return inverse

    @property
    def column_scale(self) -> Array:
        """(N,) A_i: the printed unknown is L_i (22)."""
        return self.surface.nodal_areas

    def deformed_internal_force(self, x: Array, state: DeformedSurface) -> Array:
        """A_i (P_vp + P_vt) with current areas throughout: dV_i = A_i L_i and V_i = A_i V / A."""
        areas = state.nodal_areas
        change = areas * (x[:, 0] / self.scale)
        current_height = self.surface.volume / areas.sum()
        rest_height = self.surface.volume / self.surface.area
        force = self.operator @ change
        if self.parameters.tension_stiffening:
            i, j = self.surface.edges.T
            gap = change[i] - change[j]
            volume = 0.5 * (self.surface.nodal_volumes[i] + self.surface.nodal_volumes[j])
            stiffening = self.parameters.tension_stiffening * (gap / volume) ** 2
            extra = self.connectivity_modulus * stiffening * gap / rest_height
            force = force + np.bincount(i, extra, len(force)) - np.bincount(j, extra, len(force))
        return (force * (rest_height / current_height))[:, None]

    def deformed_energy(self, x: Array, state: DeformedSurface) -> float:
        """Half the work of the pressures on the displacement; the printed model has no potential."""
        return 0.5 * float((x[:, 0] / self.scale) @ self.deformed_internal_force(x, state)[:, 0])

    def deformed_columns(self, state: DeformedSurface) -> tuple[Array, Array]:
        return state.nodal_areas[:, None], self.volume_gradient(state) + self._unseen[:, None]

    def kept_volume(self, x: Array, state: DeformedSurface) -> float:
        """The polyhedron's volume, with its first-order term as printed: sum A_i L_i (19), not sum g_i . n_i L_i.

        It is the exact volume plus sum (A_i - |g_i|) L_i: a vanishing load then has the answer of the linear model.
        """
        return state.volume + float(self._unseen @ x[:, 0])

    @cached_property
    def _unseen(self) -> Array:
        """(N,) share of A_i that is missing in the gradient of the volume at rest: 1 - g_i . n_i / A_i."""
        surface = self.surface
        along = np.einsum("ic,ic->i", surface.area_vectors, surface.normals)
        unseen: Array = 1.0 - along / surface.nodal_areas
        return unseen

    def deformed_contact_force(self, load: Load, state: DeformedSurface) -> Array:
        return (-state.nodal_areas * load.contact_pressure)[:, None]

    def printed_volume_row(self, state: DeformedSurface) -> Array:
        """Row of `sum A_i L_i` with the current areas; in x each entry is the current A_i over that at rest."""
        return (state.nodal_areas / self.scale)[:, None]
