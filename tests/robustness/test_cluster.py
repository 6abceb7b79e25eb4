"""Runs on a Dask cluster: two workers on this machine, started by the documented commands, and what goes wrong."""

import json
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import dask
import distributed  # noqa: F401  whose configuration is read
import pytest
import trustme

from tests.command import SCRIPT, vdmbench_process, wait_for
from tools.documents import ROOT
from vdmbench.study.errors import InputError
from vdmbench.work.cluster import (
    LOOPBACK,
    ClusterError,
    RefusalError,
    carry_out,
    checked_address,
    cluster_pool,
)

from . import processes

COMPLETE = "cases/[!.]*"  # a file that is being written begins with a dot
NEAR_ZERO_PATIENCE = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "1s"}
CLUSTER = ROOT / "docs" / "howto" / "cluster.md"


@contextmanager
def _cluster(place: Path, *options: str, **environment: str) -> Iterator[str]:
    """The address of a scheduler with two workers of one thread each."""
    contact = place / "scheduler.json"
    quiet: dict[str, Any] = {"cwd": place, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    quiet["env"] = os.environ | environment
    start = [*_documented("dask scheduler", "878[67]", "0"), "--scheduler-file", str(contact)]
    with subprocess.Popen([*start, *options], **quiet) as head:
        wait_for(lambda: contact.exists() and contact.read_text().endswith("}"))
        address = json.loads(contact.read_text())["address"]
        work = _documented("dask worker", "tcp://127.0.0.1:8786", address)
        with subprocess.Popen(work, **quiet) as hands:
            yield address
            hands.terminate()
        head.terminate()


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler on this machine that anyone here may talk to."""
    with _cluster(tmp_path_factory.mktemp("cluster")) as address:
        yield address


def _certificates(place: Path, authority: trustme.CA) -> dict[str, str]:
    """Dask's configuration of a certificate for each part of a cluster, as variables of the environment."""
    signed, ca = place / "signed.pem", place / "ca.pem"
    authority.issue_cert("127.0.0.1").private_key_and_cert_chain_pem.write_to_path(signed)
    authority.cert_pem.write_to_path(ca)
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    parts = ("CLIENT", "SCHEDULER", "WORKER")
    return {f"{tls}CA_FILE": str(ca), **{f"{tls}{part}__CERT": str(signed) for part in parts}}


def _documented(command: str, old: str, new: str) -> list[str]:
    """A command of the documents as it is there, with one word exchanged; `dask` is that of this Python."""
    (line,) = (line for line in CLUSTER.read_text().splitlines() if line.startswith(f".venv/bin/{command} "))
    words = shlex.split(re.sub(old, new, line.removesuffix("&")))
    return [str(SCRIPT.parent / Path(words[0]).name), *words[1:]]


def _at_work(run: Path) -> list[int]:
    """The processes that have a node's log open: they do the nodes of a run."""
    found = []
    for place in Path("/proc").iterdir():
        try:
            opened = [os.readlink(entry) for entry in (place / "fd").iterdir()]
        except OSError:
            continue
        if any(name.startswith(f"{run}/failed/.") for name in opened):
            found.append(int(place.name))
    return found


def test_a_killed_worker_costs_a_retry_and_ctrl_c_keeps_what_is_done(
    tmp_path: Path, scheduler: str, undisturbed: tuple[Path, float]
) -> None:
    run, words = tmp_path / "run", ("run", "small.toml", "--out", "run", "--scheduler", scheduler)
    shutil.copy(undisturbed[0] / "small.toml", tmp_path)
    with processes.start(*words, cwd=tmp_path) as command:
        (victim, *_) = wait_for(lambda: _at_work(run))
        os.kill(victim, signal.SIGKILL)
        wait_for(lambda: list(run.glob(COMPLETE)))
        command.send_signal(signal.SIGINT)
        said = processes.output_of(command)
    assert command.returncode == 130, said
    assert "Traceback" not in said
    wait_for(lambda: not _at_work(run))
    assert not list(run.glob(".cluster*"))
    kept = {path: path.stat().st_mtime_ns for path in run.glob(COMPLETE)}
    assert kept
    again = processes.start(*words, cwd=tmp_path)
    said = processes.output_of(again)
    assert again.returncode == 0, said
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    processes.assert_same_results(run, undisturbed[0] / processes.RUN)


@pytest.mark.slow
def test_tls_takes_those_with_a_certificate_only(tmp_path: Path, undisturbed: tuple[Path, float]) -> None:
    authority = trustme.CA()
    shutil.copy(undisturbed[0] / "small.toml", tmp_path)
    trusted = _certificates(tmp_path, authority)
    (tmp_path / "stranger").mkdir()
    stranger = _certificates(tmp_path / "stranger", trustme.CA()) | NEAR_ZERO_PATIENCE
    with _cluster(tmp_path, "--protocol", "tls", **trusted) as address:
        assert address.startswith("tls://127.0.0.1:")
        words = ("run", "small.toml", "--out", "run", "--scheduler", address)
        refused = vdmbench_process(*words, cwd=tmp_path, **stranger)
        assert refused.returncode == 4
        told = f"vdmbench: no scheduler that trusts this certificate answers at {address};"
        assert refused.stderr.startswith(told)
        assert len(refused.stderr.splitlines()) == 1
        result = vdmbench_process(*words, cwd=tmp_path, **trusted)
    assert result.returncode == 0, result.stderr
    processes.assert_same_results(tmp_path / "run", undisturbed[0] / processes.RUN)


def _connect(address: str, directory: Path) -> None:
    with cluster_pool(address, directory, insecure=False):
        pass


def test_nobody_there_and_nobody_to_be_trusted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as held:  # bound, not listening: whoever calls is refused
        held.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{held.getsockname()[1]}"
        told = f"no scheduler answers at {address}; start one with: dask scheduler {LOOPBACK}"
        with (
            dask.config.set({"distributed.comm.timeouts.connect": "200 ms"}),
            pytest.raises(ClusterError, match=re.escape(told)),
        ):
            _connect(address, tmp_path)
    with pytest.raises(InputError, match="name certificates in Dask's configuration"):
        _connect("tls://10.0.0.1:8786", tmp_path)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match=r"pip install --constraint constraints\.txt --editable '\.\[dist"):
        _connect("127.0.0.1:8786", tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("address", "full", "why"),
    [
        ("127.0.0.1:8786", "tcp://127.0.0.1:8786", ""),
        ("tcp://localhost:8786", "tcp://localhost:8786", ""),
        ("tcp://[::1]:8786", "tcp://[::1]:8786", ""),
        ("tls://cluster.example:8786", "tls://cluster.example:8786", ""),
        ("cluster.example:8786", "tcp://cluster.example:8786", "without TLS"),
        ("tcp://192.168.0.7:8786", "tcp://192.168.0.7:8786", "without TLS"),
        ("0.0.0.0:8786", "tcp://0.0.0.0:8786", "without TLS"),
        *((one, "", "no scheduler's address") for one in ("", "127.0.0.1", "http://127.0.0.1:80")),
        *((one, "", "no scheduler's address") for one in ("inproc://a/b/c", "tcp://127.0.0.1:x")),
        ("tcp://[::1:1", "", "no scheduler's address"),
    ],
)
def test_addresses_are_safe_or_need_a_word(address: str, full: str, why: str) -> None:
    if why:
        with pytest.raises(InputError, match=why):
            checked_address(address, insecure=not full)
    if full:
        assert checked_address(address, insecure=bool(why)) == full


def test_workers_that_differ_or_do_not_see_the_directory_are_refused(tmp_path: Path) -> None:
    from vdmbench.work.cluster import _versions

    for versions, home, why in (
        ({"vdmbench": "0.0.0"}, tmp_path, "^has vdmbench .*, not 0.0.0: install"),
        ({"model new": "1"}, tmp_path, "^has no model new, not 1"),
        ({}, tmp_path / "elsewhere", "^does not see"),
    ):
        with pytest.raises(RefusalError, match=why):
            carry_out(json.dumps({"versions": _versions() | versions, "scratch": str(home)}))
