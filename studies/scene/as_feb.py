"""A scene for FEBio: linear tetrahedra of a compressible neo-Hookean law, format 4.0."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape  # that of XML loads what opens network addresses

import numpy as np

from solver_common.arrays import Array, Mask

from .handout import Handout, remarks

NAME = "FEBio (.feb, format 4.0)"
TAKES = frozenset({"dead forces"})  # of the extras of a study what it writes
_CONTROL = (
    "<Control><analysis>STATIC</analysis><time_steps>10</time_steps><step_size>0.1</step_size>"
    '<solver type="solid"><symmetric_stiffness>symmetric</symmetric_stiffness></solver></Control>'
)
_RAMP = (
    '<LoadData><load_controller id="1" type="loadcurve"><interpolate>LINEAR</interpolate>'
    "<points><pt>0,0</pt><pt>1,1</pt></points></load_controller></LoadData>"
)


def feb(body: Handout) -> str:
    """The scene as text. The weight is in its forces, and grows with them over ten steps."""
    force = np.where(body.held[:, None], 0.0, body.whole_force)
    sets = {"held": body.held & ~body.moved, "moved": body.moved, "loaded": np.any(force, axis=1)}
    sets = {name: mask for name, mask in sets.items() if mask.any()}
    told = "\n".join(
        escape(line, quote=False).replace("--", "- -") for line in (*remarks(body), "Its law is neo-Hookean.")
    )
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f"<!--\n{told}\n-->",
        '<febio_spec version="4.0">',
        '<Module type="solid"/>',
        _CONTROL,
        "<Globals><Constants><T>0</T><P>0</P><R>8.31446</R><Fc>96485.3</Fc></Constants></Globals>",
        f'<Material><material id="1" name="tissue" type="neo-Hookean"><density>{body.tissue.density!r}</density>'
        f"<E>{body.tissue.youngs_modulus!r}</E><v>{body.tissue.poisson_ratio!r}</v></material></Material>",
        "<Mesh>",
        '<Nodes name="body">',
        *(f'<node id="{k}">{_list(row)}</node>' for k, row in enumerate(body.mesh.points.tolist(), 1)),
        "</Nodes>",
        '<Elements type="tet4" name="part">',
        *(
            f'<elem id="{k}">{_list(row)}</elem>'
            for k, row in enumerate((body.mesh.tetrahedra + 1).tolist(), 1)
        ),
        "</Elements>",
        *(
            f'<NodeSet name="{name}">{_list((np.flatnonzero(mask) + 1).tolist())}</NodeSet>'
            for name, mask in sets.items()
        ),
        "</Mesh>",
        '<MeshDomains><SolidDomain name="part" mat="tissue"/></MeshDomains>',
        *_tables(body, force, sets),
        *_conditions(sets),
        _RAMP,
        '<Output><plotfile type="febio"><var type="displacement"/></plotfile>',
        '<logfile><node_data data="x;y;z;ux;uy;uz" delim="," file="displacement.txt"/></logfile></Output>',
        "</febio_spec>",
    ]
    return "\n".join([*lines, ""])


def _tables(body: Handout, force: Array, sets: dict[str, Mask]) -> list[str]:
    """Forces and displacements by node, each in the order of its node set."""
    lines = ["<MeshData>"]
    if "loaded" in sets:
        lines += _table("force", "loaded", "vec3", map(_list, force[sets["loaded"]].tolist()))
    if "moved" in sets:
        for axis, values in zip("xyz", body.displacement[sets["moved"]].T.tolist(), strict=True):
            lines += _table(f"move_{axis}", "moved", "scalar", map(repr, values))
    return [*lines, "</MeshData>"] if len(lines) > 1 else []


def _table(name: str, node_set: str, kind: str, values: Iterable[str]) -> list[str]:
    rows = [f'<node lid="{k}">{value}</node>' for k, value in enumerate(values, 1)]
    return [f'<NodeData name="{name}" node_set="{node_set}" data_type="{kind}">', *rows, "</NodeData>"]


def _conditions(sets: dict[str, Mask]) -> list[str]:
    """What is held, what is moved, what is pulled."""
    lines = ["<Boundary>"]
    if "held" in sets:
        fixed = "".join(f"<{axis}_dof>1</{axis}_dof>" for axis in "xyz")
        lines.append(f'<bc name="held" type="zero displacement" node_set="held">{fixed}</bc>')
    if "moved" in sets:
        lines += [
            f'<bc name="moved_{axis}" type="prescribed displacement" node_set="moved"><dof>{axis}</dof>'
            f'<value lc="1" type="map">move_{axis}</value><relative>0</relative></bc>'
            for axis in "xyz"
        ]
    lines.append("</Boundary>")
    if "loaded" in sets:
        value = '<value lc="1" type="map">force</value><relative>0</relative>'
        load = f'<nodal_load name="loaded" type="nodal_force" node_set="loaded">{value}</nodal_load>'
        lines.append(f"<Loads>{load}</Loads>")
    return lines


def _list(numbers: list[float] | list[int]) -> str:
    return ",".join(map(repr, numbers))
