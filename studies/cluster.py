"""Runs cases on an existing Dask cluster, whose workers start for some groups the process that a run here would.

What travels is text: a request in JSON there, a journal back. Results go to the run directory, which the machines
of the cluster share. Dask gives the groups of a worker that died to another, which goes on where the journal ends.

A request has "tasks", "journal" (its path), "timeout" (s) and "memory" (bytes), or None for no such limit, and
"versions" (see `_versions`).
"""

from __future__ import annotations

import itertools
import json
import logging
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from uuid import uuid4

from .execute import Group, Outcome, Task
from .journal import Journal
from .listening import is_loopback, open_ports

INSTALL = "pip install --constraint constraints.txt --editable '.[distributed]'"
LOOPBACK = "--host 127.0.0.1 --dashboard-address 127.0.0.1:0"  # for whoever starts a part of a cluster
_NAMED = 4  # ports in the warning
_POLL = 0.2  # s
# a process with its libraries takes seconds to start: it is given several groups, where there are many, and yet
# few enough that all places end at about the same time
_REQUESTS_PER_PLACE = 8
_WITHOUT_WORKERS = 60.0  # s that a scheduler may have no worker at all


class AddressError(ValueError):
    """A scheduler's address that is not one, or not safe."""


class ClusterError(OSError):
    """A cluster that is not there, or whose workers cannot do the work."""


@dataclass(frozen=True)
class Cluster:
    """A connection to a scheduler."""

    client: Any
    address: str

    def places(self) -> int:
        """How many groups run at once, now: the threads of the workers. Raises ClusterError."""
        try:
            return sum(self.client.nthreads().values())
        except (OSError, ValueError) as error:
            raise self._lost() from error

    def warning(self) -> str:
        """Which parts of a cluster without TLS other machines reach; "" where none is known to be."""
        if self.address.startswith("tls:"):
            return ""
        found: list[str] = []
        with suppress(
            Exception
        ):  # one that lacks vdmbench cannot be asked; of workers `_require_fit` says so
            found += [f"scheduler {port}" for port in self.client.run_on_scheduler(open_ports)]
        for nanny in (False, True):
            with suppress(Exception):  # workers may be without nannies
                answers = self.client.run(open_ports, nanny=nanny, on_error="return")
                lists = (ports for _, ports in sorted(answers.items()) if isinstance(ports, list))
                found += [f"{'nanny' if nanny else 'worker'} {port}" for ports in lists for port in ports]
        if not found:
            return ""
        more = f" and {len(found) - _NAMED} more" if len(found) > _NAMED else ""
        return (
            f"other machines reach {', '.join(found[:_NAMED])}{more}: without TLS whoever does can run programs "
            f"in your name; start scheduler and workers with {LOOPBACK}, or use TLS"
        )

    def run_cases(
        self,
        groups: Sequence[Group],
        *,
        scratch: Path,
        timeout: float | None,
        memory: int | None,
        fail_fast: bool,
        started: Callable[[Task], None],
    ) -> Iterator[Outcome]:
        """Run each case of each group, yielding outcomes as they come; as `run_tasks` does on this machine.

        Leaving the iterator early, Ctrl-C included, cancels what waits and stops what runs. `scratch` is a
        directory for journals, of this run alone and seen by all machines; what a killed run left is stopped.

        Raises
        ------
        ClusterError
            no worker is there, one of them does not fit, or the scheduler is lost.
        """
        if scratch.is_symlink():
            scratch.unlink()  # the link, not what it leads to
        shutil.rmtree(scratch, ignore_errors=True)
        home = scratch.absolute() / uuid4().hex
        home.mkdir(parents=True)
        limits = {"timeout": timeout, "memory": memory}
        waiting: dict[Any, _Sent] = {}
        try:
            self._require_fit(home)
            for tasks in packed(groups, max(1, self.places()) * _REQUESTS_PER_PLACE):
                sent = _Sent({task["id"]: task for task in tasks}, Journal(home / uuid4().hex))
                waiting[self._submit(sent, limits)] = sent
            asked = time.monotonic()
            while waiting:
                for future, sent in list(waiting.items()):
                    for outcome in self._outcomes(future, sent, started):
                        yield outcome
                        if fail_fast and not outcome.ok:
                            return
                    if not sent.ended:
                        continue
                    del waiting[future]
                    if sent.tasks:
                        waiting[self._submit(sent, limits)] = sent
                if time.monotonic() - asked > _WITHOUT_WORKERS / 10:
                    self.wait_for_workers()
                    asked = time.monotonic()
                time.sleep(_POLL)
        finally:
            with suppress(Exception):  # the scheduler may be what was lost
                self.client.cancel(list(waiting))
            shutil.rmtree(scratch, ignore_errors=True)  # by which those at work see that the run is over

    def _submit(self, sent: _Sent, limits: dict[str, Any]) -> Any:
        request = {
            "tasks": list(sent.tasks.values()),
            "journal": str(sent.journal.path),
            "versions": _versions(),
            **limits,
        }
        sent.since = sent.journal.read
        return self.client.submit(carry_out, json.dumps(request), key=f"vdmbench-{uuid4().hex}", pure=False)

    def _outcomes(self, future: Any, sent: _Sent, started: Callable[[Task], None]) -> Iterator[Outcome]:
        """What became of a group's tasks since last time; of one that ended without any progress, a failure."""
        status = future.status  # asked before the journal is read: what has ended writes no more
        sent.ended = status != "pending"
        if status == "finished":
            answer = json.loads(future.result())
            if answer["refusal"]:
                raise ClusterError(f"a worker of {self.address} {answer['refusal']}")
            sent.journal.catch_up(answer["journal"])
        elif status not in ("pending", "error"):
            raise self._lost()
        yield from sent.outcomes(started)
        if sent.ended and sent.tasks and sent.journal.read == sent.since:
            reason = f"{future.exception()!r:.200}" if status == "error" else "no answer"
            task = sent.tasks.pop(next(iter(sent.tasks)))
            message = f"no worker of the cluster could run it: {reason}"
            yield Outcome(task, "crashed", 0.0, message, "see the logs of the cluster's workers")

    def _require_fit(self, home: Path) -> None:
        """Refuse workers of other versions, and those that do not see the run directory."""
        request = json.dumps({"journal": str(home / "any"), "versions": _versions()})
        found = self.client.run(refusal, request, on_error="return")
        for worker, answer in sorted(found.items()):
            if isinstance(answer, Exception):
                answer = f"cannot run cases ({answer}): install vdmbench {version('vdmbench')} there"
            if answer:
                raise ClusterError(f"worker {worker} {answer}")

    def wait_for_workers(self) -> None:
        """Return once there is a worker. Raises ClusterError where none comes in a minute."""
        end = time.monotonic() + _WITHOUT_WORKERS
        while not self.places():
            if time.monotonic() > end:
                where = f" {LOOPBACK}" if is_loopback(urlsplit(self.address).hostname or "") else ""
                raise ClusterError(
                    f"{self.address} has no workers: start some with: dask worker {self.address}{where}"
                )
            time.sleep(_POLL)

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"the scheduler at {self.address} is gone; the same command goes on once it is back"
        )


def packed(groups: Sequence[Group], most: int) -> list[list[Task]]:
    """The tasks of all groups in order, in at most `most` parts of about as many groups; no group is divided."""
    ends = [round(k * len(groups) / most) for k in range(most + 1)]
    parts = [groups[first:end] for first, end in itertools.pairwise(ends) if first < end]
    return [[task for group in part for task in group] for part in parts]


@dataclass
class _Sent:
    tasks: dict[str, Task]  # without an outcome so far, in order
    journal: Journal
    since: int = 0  # what was read of the journal when it was sent
    ended: bool = False

    def outcomes(self, started: Callable[[Task], None]) -> Iterator[Outcome]:
        """What the journal says that is new."""
        for record in self.journal.news():
            if "begun" not in record:
                task = self.tasks.pop(record.pop("id"), None)
                if task is not None:
                    yield Outcome(task, **record)
            elif record["begun"] in self.tasks:
                started(self.tasks[record["begun"]])


@contextmanager
def connected(address: str, *, insecure: bool) -> Iterator[Cluster]:
    """A connection to the scheduler at `address`, such as "tcp://127.0.0.1:8786" or "tls://host:8786".

    Raises
    ------
    AddressError
        not an address, or one of another machine without TLS where that is not asked for by `insecure`.
    ImportError
        Dask is not installed.
    ClusterError
        nobody answers in the time that Dask's configuration allows (distributed.comm.timeouts.connect).
    """
    address = checked_address(address, insecure=insecure)
    try:
        import distributed
    except ImportError:
        raise ImportError(f"--scheduler needs Dask, which is not installed: {INSTALL}") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is said by an error
    if address.startswith("tls:"):
        _require_certificates(distributed.Security(), address)  # type: ignore[no-untyped-call]
    try:
        client = distributed.Client(address, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError):
        trusting = " that trusts this certificate" if address.startswith("tls:") else ""
        where = f" {LOOPBACK}" if is_loopback(urlsplit(address).hostname or "") else ""
        message = f"no scheduler{trusting} answers at {address}; start one with: dask scheduler{where}"
        raise ClusterError(message) from None
    with client:
        cluster = Cluster(client, address)
        cluster.wait_for_workers()
        yield cluster


def _require_certificates(security: Any, address: str) -> None:
    """Dask itself would leave a client half-made behind."""
    try:
        context = security.get_connection_args("client")["ssl_context"]
    except OSError as error:
        raise AddressError(f"{address}: the certificates of Dask's configuration: {error}") from None
    if context is None:
        raise AddressError(
            f"{address}: name certificates in Dask's configuration (distributed.comm.tls.ca-file, "
            "and .client.cert and .client.key there)"
        )


def checked_address(address: str, *, insecure: bool) -> str:
    """The address with its scheme. Raises AddressError."""
    full = address if "://" in address else f"tcp://{address}"
    try:
        parts = urlsplit(full)
        host, right = parts.hostname, bool(parts.port) and not parts.path
    except ValueError:
        host, right = None, False
    if not host or not right or parts.scheme not in ("tcp", "tls"):
        raise AddressError(
            f"{address!r} is no scheduler's address: write tls://HOST:PORT or tcp://127.0.0.1:PORT"
        )
    if parts.scheme == "tcp" and not insecure and not is_loopback(host):
        raise AddressError(
            f"{full}: without TLS anyone on the network can run programs in your name; use tls://, "
            "or --insecure-scheduler where you trust the whole network"
        )
    return full


def carry_out(text: str) -> str:
    """On a worker: start a process for a request, stop it when the run is over; refusal and journal as JSON.

    Raises RuntimeError where the process failed.
    """
    refused = refusal(text)
    if refused:
        return json.dumps({"refusal": refused, "journal": ""})
    journal = Journal(Path(json.loads(text)["journal"]))
    with (
        tempfile.TemporaryDirectory(prefix="vdmbench-") as place,
        (Path(place) / "complaints").open("w+") as said,
    ):
        path = Path(place) / "request.json"
        path.write_text(text)
        command = [sys.executable, "-P", "-m", "studies.remote", str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as process:
            while journal.path.parent.is_dir() and process.poll() is None:
                time.sleep(_POLL)
        # its standard input is closed now, by which it ends
        if process.returncode:
            said.seek(0)
            raise RuntimeError(f"exit code {process.returncode}: {said.read()[-2000:]}")
    return json.dumps({"refusal": "", "journal": journal.content().decode()})


def refusal(text: str) -> str:
    """On a worker: why it must not do a request, or nothing."""
    request = json.loads(text)
    here = _versions()
    for name, wanted in request["versions"].items():
        if here.get(name) != wanted:
            has = f"{name} {here[name]}" if name in here else f"no {name}"
            return f"has {has}, not {wanted}: install the same vdmbench everywhere"
    home = Path(request["journal"]).parent
    if not home.is_dir():
        return f"does not see {home}: the run directory must be on a file system that all machines share"
    return ""


def _versions() -> dict[str, str]:
    """What must be the same everywhere: the package's version and the declared one of each model."""
    from . import models

    return {
        "vdmbench": version("vdmbench"),
        **{f"model {name}": model.version for name, model in models.MODELS.items()},
    }
