"""Sections become one HTML document that needs nothing from outside."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib import colormaps
from matplotlib.colors import to_hex

from ..verdict.words import BESIDE, Told
from .blocks import Scene, Section, Table, Viewer
from .picture import COLOUR_MAPS
from .plots import shape
from .svg import MARKER_PATHS

_STOPS = 12  # of a colour map where it is a gradient
_NAME = re.compile(r"\b[a-z]+(?:-[a-z0-9:]+)+|\b[a-z_]+(?:\.[a-z0-9_]+)+")  # of a model or a key
_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Head:
    """What stands above the sections: what is said of the families, colours of models, tables, the scene."""

    told: Told
    colours: Mapping[str, int] = field(default_factory=dict)  # model -> place
    take: Table | None = None
    limits: Table | None = None
    scene: Scene | None = None


def html_document(
    *,
    title: str,
    name: str,
    counts: Sequence[tuple[str, str]],
    sections: Sequence[Section],
    notes: Sequence[str] = (),
    models: Sequence[tuple[int, str, bool]] = (),
    head: Head | None = None,
    cases: Sequence[str] = (),
) -> str:
    """The document as text. `counts` are (what, tone) badges, `head` the verdicts.

    `notes` stand for the verdicts where there are none. `cases` are named under the pointer of charts.
    """
    viewed = any(isinstance(b, Viewer) and b.payload for section in sections for b in section.blocks)
    scripts = _scripts() if viewed else _scripts()[:1]
    head = head or Head(told=Told(notes=tuple(notes)))
    return (
        _environment()
        .get_template("page.html")
        .render(
            title=title,
            name=name,
            colours=head.colours,
            told=head.told,
            further=[answer for answer in head.told.further if answer.question not in BESIDE],
            take=head.take,
            limits=head.limits,
            scene=head.scene,
            cases=json.dumps(cases),
            counts=counts,
            models=models,
            sections=sections,
            style=asset("page.css"),
            scripts=scripts,
            policy=_policy(scripts),
        )
    )


def encoded(text: str) -> bytes:
    """UTF-8; half a surrogate pair, which JSON can carry into a name, becomes a question mark."""
    return text.encode("utf-8", "replace")


_VIEWER = (
    "viewer_data.js",
    "viewer_gl.js",
    "viewer_labels.js",
    "viewer_measured.js",
    "viewer.js",
    "viewer_controls.js",
)


def _scripts() -> list[Markup]:
    viewer = Markup("\n").join(asset(name) for name in _VIEWER)
    return [
        asset("page.js") + asset("charts.js"),
        Markup('"use strict";\n(() => {\n{}})();\n').replace("{}", viewer, 1),
    ]


def _policy(scripts: list[Markup]) -> str:
    """Nothing may be loaded; of the scripts only these may run."""
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return f"default-src 'none'; style-src 'unsafe-inline'; script-src {allowed}; img-src data:"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters["shape"] = shape
    environment.globals["marker_paths"] = MARKER_PATHS
    environment.globals["ramps"] = {
        name: [to_hex(colormaps[name](k / _STOPS)) for k in range(_STOPS + 1)] for name in COLOUR_MAPS
    }
    environment.filters["unbroken"] = unbroken
    return environment


def unbroken(text: str) -> str:
    """A number stays with its unit, a key with its value, a name in one piece: `levels = 2` on one line."""
    text = re.sub(r"(?<=\w) = (?=\S)", "\u00a0=\u00a0", text)
    text = re.sub(r"(?<=\d) (?=[^\W\d]|%)|(?<=±) ", "\u00a0", text)
    if not _NAME.search(text):
        return text
    return Markup(_NAME.sub(r'<span class="whole">\g<0></span>', str(escape(text))))


def asset(name: str) -> Markup:
    """A script or style sheet of ours, as it is."""
    return Markup((_TEMPLATES / name).read_text(encoding="utf-8"))
