"""Does the nodes of a graph, each as soon as those that it needs are done, in the places that there are.

A place is a process that does one node after the other (`vdmbench.work.local`), here or on a cluster
(`vdmbench.work.cluster`). A node that fails costs what needs it, and nothing else. A process that dies costs the
node that it was at, which is tried again, `ATTEMPTS` times in all; of several cases each goes on alone.
"""

from __future__ import annotations

import heapq
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Protocol

from .nodes import Node, one_by_one
from .worker import ATTEMPTS, WHERE, Said

_LOOK = 1.0  # s between looks at what the nodes at work say of where they are


class Places(Protocol):
    """Where nodes are done."""

    @property
    def count(self) -> int:
        """How many at once."""

    def submit(self, node: str, log: Path, seconds: float | None) -> Future[str]:
        """Do a node, given as JSON, in `seconds` at most; raises through the future, see `failure`."""

    def failure(self, error: BaseException, log: str) -> Said:
        """What an error of a future means; "crashed" where its process died, and it may be tried again."""


@dataclass(frozen=True)
class Outcome:
    """What became of a node, or of one case."""

    kind: str
    id: str
    label: str
    said: Said

    @property
    def ok(self) -> bool:
        """Whether it is done."""
        return self.said.code == "done"


def run_nodes(
    nodes: Sequence[Node],
    places: Places,
    logs: Path,
    *,
    timeout: float | None = None,
    fail_fast: bool = False,
    started: Callable[[Node], None],
    where: Callable[[Node, str], None] = lambda *_: None,
) -> Iterator[Outcome]:
    """Do all nodes, yielding outcomes as they come: one per case of "cases", else one per node.

    Parameters
    ----------
    logs : directory for what the nodes print, kept only of what fails
    timeout : seconds for one node, or for each case of one
    where : is told where a node at work is, each time that it has said something new
    """
    order = {node.id: place for place, node in enumerate(nodes)}
    known = {node.id: node for node in nodes}
    sorter = TopologicalSorter({node.id: node.needs & known.keys() for node in nodes})
    sorter.prepare()
    ready: list[tuple[int, str]] = []
    failed: dict[str, Said] = {}
    at_work: dict[Future[str], Node] = {}
    attempts: Counter[str] = Counter()
    again: list[str] = []  # whose process died
    places_told: dict[str, str] = {}
    logs.mkdir(parents=True, exist_ok=True)

    def submit(node: Node) -> None:
        attempts[node.id] += 1
        log = logs / f".{_safe(node.id)}.log"
        text = json.dumps({"id": node.id, "kind": node.kind, "payload": node.payload, "log": str(log)})
        seconds = timeout * max(1, len(node.items)) if timeout is not None else None
        at_work[places.submit(text, log, seconds)] = node

    def finish(node: Node) -> None:
        if node.id in order:
            sorter.done(node.id)

    while sorter.is_active() or at_work or again:
        for identity in sorter.get_ready() if sorter.is_active() else ():
            heapq.heappush(ready, (order[identity], identity))
        while (again or ready) and len(at_work) < places.count:
            node = known[again.pop() if again else heapq.heappop(ready)[1]]
            cause = next((failed[need] for need in sorted(node.needs) if need in failed), None)
            if cause is None:
                started(node)
                submit(node)
                continue
            failed[node.id] = cause
            finish(node)
            for outcome in _outcomes(node, [], cause):
                yield outcome
                if fail_fast:
                    return
            for identity in sorter.get_ready():
                heapq.heappush(ready, (order[identity], identity))
        if not at_work:
            continue
        finished, working = wait(at_work, _LOOK, return_when=FIRST_COMPLETED)
        for future in working:
            node = at_work[future]
            line = _last_place(logs / f".{_safe(node.id)}.log")
            if line != places_told.get(node.id, ""):
                places_told[node.id] = line
                where(node, line)
        for future in finished:
            node = at_work.pop(future)
            log = logs / f".{_safe(node.id)}.log"
            said, cause = _answer(future, places, log)
            log.unlink(missing_ok=True)
            if cause is not None and cause.code == "crashed" and attempts[node.id] < ATTEMPTS:
                alone = one_by_one(node) if len(node.items) > 1 else [node]
                known |= {each.id: each for each in alone}
                again += [each.id for each in alone]
                if alone != [node]:
                    finish(node)
                continue
            for outcome in _outcomes(node, said, cause):
                if not outcome.ok:
                    failed.setdefault(node.id, outcome.said)
                yield outcome
                if fail_fast and not outcome.ok:
                    return
            finish(node)


def _answer(future: Future[str], places: Places, log: Path) -> tuple[list[Said], Said | None]:
    """What a node said, and what kept it from saying anything."""
    error = future.exception()
    if error is not None:
        return [], places.failure(error, _read(log))
    said = [Said(**one) for one in json.loads(future.result())]
    said = [one if one.code == "done" else replace(one, log=_read(log)) for one in said]
    whole = next((one for one in said if not one.id), None)
    return ([], whole) if whole is not None else (said, None)


def _outcomes(node: Node, said: Sequence[Said], cause: Said | None) -> Iterator[Outcome]:
    """One outcome per case, or one of the node: what it said, else the cause why it said nothing."""
    found = {one.id: one for one in said}
    names = [(case.hash, case.label) for case in node.items] or [(node.id, node.label)]
    for identity, label in names:
        one = found.get(identity) or cause
        if one is None:
            one = Said(identity, "error", 0.0, "it gave no answer", "this is a bug: please report it")
        yield Outcome(node.kind, identity, label, replace(one, id=identity))


def _read(log: Path) -> str:
    try:
        return log.read_text(errors="replace")
    except OSError:
        return ""


def _last_place(log: Path) -> str:
    """Where a node at work said last that it is; "" where it said nothing."""
    lines = re.findall(f"{WHERE}(.*)\n", _read(log))
    return lines[-1] if lines else ""


def _safe(identity: str) -> str:
    return identity.replace(" ", "-")[:120]
