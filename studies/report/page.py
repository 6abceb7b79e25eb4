"""The page: its sections in order, and how they become one offline HTML file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from ..machine import write_atomically
from ..measures.case import Run
from ..study.errors import plural
from ..study.registry import load_all
from ..verdict.digest import Digest, digest_of
from ..verdict.verdict import verdicts
from ..verdict.words import BESIDE, told
from . import headline, picture
from .blocks import Section, Viewer
from .plots import MARKER_PATHS, shape
from .section_charts import errors, force_against_indentation, run_time_against_error, volume_drift
from .section_measurement import against_measurement, inputs
from .section_scene import scene
from .section_tables import (
    all_measures,
    case_table,
    failures,
    how_to_reproduce,
    small_strain_limits,
)
from .section_view import heading, still, surface

_NAME = re.compile(r"\b[a-z]+(?:-[a-z0-9:]+)+|\b[a-z_]+(?:\.[a-z0-9_]+)+")  # a model or a key
_TEMPLATES = Path(__file__).parent / "templates"

Make = Callable[[Digest], Section | None]

# in the order of the page; a section without content returns None. SECTIONS of other files `section_NAME.py` come
# between these and the APPENDIX
SECTIONS: tuple[Make, ...] = (
    headline.headline,
    errors,
    surface,
    inputs,
    against_measurement,
    force_against_indentation,
    volume_drift,
    small_strain_limits,
    run_time_against_error,
    all_measures,
)
APPENDIX: tuple[Make, ...] = (case_table, failures, how_to_reproduce)


def write_picture(run: Run, path: Path) -> None:
    """Write a PNG of the first key case: the focus model, the reference, and their difference.

    Raises
    ------
    ValueError
        no finished case with a displacement to draw.
    OSError
        disk full or read-only.
    """
    digest = Digest(run)
    role, case = digest.key_cases[0] if digest.cases else ("", None)
    panels = [] if case is None else still(digest, case)[0]
    if case is None or not panels:
        raise ValueError("there is no finished case to draw")
    write_atomically(path, picture.labelled(panels, heading(digest, role, case)))


def write_report(run: Run, path: Path) -> None:
    """Write the page of a run; the same run gives the same bytes.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    # a lone surrogate, which JSON allows in names, becomes a question mark
    write_atomically(path, page_html(run).encode("utf-8", "replace"))


@np.errstate(
    all="ignore"
)  # the numbers of a model that broke down may overflow; they are shown as not finite
def every_section(digest: Digest) -> list[Section]:
    """All sections that have content."""
    others = load_all("vdmbench.report", "section_")
    added = [make for module in others for make in getattr(module, "SECTIONS", ())]
    return [section for make in (*SECTIONS, *added, *APPENDIX) if (section := make(digest))]


@np.errstate(all="ignore")
def page_html(run: Run) -> str:
    """The page as text."""
    digest = digest_of(run)
    sections, found = every_section(digest), verdicts(digest)
    words = told(found)
    viewed = any(isinstance(b, Viewer) and b.payload for section in sections for b in section.blocks)
    scripts = _scripts() if viewed else _scripts()[:1]
    page = _environment().get_template("page.html")
    return page.render(
        run=run,
        told=words,
        further={question: said for question, said in words["further"].items() if question not in BESIDE},
        colours={name: digest.colour(name) for name in digest.models},
        take=headline.what_to_take(found),
        limits=headline.against_limits(found, digest),
        scene=scene(digest),
        style=asset("page.css"),
        sections=sections,
        scripts=scripts,
        policy=_policy(scripts),
    )


# --- the document ---


def _scripts() -> list[Markup]:
    viewer = asset("viewer_draw.js") + "\n" + asset("viewer.js")
    return [asset("page.js"), Markup('"use strict";\n(() => {\n{}})();\n').replace("{}", viewer, 1)]


def _policy(scripts: list[Markup]) -> str:
    """Content security policy: the page loads nothing, and only these scripts run."""
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
    environment.filters["count"] = plural
    environment.globals["marker_paths"] = MARKER_PATHS
    environment.filters["unbroken"] = unbroken
    return environment


def unbroken(text: str) -> str:
    """Text without line breaks between a number and its unit, in `key = value`, and inside names."""
    text = re.sub(r"(?<=\w) = (?=\S)", "\u00a0=\u00a0", text)
    text = re.sub(r"(?<=\d) (?=[^\W\d]|%)|(?<=±) ", "\u00a0", text)
    if not _NAME.search(text):
        return text
    return Markup(_NAME.sub(r'<span class="whole">\g<0></span>', str(escape(text))))


def asset(name: str) -> Markup:
    """A script or style sheet of the templates, without escapes."""
    return Markup((_TEMPLATES / name).read_text(encoding="utf-8"))
