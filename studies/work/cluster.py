"""A Dask cluster as a pool: each worker does a task in a separate process, like a local run.

Tasks and their outcomes travel as JSON text. Results are files in the cache and the run directory, which all
machines share. If a worker dies, Dask gives its task to another.
"""

from __future__ import annotations

import ipaddress
import json
import logging
import multiprocessing
import shutil
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from uuid import uuid4

from ..study.errors import InputError
from .pool import local_pool
from .worker import Said

INSTALL = "pip install --constraint constraints.txt --editable '.[distributed]'"
LOOPBACK = "--host 127.0.0.1 --dashboard-address 127.0.0.1:0"  # options to start a part of a cluster
_POLL = 0.2  # s
_WITHOUT_WORKERS = 60.0  # s without a worker that are allowed at the start of a run


class ClusterError(OSError):
    """A cluster that is missing, or whose workers cannot do the work."""


class Cluster:
    """A connection to a scheduler; see `vdmbench.work.pool.Pool`.

    Parameters
    ----------
    scratch : a directory of this run alone, seen by all machines; running tasks stop when it is removed
    """

    def __init__(self, client: Any, address: str, scratch: Path) -> None:
        self._client, self._address, self._scratch = client, address, scratch
        self._executor = client.get_executor(pure=False)

    @property
    def count(self) -> int:
        """Twice the threads of the workers, so that none waits for its next task. Raises ClusterError."""
        try:
            return 2 * max(1, sum(self._client.nthreads().values()))
        except (OSError, ValueError) as error:
            raise self._lost() from error

    def submit(self, task: str, log: Path, seconds: float | None) -> Future[str]:
        """See `Pool`."""
        request = {
            "task": task,
            "log": str(log),
            "scratch": str(self._scratch),
            "versions": _versions(),
            "timeout": seconds,
        }
        said: Future[str] = Future()
        theirs = self._executor.submit(carry_out, json.dumps(request))
        theirs.add_done_callback(lambda done: self._pass_on(done, said))
        return said

    def _pass_on(self, theirs: Future[str], said: Future[str]) -> None:
        """Set the outcome of a task; a ClusterError if the scheduler is lost or a worker cannot do it."""
        try:
            said.set_result(theirs.result())
        except CancelledError:
            said.set_exception(self._lost())
        except Exception as error:  # noqa: BLE001  any error of Dask
            if type(error).__name__ == "KilledWorker":
                why = "its worker was lost several times while it was at work"
                remedy = "use a coarser mesh, or workers with more memory; see the cluster's own logs"
                said.set_result(Said("error", 0.0, why, remedy).as_json())
                return
            why = f"{error}" if isinstance(error, RefusalError) else f"cannot run a task: {error!r:.200}"
            said.set_exception(ClusterError(f"a worker of {self._address} {why}"))

    def close(self) -> None:
        """Cancel waiting tasks; running ones stop when the scratch directory is gone."""
        shutil.rmtree(self._scratch, ignore_errors=True)
        with suppress(Exception):  # the scheduler may be lost
            self._executor.shutdown(wait=False, cancel_futures=True)

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"the scheduler at {self._address} is gone; the same command goes on once it is back"
        )


@contextmanager
def cluster_pool(address: str, directory: Path, *, insecure: bool) -> Iterator[Cluster]:
    """The workers of the scheduler at `address`, such as "tcp://127.0.0.1:8786" or "tls://host:8786".

    Raises
    ------
    InputError
        not an address, or one of another machine without TLS and without `insecure`.
    ImportError
        Dask is not installed.
    ClusterError
        no answer in the time of Dask's configuration (distributed.comm.timeouts.connect), or no worker.
    """
    address = checked_address(address, insecure=insecure)
    try:
        import distributed
    except ImportError:
        raise ImportError(f"--scheduler needs Dask, which is not installed: {INSTALL}") from None
    for name in ("distributed", "tornado.application"):  # their important messages arrive as errors
        logging.getLogger(name).setLevel(logging.CRITICAL)
    safe, where = address.startswith("tls:"), f" {LOOPBACK}" if is_loopback(address) else ""
    if safe:
        _require_certificates(distributed.Security(), address)  # type: ignore[no-untyped-call]
    try:
        client = distributed.Client(address, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError):
        trusting = " that trusts this certificate" if safe else ""
        message = f"no scheduler{trusting} answers at {address}; start one with: dask scheduler{where}"
        raise ClusterError(message) from None
    with client:
        try:
            client.wait_for_workers(1, timeout=_WITHOUT_WORKERS)
        except TimeoutError:
            message = f"{address} has no workers: start some with: dask worker {address}{where}"
            raise ClusterError(message) from None
        scratch = (directory / f".cluster-{uuid4().hex}").absolute()
        scratch.mkdir(parents=True)
        cluster = Cluster(client, address, scratch)
        try:
            yield cluster
        finally:
            cluster.close()


def _require_certificates(security: Any, address: str) -> None:
    """Check certificates first: Dask itself would leave a half-made client behind."""
    try:
        context = security.get_connection_args("client")["ssl_context"]
    except OSError as error:
        raise InputError(f"{address}: the certificates of Dask's configuration: {error}") from None
    if context is None:
        raise InputError(
            f"{address}: name certificates in Dask's configuration (distributed.comm.tls.ca-file, "
            "and .client.cert and .client.key there)"
        )


def checked_address(address: str, *, insecure: bool) -> str:
    """The address with its scheme. Raises InputError."""
    full = address if "://" in address else f"tcp://{address}"
    try:
        parts = urlsplit(full)
        host, right = parts.hostname, bool(parts.port) and not parts.path
    except ValueError:
        host, right = None, False
    if not host or not right or parts.scheme not in ("tcp", "tls"):
        raise InputError(
            f"{address!r} is no scheduler's address: write tls://HOST:PORT or tcp://127.0.0.1:PORT"
        )
    if parts.scheme == "tcp" and not insecure and not is_loopback(full):
        raise InputError(
            f"{full}: without TLS anyone on the network can run programs in your name; use tls://, "
            "or --insecure-scheduler where you trust the whole network"
        )
    return full


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches the host of an address, as "tcp://localhost:8786"."""
    host = urlsplit(address).hostname or ""
    with suppress(ValueError):
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    return False


class RefusalError(ValueError):
    """A worker that must not do a task; the message gives the reason."""


def carry_out(text: str) -> str:
    """On a worker: do a task in a separate process; returns its outcome as JSON. Stops it when the run is over.

    Raises
    ------
    RefusalError
        another version than the run's, or a run directory that the worker does not see.
    """
    request, here = json.loads(text), _versions()
    for name, wanted in request["versions"].items():
        if here.get(name) != wanted:
            has = f"{name} {here[name]}" if name in here else f"no {name}"
            raise RefusalError(f"has {has}, not {wanted}: install the same vdmbench everywhere")
    run = Path(request["scratch"])
    if not run.is_dir():
        told = f"does not see {run}: the run directory must be on a file system that all machines share"
        raise RefusalError(told)
    # a nanny starts its worker as a daemon, which may not start processes
    multiprocessing.current_process().daemon = False
    with local_pool(1) as pool:
        future = pool.submit(request["task"], Path(request["log"]), request["timeout"])
        while run.is_dir():
            with suppress(TimeoutError):
                return future.result(_POLL)
        raise RefusalError("has no run directory any more: the run is over")


def _versions() -> dict[str, str]:
    """The versions that must agree everywhere: the package's and each model's."""
    from .. import models

    return {
        "vdmbench": version("vdmbench"),
        **{f"model {name}": model.version for name, model in models.all_models().items()},
    }
