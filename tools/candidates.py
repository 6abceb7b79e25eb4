"""Measures forms of the skin's elasticity and writes their table in `vdm/README.md`.

Every candidate is a quadratic energy of the surface nodes alone, here as a dense matrix on the coarse meshes of the
calibration studies. Its one or two parameters are fitted on the six training loads of a study, by the library's own
search, and its errors are those on the six loads held out. A surface may be named as argument: it goes through
`calibrate-organ` and gets a column of its own; columns of surfaces that are not named stay as they are.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy import linalg

from solver_common.arrays import Array, Mask
from tools import marked
from tools.accuracy import ROOT, STUDIES, as_per_cent
from vdm.boundary.operators import Facets, surface_stiffness
from vdm.formulations.vector import (
    block_diagonal,
    block_laplacian,
    edge_directions,
)
from vdm.material import SUPPORTED_TENSION, VECTOR_TENSION, distance_from_support
from vdm.surface import SurfaceMesh
from vdmbench.evidence.fit import Errors, Sample, Trial, least_error, loads_of, samples_of, split
from vdmbench.graph.plan import make_plan
from vdmbench.graph.run import Options, run_plan
from vdmbench.report.rebuild import rebuild
from vdmbench.study.config import expand, load_study

Build = Callable[["Body", Array], Array]

# beta of the rotations' own stiffness where it is not fitted
BETA = 0.01
README = ROOT / "vdm" / "README.md"
_PART = "candidates"


class Body:
    """The dense matrices of a surface's terms: (N, N) Laplacians, (3N, 3N) stiffnesses for a unit parameter."""

    def __init__(self, surface: SurfaceMesh, held: Mask) -> None:
        self.surface = surface
        self.held = held
        self.centred = surface.points - surface.points.mean(axis=0)
        separation = self.centred[:, None, :] - self.centred[None, :, :]
        self.distance = np.linalg.norm(separation, axis=2) + np.eye(surface.n_nodes)
        self.along = separation / self.distance[:, :, None]

    @cached_property
    def harmonic(self) -> Array:
        """(N, N) cotangent Laplacian."""
        return np.asarray(self.surface.laplacian(self.surface.cotangent_weights).toarray())

    @cached_property
    def membrane(self) -> Array:
        """Harmonic tension with one free rotation."""
        return self.with_global_rotation(self.harmonic)

    @cached_property
    def grown_membrane(self) -> Array:
        """The same with a tension sqrt(d / R), d the distance from the support."""
        surface = self.surface
        growth = np.sqrt(distance_from_support(surface, self.held) / surface.equivalent_radius)
        return self.with_global_rotation(surface.laplacian(growth * surface.cotangent_weights).toarray())

    @cached_property
    def stretch(self) -> Array:
        """E_s: edges as fibres."""
        directions = edge_directions(self.surface)
        blocks = np.einsum("e,ea,eb->eab", self.surface.cotangent_weights, directions, directions)
        return np.asarray(block_laplacian(self.surface, blocks).toarray())

    @cached_property
    def bending(self) -> Array:
        """Harmonic tension with a rotation at every node, whose differences cost BETA."""
        return self.with_nodal_rotations(1.0, BETA)

    @cached_property
    def half_order(self) -> Array:
        """A_i A_j / r^3 over all pairs, in every direction, with one free rotation."""
        return self.with_global_rotation(_laplacian(self._pairs(3)))

    @cached_property
    def fibres_3(self) -> Array:
        """Fibres between all pairs, A_i A_j / r^3."""
        return self._fibres(3)

    @cached_property
    def fibres_4(self) -> Array:
        """Fibres between all pairs, A_i A_j / r^4, made of the same unit by the body's size."""
        return self.surface.volume ** (1.0 / 3.0) * self._fibres(4)

    def with_global_rotation(self, laplacian: Array) -> Array:
        """(3N, 3N) of a Laplacian in every direction, less what the best rotation of the body takes off."""
        turns = np.stack([np.cross(axis, self.centred).reshape(-1) for axis in np.eye(3)], axis=1)
        stiffness = np.kron(laplacian, np.eye(3))
        force = stiffness @ turns
        return np.asarray(stiffness - force @ linalg.solve(turns.T @ force, force.T, assume_a="pos"))

    def with_nodal_rotations(self, tension: float, bending: float) -> Array:
        """(3N, 3N) of a tension about a rotation of every node, whose differences along edges cost `bending`."""
        surface = self.surface
        weights = surface.cotangent_weights
        inertia = _edge_inertia(surface, weights).reshape(-1, 9)
        i, j = surface.edges.T
        touching = np.zeros((surface.n_nodes, 9))
        np.add.at(touching, i, inertia)
        np.add.at(touching, j, inertia)
        # an edge counts half at either end
        coupling = 0.5 * tension * _turning(surface, weights)
        rotations = block_diagonal(0.5 * tension * touching.reshape(-1, 3, 3)).toarray()
        rotations += bending * surface.volume ** (2.0 / 3.0) * np.kron(self.harmonic, np.eye(3))
        relief = coupling.T @ linalg.solve(rotations, coupling, assume_a="pos")
        return np.asarray(tension * np.kron(self.harmonic, np.eye(3)) - relief)

    def _pairs(self, exponent: int) -> Array:
        areas = self.surface.nodal_areas
        weights: Array = areas[:, None] * areas[None, :] / self.distance**exponent
        np.fill_diagonal(weights, 0.0)
        return weights

    def _fibres(self, exponent: int) -> Array:
        n = self.surface.n_nodes
        blocks = np.einsum("ij,ija,ijb->iajb", self._pairs(exponent), self.along, self.along)
        stiffness = -blocks
        node = np.arange(n)
        stiffness[node, :, node, :] += blocks.sum(axis=2)
        return np.asarray(stiffness.reshape(3 * n, 3 * n))


def _laplacian(weights: Array) -> Array:
    return np.asarray(np.diag(weights.sum(axis=1)) - weights)


def _edge_inertia(surface: SurfaceMesh, weights: Array) -> Array:
    """(E, 3, 3) w (|d|^2 I - d d^T): the quadratic form of omega -> w |omega x d|^2."""
    d = _edge_vectors(surface)
    square = np.einsum("ec,ec->e", d, d)
    form = square[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :]
    return np.asarray(weights[:, None, None] * form)


def _turning(surface: SurfaceMesh, weights: Array) -> Array:
    """(3N, 3N) u -> sum_j w_ij d_ij x (u_i - u_j), the moment of the tension about node i."""
    n = surface.n_nodes
    turning = np.zeros((n, 3, n, 3))
    for (i, j), (x, y, z) in zip(surface.edges, weights[:, None] * _edge_vectors(surface), strict=True):
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        for node in (i, j):
            turning[node, :, i] += cross
            turning[node, :, j] -= cross
    return turning.reshape(3 * n, 3 * n)


def _edge_vectors(surface: SurfaceMesh) -> Array:
    """(E, 3) x_i - x_j [m]."""
    i, j = surface.edges.T
    return np.asarray(surface.points[i] - surface.points[j])


@dataclass(frozen=True)
class Candidate:
    """A form of the skin's elasticity.

    Attributes
    ----------
    name : in the table
    fitted : how many parameters are fitted; none where the shear modulus says it all
    unknowns : what a frame has to solve: sparse, or a full matrix
    build : of the body and its parameters over mu (and R, where they are tensions): (3N, 3N), mu = 1
    """

    name: str
    fitted: int
    unknowns: str
    build: Build


def _radius(body: Body) -> float:
    return body.surface.equivalent_radius


CANDIDATES = (
    Candidate(
        "constant T, by rule",
        0,
        "sparse, N",
        lambda b, _: VECTOR_TENSION * _radius(b) * b.membrane,
    ),
    Candidate("constant T", 1, "sparse, N", lambda b, c: c[0] * _radius(b) * b.membrane),
    Candidate(
        "T growing from the support, by rule",
        0,
        "sparse, N",
        lambda b, _: SUPPORTED_TENSION * _radius(b) * b.grown_membrane,
    ),
    Candidate(
        "T growing from the support", 1, "sparse, N", lambda b, c: c[0] * _radius(b) * b.grown_membrane
    ),
    Candidate(
        "T growing from the support + E_s",
        2,
        "sparse, 3N",
        lambda b, c: _radius(b) * (c[0] * b.grown_membrane + c[1] * b.stretch),
    ),
    Candidate(
        "constant T + E_s",
        2,
        "sparse, 3N",
        lambda b, c: _radius(b) * (c[0] * b.membrane + c[1] * b.stretch),
    ),
    Candidate(
        "rotations with stiffness",
        2,
        "sparse, 6N",
        lambda b, c: _radius(b) * b.with_nodal_rotations(c[0], BETA * c[1]),
    ),
    Candidate("half-order, mu/pi", 0, "full", lambda b, _: b.half_order / np.pi),
    Candidate("half-order", 1, "full", lambda b, c: c[0] * b.half_order / np.pi),
    Candidate("fibres q = 3", 1, "full", lambda b, c: c[0] * b.fibres_3),
    Candidate("fibres q = 4", 1, "full", lambda b, c: c[0] * b.fibres_4),
    Candidate("fibres q = 3 and 4", 2, "full", lambda b, c: c[0] * b.fibres_3 + c[1] * b.fibres_4),
    Candidate(
        "fibres q = 3 + harmonic", 2, "full", lambda b, c: c[0] * b.fibres_3 + c[1] * _radius(b) * b.membrane
    ),
    Candidate(
        "fibres q = 4 + harmonic", 2, "full", lambda b, c: c[0] * b.fibres_4 + c[1] * _radius(b) * b.membrane
    ),
    Candidate(
        "fibres q = 3 + rotations with stiffness",
        2,
        "full",
        lambda b, c: c[0] * b.fibres_3 + c[1] * _radius(b) * b.bending,
    ),
    Candidate(
        "boundary integrals",
        0,
        "full",
        lambda b, _: surface_stiffness(Facets.of(b.surface.points, b.surface.triangles), 0.5),
    ),
)


class CandidateTrial(Trial):
    """A candidate on the loads of one body, as the library's search wants it: parameters are over mu."""

    def __init__(self, candidate: Candidate, body: Body, samples: Sequence[Sample]) -> None:
        self.name = candidate.name
        self.names = ["parameter"] * candidate.fitted
        self.samples = tuple(samples)
        self._build = candidate.build
        self._body = body
        self._shear_modulus = samples[0].scene.tissue.youngs_modulus / 3.0

    def answers(self, multiples: Array) -> list[Array]:
        """Displacements (N, 3) under the loads, held nodes and volume exact."""
        free = np.repeat(~self.samples[0].scene.held, 3)
        stiffness = self._shear_modulus * self._build(self._body, multiples)[np.ix_(free, free)]
        gradient = self._body.surface.area_vectors.reshape(-1)[free]
        loads = np.stack([sample.scene.contact_force.reshape(-1)[free] for sample in self.samples], axis=1)
        solved = linalg.solve(stiffness, np.column_stack([gradient, loads]), assume_a="pos")
        swollen, moved = solved[:, :1], solved[:, 1:]
        moved -= swollen * (gradient @ moved) / (gradient @ swollen)
        answers = np.zeros((len(self.samples), free.size))
        answers[:, free] = moved.T
        return list(answers.reshape(len(self.samples), -1, 3))


def errors_of(
    candidate: Candidate, training: Sequence[Sample], held_out: Sequence[Sample], body: Body
) -> Errors:
    """Errors on the loads held out, fitted on the others."""
    fitted = np.ones(0)
    if candidate.fitted:
        fitted = least_error(CandidateTrial(candidate, body, training)).multiples
    return CandidateTrial(candidate, body, held_out).errors(fitted)


def column_of(study: str, surface: Path | None = None) -> dict[str, str]:
    """What the table's column of one calibration study says, by candidate."""
    path = ROOT / "studies" / "cases" / f"{study}.toml"
    loaded = load_study(path, surface=surface)
    results = Path(os.environ.get("VDMBENCH_RESULTS", "results"))
    plan = make_plan(loaded, expand(loaded), results / "runs" / loaded.study.name, results / "cache")
    run, _ = run_plan(plan, path.read_text(encoding="utf-8"), Options(jobs=1), lambda _: None, rebuild)
    count = loaded.calibration.training if loaded.calibration else None
    training, held_out = split(samples_of(plan, run), len(loads_of(plan)), count)
    mesh = training[0].scene.mesh
    body = Body(SurfaceMesh(mesh.surface_points, mesh.triangles), training[0].scene.held)
    return {c.name: _cell(errors_of(c, training, held_out, body)) for c in CANDIDATES}


def _cell(errors: Errors) -> str:
    mean, worst = (
        " / ".join(map(as_per_cent, pair))
        for pair in (
            (errors.vector, errors.deformation),
            (errors.vector_worst, errors.deformation_worst),
        )
    )
    return f"{mean} ({worst})"


def table_in_readme() -> dict[str, dict[str, str]]:
    """The columns that `vdm/README.md` shows now: body -> candidate -> cell."""
    head, *rows = marked.cells(marked.shown(README, _PART))
    return {body: {row[0]: row[k] for row in rows} for k, body in enumerate(head) if k >= len(_HEAD)}


_HEAD = ("candidate", "fitted", "matrix")


def written(columns: dict[str, dict[str, str]]) -> str:
    """The table as Markdown."""
    return marked.table(
        [*_HEAD, *columns],
        (
            [c.name, str(c.fitted), c.unknowns, *(column[c.name] for column in columns.values())]
            for c in CANDIDATES
        ),
    )


def main() -> None:
    """Run the calibration studies, fit every candidate on each and write the table."""
    columns = table_in_readme()
    for body in STUDIES:
        columns[body] = column_of(f"calibrate-{body}")
    for argument in sys.argv[1:]:
        surface = Path(argument).resolve()
        columns[surface.stem] = column_of("calibrate-organ", surface)
    marked.show(README, _PART, written(columns))


if __name__ == "__main__":
    main()
