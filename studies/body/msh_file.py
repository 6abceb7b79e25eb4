"""MSH files of gmsh, versions 2 and 4.1, text and binary, with their physical groups: numpy only.

A reader of our own, because the others were seen to fail where it matters: gmsh runs what is not one of its
mesh files as a script and lets a damaged count exhaust the memory; meshio loses groups that overlap.
Format: gmsh reference manual, "MSH file format" and "MSH file format version 2 (Legacy)".
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_common.arrays import Array, Index, Mask

from ..study.errors import MeshError
from .numbers_in_file import Numbers

_TETRAHEDRON = 4
# gmsh's number of each first-order element type -> its dimension and number of nodes
_ELEMENTS = {15: (0, 1), 1: (1, 2), 2: (2, 3), 3: (2, 4), _TETRAHEDRON: (3, 4)}
_OTHER_ELEMENTS = {
    5: "hexahedron",
    6: "prism",
    7: "pyramid",
    9: "second-order triangle",
    11: "second-order tetrahedron",
}
_DIMENSIONS = ("point", "curve", "surface", "volume")
_PHYSICAL_NAME = re.compile(r'^\s*([0-3])\s+(\d+)\s+"(.*)"\s*$')


_SECTION_MISSING = "is truncated or has no complete {} section; write it again"


@dataclass(frozen=True)
class _Block:
    """Elements of one type in the same physical groups."""

    kind: int
    physical: tuple[int, ...]
    nodes: Index  # (n, k) node tags


def read_msh(path: Path) -> tuple[Array, Index, dict[str, Mask]]:
    """Points (n, 3), tetrahedra (m, 4) and physical groups as masks (n,) over the points.

    A group without a name is called by its dimension and number, as in `surface-3`; of two groups with one
    name the lower dimension counts. Raises MeshError for a file that is damaged, truncated, of another
    version or byte order, or holds other cells than first-order tetrahedra, triangles, quadrangles, lines
    and points.
    """
    data = path.read_bytes()
    if not data.startswith((b"$MeshFormat", b"$Comments")):
        raise MeshError("is not a mesh file of gmsh")
    modern, binary = _format(_section(data, "MeshFormat"))
    if modern:
        tags, points = _nodes_4(Numbers(_section(data, "Nodes"), binary=binary))
        physical = _physical_of_entities(data, binary)
        blocks = _elements_4(Numbers(_section(data, "Elements"), binary=binary), physical)
    else:
        tags, points = _nodes_2(_section(data, "Nodes"), binary)
        blocks = (_elements_2_binary if binary else _elements_2_text)(_section(data, "Elements"))
    order = np.argsort(tags, kind="stable")
    tags, points = tags[order], points[order]
    if len(tags) == 0 or (np.diff(tags) == 0).any():
        raise MeshError("is damaged: it has no nodes, or two with one number")
    blocks = [_Block(block.kind, block.physical, _rows_of(block.nodes, tags)) for block in blocks]
    found = [block.nodes for block in blocks if block.kind == _TETRAHEDRON]
    tetrahedra = np.concatenate([np.empty((0, 4), dtype=np.int64), *found])
    return points, tetrahedra, _groups(blocks, len(points), _physical_names(data))


def _section(data: bytes, name: str, *, optional: bool = False) -> bytes:
    """What stands between the lines $name and $Endname."""
    start = re.search(rb"(?:^|\n)\$" + name.encode() + rb"[ \t\r]*\n", data)
    end = data.find(b"$End" + name.encode(), start.end()) if start else -1
    if start is None or end < 0:
        if optional and start is None:
            return b""
        raise MeshError(_SECTION_MISSING.format(name))
    return data[start.end() : end]


def _format(body: bytes) -> tuple[bool, bool]:
    """Whether the version is 4.1 (else 2) and whether the file is binary."""
    line, _, rest = body.partition(b"\n")
    words = line.split()
    version = words[0].decode("ascii", "replace") if words else ""
    if version != "4.1" and not re.fullmatch(r"2(\.[0-2])?", version):
        raise MeshError(f"has version {version[:10]!r}; write it as MSH 4.1 or 2.2")
    if len(words) != 3 or words[1] not in (b"0", b"1") or words[2] != b"8":
        raise MeshError("has an unknown format line; write it as MSH 4.1 or 2.2")
    binary = words[1] == b"1"
    if binary and rest[:4] != (1).to_bytes(4, "little"):
        raise MeshError("has the byte order of another machine; write it as text")
    return version == "4.1", binary


def _nodes_4(numbers: Numbers) -> tuple[Index, Array]:
    n_blocks, n_nodes = numbers.integers("u8", 4)[:2].tolist()
    tags, points = [], []
    for _ in range(n_blocks):
        dim, _, parametric = numbers.integers("i4", 3).tolist()
        count = numbers.integer("u8")
        tags.append(numbers.integers("u8", count))
        width = 3 + (dim if parametric else 0)
        points.append(numbers.reals("f8", count * width).reshape(count, width)[:, :3])
    if sum(map(len, tags)) != n_nodes or not n_nodes:
        raise MeshError(_SECTION_MISSING.format("Nodes"))
    return np.concatenate(tags), np.concatenate(points)


def _nodes_2(body: bytes, binary: bool) -> tuple[Index, Array]:
    count, rest = _count_line(body)
    fields = Numbers(rest, binary=binary).records([("tag", "i4", 1), ("point", "f8", 3)], count)
    return fields["tag"][:, 0].astype(np.int64), fields["point"].astype(np.float64)


def _physical_of_entities(data: bytes, binary: bool) -> dict[tuple[int, int], tuple[int, ...]]:
    """(dimension, entity) -> its physical groups; empty where the file lists no entities."""
    numbers = Numbers(_section(data, "Entities", optional=True), binary=binary)
    physical: dict[tuple[int, int], tuple[int, ...]] = {}
    if not numbers.left:
        return physical
    for dim, count in enumerate(numbers.integers("u8", 4).tolist()):
        for _ in range(count):
            tag = numbers.integer("i4")
            numbers.reals("f8", 6 if dim else 3)  # bounding box, or the point
            groups = numbers.integers("i4", numbers.integer("u8"))
            physical[dim, tag] = tuple(np.abs(groups).tolist())
            if dim:
                numbers.integers("i4", numbers.integer("u8"))  # bounding entities
    return physical


def _elements_4(numbers: Numbers, physical: Mapping[tuple[int, int], tuple[int, ...]]) -> list[_Block]:
    n_blocks, n_elements = numbers.integers("u8", 4)[:2].tolist()
    blocks = []
    for _ in range(n_blocks):
        dim, entity, kind = numbers.integers("i4", 3).tolist()
        count, width = numbers.integer("u8"), 1 + _nodes_of(kind)
        rows = numbers.integers("u8", count * width).reshape(count, width)
        blocks.append(_Block(kind, physical.get((dim, entity), ()), rows[:, 1:]))
    if sum(len(block.nodes) for block in blocks) != n_elements:
        raise MeshError(_SECTION_MISSING.format("Elements"))
    return blocks


def _elements_2_text(body: bytes) -> list[_Block]:
    """Each element: number, type, how many tags, tags (the first is its group, 0 for none), nodes."""
    count, rest = _count_line(body)
    numbers = Numbers(rest, binary=False)
    words = numbers.integers("i4", numbers.left).tolist()
    gathered: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
    at = 0
    for _ in range(count):
        if at + 3 > len(words):
            raise MeshError(_SECTION_MISSING.format("Elements"))
        _, kind, n_tags = words[at : at + 3]
        start, at = at + 3, at + 3 + n_tags + _nodes_of(kind)
        if n_tags < 0 or at > len(words):
            raise MeshError(_SECTION_MISSING.format("Elements"))
        gathered[kind, abs(words[start]) if n_tags else 0] += words[start + n_tags : at]
    return [
        _Block(kind, (group,) if group else (), np.array(nodes, dtype=np.int64).reshape(-1, _nodes_of(kind)))
        for (kind, group), nodes in gathered.items()
    ]


def _elements_2_binary(body: bytes) -> list[_Block]:
    """Runs of elements under a header of type, length and number of tags."""
    count, rest = _count_line(body)
    numbers = Numbers(rest, binary=True)
    blocks = []
    while count > 0:
        kind, length, n_tags = numbers.integers("i4", 3).tolist()
        if length <= 0 or n_tags < 0:
            raise MeshError(_SECTION_MISSING.format("Elements"))
        width = 1 + n_tags + _nodes_of(kind)
        rows = numbers.integers("i4", length * width).reshape(length, width)
        groups = np.abs(rows[:, 1]) if n_tags else np.zeros(length, dtype=np.int64)
        for group in np.unique(groups).tolist():
            blocks.append(_Block(kind, (group,) if group else (), rows[groups == group, 1 + n_tags :]))
        count -= length
    return blocks


def _count_line(body: bytes) -> tuple[int, bytes]:
    """The number on the first line, and what follows."""
    line, _, rest = body.partition(b"\n")
    return Numbers(line, binary=False).integer("i4"), rest


def _nodes_of(kind: int) -> int:
    if kind not in _ELEMENTS:
        name = _OTHER_ELEMENTS.get(kind, f"type {kind}")
        raise MeshError(f"holds {name} cells; only four-node (first-order) tetrahedra can be used")
    return _ELEMENTS[kind][1]


def _rows_of(node_tags: Index, tags: Index) -> Index:
    """Positions of node tags in the ascending `tags`."""
    rows = np.searchsorted(tags, node_tags).clip(max=len(tags) - 1)
    if not np.array_equal(tags[rows], node_tags):
        raise MeshError("is damaged: elements name nodes that do not exist")
    return rows.astype(np.int64)


def _physical_names(data: bytes) -> dict[tuple[int, int], str]:
    """(dimension, group) -> name."""
    body = _section(data, "PhysicalNames", optional=True)
    try:
        lines = body.decode("utf-8").splitlines()[1:]
    except UnicodeDecodeError as error:
        raise MeshError("has names of physical groups that are not UTF-8") from error
    matches = [_PHYSICAL_NAME.match(line) for line in lines]
    return {(int(match[1]), int(match[2])): match[3] for match in matches if match}


def _groups(blocks: list[_Block], n_points: int, names: Mapping[tuple[int, int], str]) -> dict[str, Mask]:
    members: defaultdict[tuple[int, int], Mask] = defaultdict(lambda: np.zeros(n_points, dtype=bool))
    for block in blocks:
        for group in block.physical:
            members[_ELEMENTS[block.kind][0], group][block.nodes.ravel()] = True
    groups: dict[str, Mask] = {}
    for (dim, group), mask in sorted(members.items(), key=lambda item: item[0]):
        groups.setdefault(names.get((dim, group)) or f"{_DIMENSIONS[dim]}-{group}", mask)
    return groups
