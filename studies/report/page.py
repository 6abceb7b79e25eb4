"""The whole page: which sections, in which order, and how they become one offline HTML file."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from ..case import Run
from ..files import write_atomically
from . import headline, picture
from .blocks import Section, Viewer
from .digest import Digest
from .formatting import plural
from .section_appendix import how_to_reproduce, provenance
from .section_cases import case_table, failures
from .section_convergence import mesh_convergence
from .section_cost import run_time_against_error
from .section_errors import error_against_load, error_against_parameters
from .section_fibres import anisotropy_of_the_response
from .section_limits import small_strain_limits
from .section_measures import all_measures
from .section_mechanics import force_against_indentation, volume_drift
from .section_view import Renderer, still, surfaces


class PictureError(ValueError):
    """A picture that cannot be drawn, and why."""


MOST_BYTES = 5_000_000
_TEMPLATES = Path(__file__).parent / "templates"
_MARGIN = 50_000  # markup around the viewer's data

# the order of the page; a section that has nothing to say returns None. The viewer comes after SECTIONS_BEFORE
SECTIONS_BEFORE: tuple[Callable[[Digest], Section | None], ...] = (
    headline.headline,
    mesh_convergence,
    error_against_parameters,
    error_against_load,
)
SECTIONS_AFTER: tuple[Callable[[Digest], Section | None], ...] = (
    force_against_indentation,
    volume_drift,
    small_strain_limits,
    anisotropy_of_the_response,
    run_time_against_error,
    all_measures,
    case_table,
    failures,
    provenance,
    how_to_reproduce,
)
_JSON_ESCAPES = {"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"}


def write_picture(run: Run, path: Path) -> None:
    """Write a PNG of the first key case: the reference, the model that comes closest, and their difference.

    Raises
    ------
    PictureError
        nothing to draw, or no off-screen renderer on this machine.
    OSError
        disk full or read-only.
    """
    digest = Digest(run)
    panels = still(digest, digest.key_cases[0][1])[0] if digest.cases else []
    if not panels:
        raise PictureError("there is no finished case to draw")
    files, why = picture.render([panels])
    if why:
        raise PictureError(why)
    write_atomically(path, files[0])


def write_report(run: Run, path: Path) -> None:
    """Write the page of a run; the same run gives the same bytes.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    write_atomically(path, _encoded(page_html(run, picture.render)))


def page_html(run: Run, render: Renderer) -> str:
    """The page as text. `render` makes the still pictures of the surface."""
    # overflow is no surprise in what a model that broke down left behind; its numbers are shown as not finite
    with np.errstate(all="ignore"):
        return _page_html(Digest(run), render)


def _page_html(digest: Digest, render: Renderer) -> str:
    run = digest.run
    environment = _environment()
    scripts = [_asset("page.js"), _asset("viewer.js")]
    before, after = (
        [s for make in part if (s := make(digest))] for part in (SECTIONS_BEFORE, SECTIONS_AFTER)
    )

    def page(sections: list[Section]) -> str:
        shown = (
            scripts
            if any(isinstance(b, Viewer) and b.payload for s in sections for b in s.blocks)
            else scripts[:1]
        )
        return environment.get_template("page.html").render(
            title=run.study.get("title") or run.study.get("name", "study"),
            name=run.study.get("name", ""),
            verdict=headline.verdict(digest),
            counts=_counts(run),
            models=digest.legend,
            sections=sections,
            style=_asset("page.css"),
            scripts=shown,
            policy=_policy(shown),
        )

    room = MOST_BYTES - len(_encoded(page(before + after))) - len("".join(scripts).encode()) - _MARGIN
    view = surfaces(digest, room, render)
    return page([*before, *([view] if view else []), *after])


def _encoded(text: str) -> bytes:
    """UTF-8; half a surrogate pair, which JSON can carry into a name, becomes a question mark."""
    return text.encode("utf-8", "replace")


def _counts(run: Run) -> list[tuple[str, str]]:
    """(what, tone) of the three numbers of a run."""
    counts = [(f"{plural(len(run.cases), 'case')} done", "")]
    if run.failed:
        counts.append((f"{len(run.failed)} failed", "bad"))
    if run.missing:
        counts.append((f"{len(run.missing)} missing", "muted"))
    return counts


def _policy(scripts: list[Markup]) -> str:
    """Nothing may be loaded; of the scripts only these may run."""
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    return f"default-src 'none'; style-src 'unsafe-inline'; script-src {allowed}; img-src data:"


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["json"] = script_json
    environment.filters["unbroken"] = lambda text: re.sub(r"(?<=\d) (?=[^\W\d]|%)", "\u00a0", text)
    return environment


def _asset(name: str) -> Markup:
    """A script or style sheet of ours, as it is."""
    return Markup((_TEMPLATES / name).read_text(encoding="utf-8"))


def script_json(value: object) -> Markup:
    """JSON that can stand inside a <script> element: nothing in it can end the element or start another."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return Markup("".join(_JSON_ESCAPES.get(c, c) for c in text))
