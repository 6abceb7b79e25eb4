"""`vdmbench list`: the shipped studies, or the models."""

from __future__ import annotations

import argparse

from ..study.files import shipped_studies
from .arguments import flag
from .output import OK, print_json

SUMMARY = "list the shipped studies, or the models"
ARGUMENTS = (flag("--models", "list the models with what a study may set"),)


def run(options: argparse.Namespace) -> int:
    """Print the shipped studies, or the models."""
    import tomllib

    titles = {}
    if options.models:
        from ..study.registry import BROKEN, all_models

        for name, model in all_models().items():
            titles[name] = (
                f"solvers {', '.join(model.solvers)}; reads {', '.join(model.parameters) or 'none'}"
            )
        titles |= {name: f"no model: {why}" for name, why in BROKEN.items()}
    for name, path in shipped_studies().items() if not options.models else ():
        titles[name] = tomllib.loads(path.read_text())["study"]["title"]
    if options.json:
        return print_json(titles)
    width = max(map(len, titles))
    for name, title in titles.items():
        print(f"{name:<{width}}  {title}")
    return OK
