"""Study file -> typed objects; every problem at once, each with its line.

Later values of a sweep are checked once the rest is valid.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomli_w

from .checks import validate
from .errors import Finding, MeshError, Problem, Source, StudyError, file_fault
from .files import changed, merged
from .kinds import MAX_NAME, Enters, is_safe_name
from .schema import Study
from .sweep import (
    STAR,
    Axis,
    ResolvedCase,
    check_cases,
    first_case,
    read_axes,
    read_inputs,
    told_at,
    variations,
)
from .toml_lines import TooLarge, key_lines, statements
from .units import shown

__all__ = ["ResolvedCase", "Study", "StudyError"]  # beside the definitions here

MAX_BYTES = 1_000_000  # of a study file

_LONG_NUMBER = re.compile(r"\d[\d_]{4000,}")


def load_study(
    path: Path,
    *,
    surface: Path | None = None,
    changes: Sequence[Mapping[str, Any]] = (),
) -> Study:
    """Read and validate a study file; all cases of its sweep are validated too.

    Parameters
    ----------
    path : the study file, TOML in UTF-8 (a byte order mark is ignored)
    surface : a mesh file to use as the geometry; `mesh_size` and the largest extent `size` of the study are kept,
        of a study of a file all but the file; its name gets that of the file as a suffix
    changes : nested tables of changes to the study, in order (`files.merged`)

    Raises
    ------
    StudyError
        with every problem of the file.
    InputError
        a change that the study cannot take.
    """
    data, source = _parsed(path)
    for change in changes:
        data = merged(data, change)
    if any(changes):
        source = replace(source, text=tomli_w.dumps(data))
    source = replace(source, directory=path.parent.resolve())
    if surface is not None:
        data = _with_surface(data, surface, [path for change in changes for path, _ in changed(change)])
    axes, findings = read_axes(data)
    base = first_case(data, axes)
    study, faults = validate(base, source)
    findings += [(told_at(axes, data, loc) if base is not data else loc, text) for loc, text in faults]
    findings += _changed_in_vain(axes, changes, data, surface)
    if study is None or findings:
        raise source.error(findings, base)
    expand(study)
    return study


def _changed_in_vain(
    axes: Sequence[Axis],
    changes: Sequence[Mapping[str, Any]],
    data: Mapping[str, Any],
    surface: Path | None,
) -> Iterator[Finding]:
    """Changes of a key that every case of the sweep replaces, or the surface; this is a change itself."""
    paths = {".".join(path) for change in changes for path, _ in changed(change)}
    given = {"geometry.shape", "geometry.path"} if surface is not None else set()
    for key in sorted(given & paths):
        yield tuple(key.split(".")), "is that of the surface given; leave the change or the surface out"
    paths |= given
    for axis in axes:
        if axis.key in paths and data["sweep"].get("mode") != STAR:
            told = f"is swept, so that a change decides nothing; change sweep.{shown(axis.key)} instead"
            yield axis.place, told


def expand(study: Study) -> list[ResolvedCase]:
    """The cases of a study's sweep, in order; one case without a sweep.

    Raises
    ------
    StudyError
        more cases than `study.max_cases`, or a case that is wrong.
    """
    if study._cases is None:
        data = study.model_dump(mode="json")
        axes, findings = read_axes(data)
        if not findings:
            found, findings = check_cases(data, axes, study.study.max_cases, study._source)
        if not findings and study.inputs is not None:
            findings = [finding for case in found for finding in variations(case.study)[1]]
        if findings:
            raise study.error(findings)
        study._cases = tuple(found)
    return list(study._cases)


def resolved(study: Study) -> dict[str, Any]:
    """The whole study as plain JSON, in SI units except for its sweep.

    `Study.model_validate` reads it back. Paths are absolute.
    """
    data = study.model_dump(mode="json")
    if "inputs" in data:
        data["inputs"] = {one.key: one.written for one in read_inputs(study)[0]}
    return data


def geometry_error(study: Study, error: MeshError) -> StudyError:
    """The error of a study with an unusable geometry, at its place in the file."""
    data = study.model_dump()
    place = error.place or ("path" if study.geometry.shape == "file" else "shape",)
    loc = told_at(read_axes(data)[0], data, ("geometry", *place))
    return study._source.error([(loc, str(error))], data)


def case_inputs(study: Study) -> dict[str, Any]:
    """The part of `resolved` that decides a case's numbers: all except fields marked `Enters.NOTHING`.

    A geometry file appears by its path; the key of its mesh covers its content (`shapes.geometry_key`).
    """
    return study.without(resolved(study), Enters.NOTHING)


# --- the file ---


def _parsed(path: Path) -> tuple[dict[str, Any], Source]:
    """Data of a study file, and the source with the lines of its keys. Raises StudyError."""

    def wrong(message: str, line: int = 1) -> StudyError:
        return StudyError([Problem(str(path), line, "", message)])

    if fault := file_fault(path):
        raise wrong(fault)
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}") from None
    if len(raw) > MAX_BYTES:
        raise wrong(f"is larger than {MAX_BYTES // 1_000_000} MB; a study file is text of some hundred lines")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise wrong("is not UTF-8 text; save the file in UTF-8", line) from None
    try:
        parts = list(statements(text))
        return tomllib.loads(text), Source(str(path), key_lines(parts), text)
    except TooLarge as error:
        raise wrong(str(error), error.line) from None
    except tomllib.TOMLDecodeError as error:
        message = re.sub(r" \(at .*\)$", "", str(error))
        place = re.search(r"\(at line (\d+),", str(error))
        line = int(place.group(1)) if place else text.rstrip("\n").count("\n") + 1
        raise wrong(f"TOML syntax: {message[:1].lower()}{message[1:]}", line) from None
    except ValueError:  # Python converts no whole number of more than 4,300 digits
        match = _LONG_NUMBER.search(text)
        raise wrong("a number is too long", text.count("\n", 0, match.start()) + 1 if match else 1) from None


def _with_surface(data: Mapping[str, Any], surface: Path, asked: Sequence[Sequence[str]]) -> dict[str, Any]:
    """The data of a study with a file as its body: a separate study, with its own run directory and baseline.

    `asked` are the paths of changed keys; those of the geometry are kept.
    """
    geometry, study = data.get("geometry"), data.get("study")
    kept: dict[str, Any] = {}
    if isinstance(geometry, dict):
        is_file = geometry.get("shape") == "file"
        own = {"mesh_size", "size", *(path[1] for path in asked if path[0] == "geometry" and len(path) > 1)}
        kept = {key: value for key, value in geometry.items() if is_file or key in own}
        if isinstance(kept.get("size"), list) and ["geometry", "size"] not in map(list, asked):
            del kept["size"]  # of a box
    kept |= {"shape": "file", "path": str(surface.absolute())}
    if isinstance(study, dict) and is_safe_name(name := study.get("name")):
        # names of scans differ at their ends
        file = re.sub(r"[^A-Za-z0-9_.-]+", "-", surface.stem)[-MAX_NAME // 2 :]
        study = study | {"name": f"{name[: MAX_NAME - len(file) - 1]}-{file}"}
    return {**data, "geometry": kept} | ({"study": study} if study is not None else {})
