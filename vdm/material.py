"""Material parameters of the three formulations, and the rule that chooses them from a tissue."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from solver_common.arrays import Array, Index
from vdm.surface import SurfaceMesh

Rotation = Literal["none", "global"]
ROTATIONS: tuple[Rotation, ...] = ("none", "global")

# An incompressible ball under a normal traction P_n moves by u_r = c_n P_n; a normal-only membrane on a foundation
# by 1 / (k + n (n + 1) T / R^2). These two numbers make both equal for n = 2 and n = 3 (see `ball_compliance`).
BALL_FOUNDATION = 46.0 / 35.0  # k R / mu
BALL_TENSION = 29.0 / 70.0  # T / (mu R)
# Vector form without a known support: T / (mu R), fitted to an incompressible ball under a finger's patch.
VECTOR_TENSION = 0.70
# Vector form on a known support: T / (mu sqrt(R d)) at the distance d from it. One number for six bodies, by least
# squares over their training loads; single bodies give 0.58 to 1.43.
SUPPORTED_TENSION = 1.1


# Poisson's ratio above which a body counts as incompressible: its volume changes by less than a thousandth
INCOMPRESSIBLE = 0.4998
# rotation = "nodal", which older studies name
NO_NODAL = (
    "is gone, as its answer grows without limit on finer meshes; use 'global', one rotation for the body"
)
# nodes of the sparse form's coarse body: fewer lose thin lobes, more slow down frame and set-up
COARSE_NODES_RANGE = (200, 2000)
COARSE_NODES = 1000
MOST_PARTS = 64
NODE_MODULI = ("bulk_modulus", "foundation")
EDGE_MODULI = ("connectivity_modulus", "surface_tension", "stretch_stiffness")
MODULI = (*NODE_MODULI, *EDGE_MODULI, "shear_modulus")
ISOTROPIC = ("bem", "bem-sparse", "mass-spring")  # formulations that know no fibres


class ParameterError(ValueError):
    """A material parameter that is missing or has no physical meaning; the message names it."""


@dataclass(frozen=True)
class Lumps:
    """Regions 1 to m inside a body of N surface nodes, each of its own material; region 0 is the surrounding body.

    A lump may contain lumps; it touches neither the surface nor its neighbours.

    Attributes
    ----------
    points : (k, 3) inner nodes [m]; inner node j has the number N + j
    facets : (I, 3) interfaces of two regions, in the numbers of the N + k nodes
    sides : (I, 2) the two regions of a facet; its normal points from the first to the second
    shear_moduli : (m,) [Pa]
    poisson_ratios : (m,), up to 1/2
    """

    points: Array
    facets: Index
    sides: Index
    shear_moduli: Array
    poisson_ratios: Array

    def __post_init__(self) -> None:
        count = len(self.shear_moduli)
        if not (self.shear_moduli > 0.0).all() or len(self.poisson_ratios) != count:
            raise ParameterError("each lump needs a positive shear modulus and a Poisson's ratio")
        if not ((self.poisson_ratios > -1.0) & (self.poisson_ratios <= 0.5)).all():
            raise ParameterError("the Poisson's ratios of lumps must be above -1 and at most 1/2")
        if len(np.unique(np.sort(self.sides, axis=1), axis=0)) != count:
            raise ParameterError("lumps touch each other; leave some of the body between them")

    def halved(self, points: Array) -> Lumps:
        """The same lumps with each facet in four, by nodes at edge middles; `points` (N, 3) are the surface's.

        The same object if any edge has both ends on the surface.
        """
        n, places = len(points), np.vstack([points, self.points])
        edges = np.sort(self.facets[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, number = np.unique(edges, axis=0, return_inverse=True)
        if (edges < n).all(axis=1).any():
            return self
        (a, b, c), (ab, bc, ca) = self.facets.T, (len(places) + number.reshape(-1, 3)).T
        facets = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
        new = np.vstack([self.points, places[edges].mean(axis=1)])
        return replace(self, points=new, facets=facets, sides=np.repeat(self.sides, 4, axis=0))

    def bounds(self, facets: Index) -> list[Index]:
        """Facets (F, 3) of each region's boundary inside the body, outward, in the numbering of `facets` (I, 3)."""
        first, second = self.sides.T
        return [
            np.vstack([facets[first == k], facets[second == k][:, ::-1]])
            for k in range(len(self.shear_moduli) + 1)
        ]


@dataclass(frozen=True)
class Parameters:
    """Material parameters, SI units; each formulation reads its own and names the ones that are missing.

    Attributes
    ----------
    bulk_modulus : B_i [Pa], scalar or (N,) per node (paper)
    connectivity_modulus : B_ij [Pa], scalar or (E,) per edge of `SurfaceMesh.edges` (paper)
    foundation : k [Pa/m], scalar or (N,) (consistent; vector, where zero is the default)
    surface_tension : T [N/m], scalar or (E,) (consistent, vector)
    stretch_stiffness : E_s [N/m], scalar or (E,) (vector)
    shear_modulus : mu [Pa], one number (boundary, sparse, mass-spring)
    coarse_nodes : largest number of nodes of the coarse body, 200 to 2,000; None: 1,000. A surface of no more
        nodes is not coarsened (sparse)
    parts : number of parts that the nonlinear solver cuts the body into; None: as many as its rotations need
        (boundary, sparse)
    poisson_ratio : of the inside, above -1 and at most 1/2; 1/2 is the fluid that keeps the volume
        (boundary, sparse)
    lumps : inner regions with a material of their own (boundary, linear solvers)
    fluid_in_cavities : whether each cavity holds a weightless incompressible fluid, which keeps its volume;
        otherwise cavities are empty (boundary)
    rotation : rotation that is free of tension: none, or one for the whole body (vector)
    ground : (3N, 3N) force of springs between the surface and a rigid ground over the displacement of the nodes
        [N/m], sparse and symmetric (vector, boundary, mass-spring)
    tension_stiffening : gamma of the nonlinear volumic tension B_ij (1 + gamma s^2) s, s the difference of two
        neighbours' dV over their mean V_i (paper, nonlinear solver); zero is equation 8
    youngs_modulus : E [Pa] of the tissue that the moduli represent, for the check in `vdm.bending`. None:
        `2 (1 + nu) mu` where mu is set, else no check
    """

    bulk_modulus: float | Array | None = None
    connectivity_modulus: float | Array | None = None
    foundation: float | Array | None = None
    surface_tension: float | Array | None = None
    stretch_stiffness: float | Array | None = None
    shear_modulus: float | None = None
    coarse_nodes: int | None = None
    parts: int | None = None
    poisson_ratio: float = 0.5
    lumps: Lumps | None = None
    fluid_in_cavities: bool = False
    rotation: Rotation = "global"
    ground: sparse.csr_array | None = None
    tension_stiffening: float = 0.0
    youngs_modulus: float | None = None

    def __post_init__(self) -> None:
        _check_rotation(self.rotation)
        for name, value in self.moduli().items():
            if not _not_negative(value):
                raise ParameterError(f"{name} must be finite and not negative")
        (fewest, most), count = COARSE_NODES_RANGE, self.coarse_nodes
        if count is not None and not (isinstance(count, int | np.integer) and fewest <= count <= most):
            raise ParameterError(
                f"coarse_nodes must be a whole number from {fewest} to {most:,}, not {count!r}"
            )
        if self.parts is not None and not (
            isinstance(self.parts, int | np.integer) and 1 <= self.parts <= MOST_PARTS
        ):
            raise ParameterError(f"parts must be a whole number from 1 to {MOST_PARTS}, not {self.parts!r}")
        ground = self.ground
        if ground is not None and not (_is_square_of_threes(ground.shape) and np.isfinite(ground.data).all()):
            raise ParameterError(f"ground must be finite and of shape (3N, 3N), not {ground.shape}")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise ParameterError(f"poisson_ratio must be above -1 and at most 1/2, not {self.poisson_ratio}")
        if not _not_negative(self.tension_stiffening):
            raise ParameterError(
                f"tension_stiffening must be finite and not negative, not {self.tension_stiffening}"
            )
        if self.youngs_modulus is not None and not (
            np.isfinite(self.youngs_modulus) and self.youngs_modulus > 0.0
        ):
            raise ParameterError(f"youngs_modulus must be positive, not {self.youngs_modulus}")

    @property
    def is_filled(self) -> bool:
        """Whether Poisson's ratio counts as 1/2: that of a fluid, which keeps the volume."""
        return self.poisson_ratio > INCOMPRESSIBLE

    @property
    def tissue_modulus(self) -> float | None:
        """E [Pa] of the tissue that the moduli represent; None where they do not determine it."""
        if self.youngs_modulus is None and self.shear_modulus is not None:
            return 2.0 * (1.0 + self.poisson_ratio) * self.shear_modulus
        return self.youngs_modulus

    @classmethod
    def from_tissue(
        cls,
        youngs_modulus: float,
        surface: SurfaceMesh,
        formulation: str,
        rotation: Rotation = "global",
        held: NDArray[np.bool_] | None = None,
        poisson_ratio: float = 0.5,
    ) -> Parameters:
        """Parameters by rule, without a fit: matched to an incompressible ball of the same R = 3 V / A.

        The fluid keeps the volume, so that Young's modulus alone describes the tissue: mu = E / 3, with Poisson's
        ratio 1/2. (Keeping the shear modulus of a tissue of 0.45 instead of E is 3 % stiffer and less accurate.)
        Only boundary elements have a choice: with `poisson_ratio` they take the tissue itself,
        `mu = E / (2 (1 + nu))`.

        - consistent: k = (46/35) mu / R and T = (29/70) mu R, exact for the ball under P_2 and P_3;
        - paper: B = k V / A and B_ij = T (V / A) / (sqrt(3) A / N), which gives the same T on a mesh of N equal
          nodes with six neighbours: sum_j (L_i - L_j) = -(3/2) h^2 lap L and A_i = (sqrt(3)/2) h^2. A constant
          B_ij does not converge under refinement: it belongs to this mesh;
        - vector: T = 1.1 mu sqrt(R d) on an edge at the distance d from the held nodes (see
          `distance_from_support`); without held nodes 0.70 mu R everywhere;
        - boundary, mass-spring: mu itself.

        Parameters
        ----------
        youngs_modulus : E [Pa]
        surface : the body's surface
        formulation : "paper", "consistent", "vector", "bem", "bem-sparse" or "mass-spring"
        rotation : of the vector form
        held : (N,) nodes that are fixed or moved, for the vector form
        poisson_ratio : nu of the body inside, for boundary elements; 1/2 is the fluid that keeps the volume

        Raises
        ------
        ParameterError
            E not positive, or an unknown formulation or rotation.
        """
        _check_rotation(rotation)
        if not (np.isfinite(youngs_modulus) and youngs_modulus > 0.0):
            raise ParameterError(f"youngs_modulus must be positive, not {youngs_modulus}")
        mu = youngs_modulus / 3.0
        told = partial(cls, youngs_modulus=float(youngs_modulus))
        radius = surface.equivalent_radius
        foundation, tension = BALL_FOUNDATION * mu / radius, BALL_TENSION * mu * radius
        if formulation == "paper":
            return told(
                bulk_modulus=bulk_modulus_from_foundation(foundation, surface),
                connectivity_modulus=connectivity_modulus_from_tension(tension, surface),
            )
        if formulation == "consistent":
            return told(foundation=foundation, surface_tension=tension)
        if formulation == "vector":
            if held is None or not held.any():
                return told(surface_tension=VECTOR_TENSION * mu * radius, rotation=rotation)
            grown = mu * np.sqrt(radius * distance_from_support(surface, held))
            return told(surface_tension=SUPPORTED_TENSION * grown, rotation=rotation)
        if formulation in ("bem", "bem-sparse"):
            return cls(
                shear_modulus=youngs_modulus / (2.0 * (1.0 + poisson_ratio)), poisson_ratio=poisson_ratio
            )
        if formulation in ISOTROPIC:
            return cls(shear_modulus=mu)
        raise ParameterError(
            f"unknown formulation {formulation!r}; use paper, consistent, vector, bem, bem-sparse or mass-spring"
        )

    def anisotropic(self, surface: SurfaceMesh, fibre: ArrayLike, contrast: float) -> Parameters:
        """The same material with a fibre direction (forms in ANISOTROPIC): moduli per node and per edge.

        An edge's modulus is multiplied by 1 + (c - 1) cos^2 of its angle to the fibre, a node's by the same
        function of its normal's angle. A body with c > 1 is stiffer along the fibre; with c < 1 it deforms along
        it more easily.

        Parameters
        ----------
        surface : the body's surface
        fibre : (3,) direction, of any length
        contrast : c, the modulus along the fibre over the one across it

        Raises
        ------
        ParameterError
            a zero direction, a contrast that is not positive, or a shear modulus, which is isotropic.
        """
        if self.shear_modulus is not None:
            raise ParameterError(
                f"the {' and '.join(ISOTROPIC)} formulations are isotropic; use another one for fibres"
            )
        direction = np.asarray(fibre, dtype=np.float64)
        length = float(np.linalg.norm(direction))
        if direction.shape != (3,) or not np.isfinite(length) or length == 0.0:
            raise ParameterError("the fibre direction must be three finite numbers, not all zero")
        if not (np.isfinite(contrast) and contrast > 0.0):
            raise ParameterError(f"contrast must be positive, not {contrast}")
        i, j = surface.edges.T
        along = surface.points[i] - surface.points[j]
        along /= np.linalg.norm(along, axis=1)[:, None]
        of_edge = 1.0 + (contrast - 1.0) * (along @ direction / length) ** 2
        of_node = 1.0 + (contrast - 1.0) * (surface.normals @ direction / length) ** 2
        changed: dict[str, Any] = {
            name: np.asarray(value) * (of_node if name in NODE_MODULI else of_edge)
            for name, value in self.moduli().items()
        }
        # the exact bendings are those of an isotropic tissue
        return replace(self, youngs_modulus=None, **changed)

    def moduli(self) -> dict[str, float | Array]:
        """The moduli that are set, by name."""
        values = {name: getattr(self, name) for name in MODULI}
        return {name: value for name, value in values.items() if value is not None}

    def record(self) -> dict[str, float | str]:
        """Scalars as they are and arrays by their mean, for the record of a run."""
        record: dict[str, float | str] = {
            name: float(np.mean(value)) for name, value in self.moduli().items()
        }
        if self.coarse_nodes is not None:
            record["coarse_nodes"] = float(self.coarse_nodes)
        if self.parts is not None:
            record["parts"] = float(self.parts)
        if self.tension_stiffening:
            record["tension_stiffening"] = self.tension_stiffening
        return record


def _check_rotation(rotation: str) -> None:
    if rotation == "nodal":
        raise ParameterError(f"rotation = 'nodal' {NO_NODAL}")
    if rotation not in ROTATIONS:
        raise ParameterError(f"rotation must be one of {', '.join(ROTATIONS)}, not {rotation!r}")


def _is_square_of_threes(shape: tuple[int, ...]) -> bool:
    return shape[0] == shape[1] and shape[0] % 3 == 0


def _not_negative(value: object) -> bool:
    array = np.asarray(value)
    return array.dtype.kind in "iuf" and bool(np.isfinite(array).all() and (array >= 0.0).all())


def ball_compliance(degree: int) -> float:
    """c_n mu / R of an incompressible ball: u_r = c_n P_n under the normal traction P_n(cos theta), n >= 2.

    c_n = n (2n + 1) / (2 (n - 1) (2n^2 + 4n + 3)): 0.26316, 0.15909, 0.11765, 0.09418 for n = 2..5.
    """
    n = degree
    return n * (2 * n + 1) / (2.0 * (n - 1) * (2 * n * n + 4 * n + 3))


def bulk_modulus_from_foundation(foundation: float, surface: SurfaceMesh) -> float:
    """B = k V / A [Pa]: the paper's B term is a foundation fixed in space, k = B A / V [Pa/m]."""
    return foundation * surface.volume / surface.area


def connectivity_modulus_from_tension(surface_tension: float, surface: SurfaceMesh) -> float:
    """B_ij = T (V / A) / (sqrt(3) A / N) [Pa], for a mesh of equal nodes with six neighbours each."""
    mean_nodal_area = surface.area / surface.n_nodes
    return surface_tension * (surface.volume / surface.area) / (np.sqrt(3.0) * mean_nodal_area)


def distance_from_support(surface: SurfaceMesh, held: NDArray[np.bool_]) -> Array:
    """(E,) distance of each edge from the nearest held node [m], at least half the edge's length.

    Near the rim of a support an elastic body moves as the root of the distance d. So does a skin with a tension
    proportional to that root: T u' is constant across the rim, u' ~ d^(-1/2). With a constant tension it moves as
    d, and holds the body upright where an elastic one rocks.
    """
    i, j = surface.edges.T
    # larger leaves and plain boxes give the same answers as the defaults, in three quarters of the time
    tree = cKDTree(surface.points[held], leafsize=32, compact_nodes=False)
    distance = np.asarray(tree.query(surface.points)[0])
    length = np.linalg.norm(surface.points[i] - surface.points[j], axis=1)
    return np.asarray(0.5 * np.maximum(distance[i] + distance[j], length))


def per_item(
    value: float | Array | None, name: str, count: int, formulation: str, default: float | None = None
) -> Array:
    """A scalar or array parameter as (count,) values; `default` stands for one that is not set.

    Raises
    ------
    ParameterError
        where it is missing or has another length.
    """
    if value is None and default is not None:
        return np.full(count, default)
    if value is None:
        raise ParameterError(
            f"the {formulation} formulation needs {name}; set it or use Parameters.from_tissue"
        )
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == 0:
        return np.full(count, float(array))
    if array.shape != (count,):
        raise ParameterError(f"{name} must be a scalar or have {count} entries, not shape {array.shape}")
    return array
