"""The verdicts in sentences, from the templates in `words.txt`: the same on page, terminal and in JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ..scene.warnings import MOST_DRIFT, MOST_MOVED
from ..study.errors import plural
from ..study.registry import Family
from . import formatting as f
from .verdict import Verdict, Verdicts

TITLES = {
    Family.PRINTED: "VDM as printed",
    Family.DERIVED: "VDM, derived",
    Family.PEERS: "Surface peers",
    Family.ELEMENTS: "Elements",
    Family.ENGINES: "Engines",
}
WHY = "Why not?"
MEASURED = "What does the measurement say?"
LOAD = "Up to which load?"
SURE = "How sure is this?"
BESIDE = (WHY, LOAD)  # the page answers these in the table of limits
ON_TERMINAL = (WHY, MEASURED, LOAD)


def told(verdicts: Verdicts) -> dict[str, Any]:
    """The verdicts in words, as in the JSON output.

    Returns
    -------
    dict
        `rows`: for each family its `title`, its `word`, the `model` that decides, its `numbers`, and one `text`;
        `notes` that hold for all rows; `instead`: which model to take; `further`: question -> its answer.
    """
    judged = [one for one in verdicts.asked if one.model]
    loads = [f"{one.model}: {text}" for one in judged for text in said("reached", one)]
    further = {
        WHY: [f"{one.model}: {text}" for one in judged for text in why_not(one)],
        MEASURED: said("measured", verdicts),
        LOAD: [*loads, *said("small_strain", verdicts)],
        SURE: said("sure", verdicts),
    }
    return {
        "rows": [_row(one, said("row", one, verdicts)) for one in verdicts.asked],
        "notes": said("notes", verdicts, MOST_MOVED, MOST_DRIFT),
        "instead": [text for one in verdicts.take for text in said("instead", one)],
        "further": {question: answer for question, answer in further.items() if answer},
    }


def _row(one: Verdict, numbers: Sequence[str]) -> dict[str, Any]:
    text = ": ".join(filter(None, (one.model, "; ".join(numbers))))
    about = {"family": one.family, "title": TITLES[Family(one.family)], "word": one.word, "model": one.model}
    return about | {"numbers": numbers, "text": f"{text}."}


def why_not(one: Verdict) -> list[str]:
    """The causes of a verdict that is not "yes", in words."""
    return [text for reason in one.why_not for text in said("why", reason)]


_WORDS = Path(__file__).with_suffix(".txt")


def said(macro: str, *about: Any, file: Path = _WORDS) -> list[str]:
    """The sentences of a macro in a template file, one for each line that it renders."""
    lines = str(getattr(_templates(file), macro)(*about)).split("\n")
    return [" ".join(line.split()) for line in lines if line.strip()]


@cache
def _templates(file: Path) -> Any:
    environment = Environment(
        loader=FileSystemLoader(file.parent),
        autoescape=False,  # these are texts: whoever puts them into a page escapes them
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    environment.filters |= {
        "known": lambda value: value is not None and math.isfinite(value),
        "short": f.short_percent,
        "amount": f.quantity,
        "bar": lambda value, bar: f.measure(value, bar=bar),
        "plain": f.plain,
        "listed": f.listed,
        "first_of": f.first_of,
        "count": plural,
        "capital": f.capital,
        "loads": f.loads_in_words,
        "span": lambda values, unit="1", digits=4: f.span(values, unit, digits),
        "mm": lambda metres: f"{f.plain(1e3 * metres, 2)} mm",
        "lengths": f.lengths,
        "degrees": lambda angle: f"{math.degrees(angle):.0f}°",
    }
    return environment.get_template(file.name).module
