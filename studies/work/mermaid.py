"""The graph of a plan as a picture: text for Mermaid, which GitHub and most wikis draw."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from .nodes import Node, graph
from .plan import Plan, PlannedCase

MOST_NODES = 24  # that are drawn one by one; of more those alike are drawn as one, with their number
_MOST_NAMES = 3  # of the cases of a node
_ENTITIES = str.maketrans({"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "&": "#amp;", "\n": " "})
_STORE, _WORK, _END = '[("{}")]', '["{}"]', '(["{}"])'
_SHAPES = {"mesh": _STORE, "level": _STORE, "answers": _WORK, "limits": _WORK, "cases": _END}

Users = Mapping[str, Sequence[PlannedCase]]


def mermaid(plan: Plan) -> str:
    """The nodes of a plan that are to be done, what each needs, and which cases share it."""
    nodes = graph(plan, plan.cases_to_run(), 1, run="")
    users = _users(nodes)
    own: dict[str, str] = {}
    lines = ["flowchart LR"]
    for number, group in enumerate(_groups(nodes), start=1):
        own |= {node.id: f"n{number}" for node in group}
        text = "<br>".join(line.translate(_ENTITIES) for line in _label(group, plan, users))
        lines.append(f"  n{number}{_SHAPES[group[0].kind].format(text)}")
    lines.append('  report(["tables and report"])')
    order = {identity: place for place, identity in enumerate(own)}
    edges = [
        (own[need], own[node.id]) for node in nodes for need in sorted(node.needs, key=order.__getitem__)
    ]
    edges += [(own[node.id], "report") for node in nodes if node.kind == "cases"]
    return "\n".join([*lines, *(f"  {start} --> {end}" for start, end in dict.fromkeys(edges))])


def _groups(nodes: Sequence[Node]) -> list[list[Node]]:
    """The nodes one by one, or, where there are too many, those of one kind, model and level together."""
    groups: dict[object, list[Node]] = defaultdict(list)
    for node in nodes:
        alike = (node.kind, node.payload.get("name"), node.payload.get("level"))
        groups[node.id if len(nodes) <= MOST_NODES else alike].append(node)
    return list(groups.values())


def _users(nodes: Sequence[Node]) -> Users:
    """Node -> the cases that need it, directly or not."""
    known = {node.id: node for node in nodes}
    users: dict[str, list[PlannedCase]] = defaultdict(list)
    for node in nodes:
        behind, found = set(node.needs), set[str]()
        while behind:
            found |= behind
            behind = {need for one in behind for need in known[one].needs} - found
        for need in found:
            users[need] += node.items
    return users


def _label(group: Sequence[Node], plan: Plan, users: Users) -> list[str]:
    """What some nodes that are alike are, and what is shared of them, in lines."""
    first, number = group[0], len(group)
    if first.kind == "cases":
        names = [case.label or plan.study.study.name for node in group for case in node.items]
        return [*_count(len(names), "case"), *(names if len(names) <= _MOST_NAMES else [])]
    cases = {case.hash: case for node in group for case in users[node.id]}
    if first.kind != "answers":
        what = [first.label if number == 1 else f"{number:,} of kind {first.kind}"]
    else:
        level = " refined" if first.payload["level"] else ""
        asked = sum(len(node.payload["asked"]) for node in group)
        set_ups = [f"{number:,} set-ups"] if number > 1 else []
        what = [f"{first.payload['name']}{level}", *_in_common(list(cases.values())), *set_ups]
        what += _count(asked, "load")
    return what + [f"for {line}" for line in _count(len(cases), "case")]


def _in_common(cases: Sequence[PlannedCase]) -> list[str]:
    """What the labels of all these cases say, in one line."""
    parts = [case.label.split(", ") for case in cases]
    shared = [part for part in parts[0] if part and all(part in other for other in parts)]
    return [", ".join(shared)] if shared else []


def _count(number: int, what: str) -> list[str]:
    """Of several their number, of one nothing."""
    return [f"{number:,} {what}s"] if number > 1 else []
