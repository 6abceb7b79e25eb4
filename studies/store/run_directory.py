"""A run directory: its owner, plan, failures and reported results."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ..machine import json_text, write_atomically
from ..scene.result import FrameTimes
from ..study.errors import InputError
from ..study.kinds import safe_name
from ..study.schema import Study
from .plain import StoreError, typed

PLAN, STUDY, RESOLVED, TIMES = "plan.json", "study.toml", "resolved.toml", "times.json"
REPORT, METRICS_FILE, TOLD = "report.html", "metrics.csv", "told.json"
CASE_SUFFIX = ".vtkhdf"
_SHORT, _READABLE = 12, 100  # characters of the hash, and at most of the label, in a file name
_FOLDERS = ("cases", "failed")
_BEGUN = {STUDY, RESOLVED, *_FOLDERS}  # content of a run that was killed before it had a plan


# required content of the JSON files; further content is kept


@dataclass
class _Case:
    hash: str
    label: str
    swept: Mapping[str, float | str]
    swept_units: Mapping[str, str]
    mesh: str = ""


@dataclass
class _Study:
    name: str


@dataclass
class _Plan:
    study: _Study
    cases: Sequence[_Case]
    surfaces: Mapping[str, str] = field(default_factory=dict)
    command: Sequence[str] = ()
    directory: str = ""


@dataclass
class _Failure:
    hash: str
    code: str
    message: str
    remedy: str


@dataclass
class _Told:
    of: str
    told: Mapping[str, Any]


def _parsed(kind: type, path: Path) -> dict[str, Any]:
    """Content of a JSON file. Raises OSError, and ValueError if required content is missing."""
    found: dict[str, Any] = json.loads(path.read_bytes())
    typed(kind, found)
    return found


def case_path(directory: Path, case_hash: str, label: str = "") -> Path:
    """Path of a finished case: an existing file of this hash, under any label."""
    return _named(directory / "cases", case_hash, label, CASE_SUFFIX)


def failure_path(directory: Path, case_hash: str, label: str = "") -> Path:
    """Path of the reason why a case failed."""
    return _named(directory / "failed", case_hash, label, ".json")


def _named(folder: Path, case_hash: str, label: str, suffix: str) -> Path:
    """`force-0.1-N-2c29307b61fd.vtkhdf`; a label is the study's, so the same case may be there under another."""
    words = re.sub(r"[^\w.+-]+", "-", label, flags=re.ASCII).strip("-.")[:_READABLE]
    ending = f"{case_hash[:_SHORT]}{suffix}"
    named = folder / "-".join(filter(None, (words, ending)))
    if os.path.lexists(named) or not folder.is_dir():
        return named
    there = (name for name in os.listdir(folder) if name.endswith(ending))
    return folder / next(there, named.name)


# --- owner ---


def refuse_foreign(directory: Path) -> None:
    """Allow a run in a directory that is missing, is empty or holds a run.

    Raises
    ------
    InputError
        it holds other files, which a run could replace.
    """
    if not directory.is_dir():
        return  # creating it reports any obstacle
    names = {path.name for path in directory.iterdir()}
    rest = {name for name in names if not (name.startswith(".lock") or _is_half_written(name))}
    begun = ".lock" in names and rest <= _BEGUN
    if rest and not begun and not _holds_a_run(directory):
        raise InputError(
            f"{directory}: is not empty and not a run directory; choose another --out, or a new one"
        )


def _is_half_written(name: str) -> bool:
    return name.startswith(".") and name.endswith(".part")


def _holds_a_run(directory: Path) -> bool:
    try:
        read_plan(directory)
    except StoreError:  # a damaged plan is replaced; its cases stay
        return any((directory / "cases").glob(f"*{CASE_SUFFIX}")) or any(
            (directory / "failed").glob("*.json")
        )
    return True


# --- what was planned ---


def write_plan(directory: Path, planned: Mapping[str, Any]) -> None:
    """Write a plan."""
    write_atomically(directory / PLAN, json_text(planned, indent=1).encode())


def read_plan(directory: Path) -> dict[str, Any]:
    """The plan of a run directory. Raises StoreError without one, and for a damaged one."""
    try:
        plan = _parsed(_Plan, directory / PLAN)
        for case in plan["cases"]:
            safe_name(case["hash"])  # part of a file name
        return plan
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
        raise StoreError(f"{directory}: not a run directory (it has no {PLAN})") from None
    except ValueError as error:
        raise StoreError(f"{directory}/{PLAN}: damaged ({error}); run the study again") from error


def read_study(directory: Path) -> tuple[Study, str]:
    """The study of a run, and the text of its file.

    Raises
    ------
    StoreError
        a file is gone or damaged, or of another version of the program.
    """
    name = RESOLVED
    try:
        whole = Study.model_validate(tomllib.loads((directory / name).read_text(encoding="utf-8")))
        name = STUDY
        return whole, (directory / name).read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError, ValueError) as error:  # no UTF-8, no TOML, no study
        what = str(error).splitlines()[0]
        raise StoreError(f"{directory}/{name}: not readable ({what}); run the study again") from error


# --- times of frames ---


def add_times(directory: Path, found: Mapping[str, Mapping[str, FrameTimes]]) -> None:
    """Store times of frames, by mesh and model, beside those of other meshes. Raises OSError."""
    known: dict[str, dict[str, FrameTimes]] = {}
    with suppress(StoreError):
        known = read_times(directory)
    write_atomically(directory / TIMES, json_text({**known, **found}, indent=1).encode())


def read_times(directory: Path) -> dict[str, dict[str, FrameTimes]]:
    """Mesh -> model -> times of its frames; empty if not measured. Raises StoreError."""
    path = directory / TIMES
    try:
        return typed(dict[str, dict[str, FrameTimes]], json.loads(path.read_bytes()))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise StoreError(f"{path}: damaged ({error}); delete it and run again") from error


# --- the summary of a run ---


def keep_told(directory: Path, plan: Mapping[str, Any], told: Mapping[str, Any]) -> None:
    """Store the summary of a run, with a checksum of its sources and of the written tables. Raises OSError."""
    write_atomically(directory / TOLD, json_text({"of": _made_of(directory, plan), "told": told}).encode())


def read_told(directory: Path, plan: Mapping[str, Any]) -> dict[str, Any] | None:
    """The summary from `keep_told`; None if a case, a failure, a time, a table or the report has changed since."""
    try:
        kept = _parsed(_Told, directory / TOLD)
        return kept["told"] if kept["of"] == _made_of(directory, plan) else None
    except (OSError, ValueError):
        return None


_SUM_BYTES = 100  # at the end of a case file, including its checksum


def _made_of(directory: Path, plan: Mapping[str, Any]) -> str:
    """Checksum of the plan, the cases' checksums, failures, times, tables and report."""
    found = hashlib.sha256(json_text([version("vdmbench"), plan]).encode())
    for case in plan["cases"]:
        with suppress(OSError), case_path(directory, case["hash"], case["label"]).open("rb") as file:
            file.seek(-_SUM_BYTES, os.SEEK_END)
            found.update(file.read())
        found.update(b"|")
    others = [directory / name for name in (TIMES, METRICS_FILE, REPORT)]
    for path in (*others, *sorted((directory / "failed").glob("*.json"))):
        with suppress(OSError):
            found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


# --- what failed ---


def write_failure(path: Path, reason: Mapping[str, str], log: str) -> None:
    """Store the reason and the log of a failed case beside the results."""
    write_atomically(path, json_text(reason, indent=1).encode())
    write_atomically(path.with_suffix(".log"), log.encode("utf-8", "replace"))


def read_failure(directory: Path, case_hash: str, label: str) -> dict[str, str]:
    """Why a case failed. Raises StoreError."""
    path = failure_path(directory, case_hash, label)
    try:
        return _parsed(_Failure, path) | {"label": label}
    except (IsADirectoryError, ValueError) as error:
        raise StoreError(f"{path}: damaged ({error}); delete it and run again") from error


def has_failed(directory: Path, case_hash: str, label: str = "") -> bool:
    """Whether a run directory has the reason of a case's failure."""
    return os.path.lexists(failure_path(directory, case_hash, label))
