"""`vdmbench new`: a study file to begin with."""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path

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
    """Write NAME.toml; files that a copied study names stay where they are."""
    from ..study.files import study_path
    from ..study.kinds import is_safe_name

    path = Path(options.name).with_suffix("") if options.name.endswith(".toml") else Path(options.name)
    if not is_safe_name(path.name):
        raise UsageError(
            f"{options.name!r}: a study's name has letters, digits, _ . - and at most 64 of them"
        )
    source = study_path(options.source) if options.source else TEMPLATE
    text = source.read_text(encoding="utf-8-sig")
    target = path.with_name(f"{path.name}.toml")
    if os.path.lexists(target):
        raise UsageError(f"{target}: is there already, and is not overwritten; choose another name")
    target.parent.mkdir(parents=True, exist_ok=True)
    with target.open("x", encoding="utf-8") as out:
        out.write(_named(text, path.name, source))
    if options.json:
        return print_json({"study": str(target)})
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
