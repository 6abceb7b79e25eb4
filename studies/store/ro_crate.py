"""What is in a run directory as an RO-Crate 1.1 (https://w3id.org/ro/crate/1.1): files, software and the run."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from ..machine.files import write_atomically
from ..measures.case import Run
from .cases import METRICS_FILE, STUDY_FILE
from .run_directory import CASE_SUFFIX, PLAN, RESOLVED, STUDY

CRATE = "ro-crate-metadata.json"
REPORT = "report.html"
_SPECIFICATION = "https://w3id.org/ro/crate/1.1"
_HDF5 = "application/x-hdf5"
_FILES = {  # name -> what it is, and its media type
    STUDY: ("The study file as it was run", "application/toml"),
    RESOLVED: ("The study with every default, in SI units", "application/toml"),
    PLAN: ("Cases, labels and hashes", "application/json"),
    STUDY_FILE: ("Every metric of every case", _HDF5),
    METRICS_FILE: ("Every metric of every case, as a table", "text/csv"),
    REPORT: ("The report", "text/html"),
}
_FOLDERS = {  # folder -> ending -> the same
    "cases": {CASE_SUFFIX: ("A finished case", _HDF5)},
    "failed": {
        ".json": ("Why a case failed", "application/json"),
        ".log": ("What the worker of a case printed", "text/plain"),
    },
}
_GIVEN = (STUDY,)  # what went in; all else came out

Entity = dict[str, Any]


def write_crate(directory: Path, run: Run) -> None:
    """Write the metadata file of a run directory; the same directory gives the same bytes. Raises OSError."""
    text = json.dumps(crate(directory, run), indent=1, ensure_ascii=False)
    write_atomically(directory / CRATE, text.encode("utf-8", "replace"))


def crate(directory: Path, run: Run) -> Entity:
    """The metadata of a run directory as JSON-LD. It names no folder but the run's own."""
    files = list(_files(directory))
    dates = sorted(case.provenance["date"] for case in run.cases if "date" in case.provenance)
    last = dates[-1] if dates else datetime.now(UTC).isoformat(timespec="seconds")
    name = str(run.study.get("name", "study"))
    command = run.plan.get("command") or ["run", name]
    done = not run.failed and not run.missing
    action: Entity = {
        "@id": "#run",
        "@type": "CreateAction",
        "name": shlex.join(["vdmbench", *command]),
        "instrument": _link("#vdmbench"),
        "object": [_link(one["@id"]) for one in files if one["@id"] in _GIVEN],
        "result": [_link(one["@id"]) for one in files if one["@id"] not in _GIVEN],
        "endTime": last,
        "actionStatus": _link(f"http://schema.org/{'Completed' if done else 'Failed'}ActionStatus"),
    }
    if dates:
        action["startTime"] = dates[0]
    if not done:
        action["error"] = f"cases that failed: {len(run.failed)}, that were not run: {len(run.missing)}"
    root: Entity = {
        "@id": "./",
        "@type": "Dataset",
        "name": str(run.study.get("title") or name),
        "description": f"The study {name}: models of soft tissue compared by vdmbench. Cases: {len(run.cases)}.",
        "datePublished": last[:10],
        "license": _link("#license"),
        "hasPart": [_link(one["@id"]) for one in files],
        "mentions": [_link("#run")],
    }
    return {
        "@context": f"{_SPECIFICATION}/context",
        "@graph": [
            {
                "@id": CRATE,
                "@type": "CreativeWork",
                "about": _link("./"),
                "conformsTo": _link(_SPECIFICATION),
            },
            root,
            *files,
            action,
            *_software(run),
            {
                "@id": "#license",
                "@type": "CreativeWork",
                "name": "No licence given",
                "description": "Whoever ran the study decides on the terms of its results.",
            },
        ],
    }


def _link(identity: str) -> Entity:
    return {"@id": identity}


def _files(directory: Path) -> list[Entity]:
    """An entity of each file that is there and of a known kind."""
    found = [
        _file(directory, Path(name), *about) for name, about in _FILES.items() if (directory / name).is_file()
    ]
    for folder, kinds in _FOLDERS.items():
        for path in sorted((directory / folder).glob("*")):
            about = kinds.get(path.suffix)
            if about is not None and path.is_file() and not path.is_symlink() and path.name[0] != ".":
                found.append(_file(directory, path.relative_to(directory), *about))
    return found


def _file(directory: Path, path: Path, what: str, media: str) -> Entity:
    label = f"{what}: {path.stem}" if len(path.parts) > 1 else what
    return {
        "@id": quote(path.as_posix()),
        "@type": "File",
        "name": label,
        "encodingFormat": media,
        "contentSize": str((directory / path).stat().st_size),
    }


def _software(run: Run) -> Sequence[Entity]:
    """vdmbench and the packages that it computed with, in all versions that cases name."""
    versions: dict[str, list[str]] = {}
    for case in run.cases:
        for key, value in case.provenance.items():
            kind, _, package = key.partition(".")
            name = package if kind == "package" else "Python" if key == "python" else ""
            if name and value not in versions.setdefault(name, []):
                versions[name].append(value)
    own = versions.pop("vdmbench", ["unknown"])
    others = [
        {
            "@id": f"#{quote(name)}",
            "@type": "SoftwareApplication",
            "name": name,
            "softwareVersion": ", ".join(found),
        }
        for name, found in sorted(versions.items())
    ]
    commits = sorted({case.provenance["commit"] for case in run.cases if "commit" in case.provenance})
    program: Entity = {
        "@id": "#vdmbench",
        "@type": "SoftwareApplication",
        "name": "vdmbench",
        "softwareVersion": ", ".join(own),
        "softwareRequirements": [_link(one["@id"]) for one in others],
    }
    if commits:
        program["identifier"] = ", ".join(commits)
    return [program, *others]
