"""Linear elasticity on the tetrahedra of `vdmbench export`, from out to theirs.csv: what `fem-p1` says."""

import json
from pathlib import Path

import meshio
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

scene, mesh = json.loads(Path("out/scene.json").read_text()), meshio.read("out/mesh.vtu")
x, tets, tissue = mesh.points, mesh.cells_dict["tetra"], scene["tissue"]
E, nu = tissue["youngs_modulus"], tissue["poisson_ratio"]
mu, lame = E / (2 + 2 * nu), E * nu / (1 + nu) / (1 - 2 * nu)
edges = x[tets[:, 1:]] - x[tets[:, :1]]
volume, inside = np.linalg.det(edges) / 6, np.linalg.inv(edges).swapaxes(1, 2)
g = np.concatenate([-inside.sum(1, keepdims=True), inside], axis=1)  # gradients of the shape functions
one = np.einsum("e,eai,ebj->eaibj", lame * volume, g, g) + np.einsum("e,eaj,ebi->eaibj", mu * volume, g, g)
one += np.einsum("e,eak,ebk,ij->eaibj", mu * volume, g, g, np.eye(3))
dof = (3 * tets[:, :, None] + np.arange(3)).reshape(len(tets), 12)
K = coo_array((one.ravel(), (dof.repeat(12, axis=1).ravel(), np.tile(dof, 12).ravel()))).tocsr()
f, u, free = np.zeros_like(x), np.zeros_like(x), np.ones(x.shape, dtype=bool)
np.add.at(f, tets, (tissue["density"] * volume / 4)[:, None, None] * np.array(scene["gravity"]))
f[scene["forces"]["points"]] += scene["forces"]["force"]
u[scene["held"]["points"]], free[scene["held"]["points"]] = scene["held"]["displacement"], False
k = free.ravel()
u[free] = spsolve(K[k][:, k], f[free] - K[k][:, ~k] @ u[~free])
table = np.column_stack([np.arange(len(scene["surface_points"])), u[scene["surface_points"]]])
head = "node,displacement_x,displacement_y,displacement_z"
np.savetxt("theirs.csv", table, fmt=["%d"] + 3 * ["%.17g"], delimiter=",", header=head, comments="")
