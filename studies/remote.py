"""The process that a worker of a cluster starts for some groups of cases, to run them as a run here does.

It is given the path of a request (see `studies.cluster`) and ends when its standard input is closed, as it is when
the worker dies or the run is over. What becomes of each case goes to the journal that the request names.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from .execute import AGAIN, Group, Outcome, Task, run_tasks
from .journal import Journal
from .server import start_server
from .worker import run_case, share

ATTEMPTS = 3  # times that one case may be begun where workers die
_REMEDY = "use a coarser mesh, or workers with more memory; see the cluster's own logs"


def main() -> None:
    """Serve the one request, then end."""
    signal.signal(signal.SIGTERM, _interrupt)
    request = json.loads(Path(sys.argv[1]).read_text())
    start_server()  # while there is one thread
    threading.Thread(target=_end_with_input, daemon=True).start()
    try:
        serve(request)
    except KeyboardInterrupt:
        return  # nobody waits for an answer any more


def serve(request: dict[str, Any]) -> None:
    """Do the tasks of a request that its journal has no outcome of. Raises OSError where it cannot be written."""
    journal = Journal(Path(request["journal"]))
    list(journal.news())
    left = [task for task in request["tasks"] if task["id"] not in journal.finished]
    for task in [task for task in left if journal.begun[task["id"]] >= ATTEMPTS]:
        left.remove(task)
        message = f"its worker was lost {ATTEMPTS} times while this case was at work"
        journal.add(record(Outcome(task, "crashed", 0.0, message, _REMEDY)))

    def started(task: Task) -> None:
        journal.add({"begun": task["id"]})

    with tempfile.TemporaryDirectory(prefix="vdmbench-") as logs:
        outcomes = run_tasks(
            run_case,
            _groups(left, journal),
            together=share,
            jobs=1,
            log_directory=Path(logs),
            timeout=request["timeout"],
            memory=request["memory"],
            started=started,
        )
        for outcome in outcomes:
            journal.add(record(outcome))


def record(outcome: Outcome) -> dict[str, Any]:
    """An outcome as it is kept in a journal."""
    kept = ("code", "seconds", "message", "remedy", "log")
    return {"id": outcome.task["id"], **{name: getattr(outcome, name) for name in kept}}


def _groups(tasks: Sequence[Task], journal: Journal) -> list[Group]:
    """Cases that a worker died at go alone; the others stay in their groups."""
    groups: dict[str, list[Task]] = {}
    died = bool(journal.begun)
    for task in tasks:
        place = task["id"] if journal.begun[task["id"]] else f"{task['group']}"
        groups.setdefault(place, []).append({**task, AGAIN: True} if died else task)
    return list(groups.values())


def _end_with_input() -> None:
    os.read(0, 1)  # not by sys.stdin, whose lock this thread would hold when the main thread ends
    os.kill(os.getpid(), signal.SIGTERM)


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
