"""`vdmbench new`: a study file to begin with."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from typing import Any

from .arguments import option, verb
from .output import OK, UsageError, print_json

TEMPLATE = Path(__file__).with_name("new_study.toml")
_NAME = re.compile(r'^(\s*name\s*=\s*)(?:"[^"\n]*"|\'[^\'\n]*\')', re.MULTILINE)


@verb(
    "new",
    "write a study file to begin with, or a copy of another study",
    option("name", metavar="NAME", help="name of the study; NAME.toml is written, which must be new"),
    option("--from", dest="source", metavar="STUDY", help="a study to copy, a file or a shipped one"),
)
def new_study(options: argparse.Namespace) -> int:
    """Write NAME.toml, and beside it the files that a copied study names."""
    from ..study.files import study_path
    from ..study.kinds import is_safe_name

    path = Path(options.name).with_suffix("") if options.name.endswith(".toml") else Path(options.name)
    if not is_safe_name(path.name):
        raise UsageError(
            f"{options.name!r}: a study's name has letters, digits, _ . - and at most 64 of them"
        )
    source = study_path(options.source) if options.source else TEMPLATE
    text = source.read_text(encoding="utf-8-sig")
    files = _files(text, source.parent) if options.source else {}
    target = path.with_name(f"{path.name}.toml")
    wanted: dict[Path, bytes] = {target: _named(text, path.name, source).encode()}
    wanted |= {target.parent / name: file.read_bytes() for name, file in files.items()}
    for file in wanted:
        if os.path.lexists(file):
            raise UsageError(f"{file}: is there already, and is not overwritten; choose another name")
    for file, content in wanted.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("xb") as out:
            out.write(content)
    if options.json:
        return print_json({"study": str(target), "files": [str(file) for file in wanted]})
    print(f"{target}: run it with: vdmbench run {target}")
    return OK


def _named(text: str, name: str, source: Path) -> str:
    """The study under another name."""
    if source == TEMPLATE:
        return text.replace("NAME", name)
    start = re.search(r"^\s*\[\s*study\s*\]", text, re.MULTILINE)
    found = _NAME.search(text, start.end()) if start else None
    if found is None:
        raise UsageError(f"{source}: has no line with the name of its study, so it cannot be copied")
    return f'{text[: found.start()]}{found[1]}"{name}"{text[found.end() :]}'


def _files(text: str, directory: Path) -> dict[str, Path]:
    """The files beside a study that it names. Raises UsageError for one that is elsewhere or missing."""
    import tomllib

    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"the study to copy is not sound: {error}") from None
    tables: list[Any] = [data.get("geometry")]
    tables += data["measured"] if isinstance(data.get("measured"), list) else []
    names = [
        table["path"] for table in tables if isinstance(table, dict) and isinstance(table.get("path"), str)
    ]
    for name in names:
        if Path(name).is_absolute() or ".." in Path(name).parts or not (directory / name).is_file():
            raise UsageError(f"it names {name!r}, which is no file beside it; copy the study by hand")
    return {name: directory / name for name in names}
