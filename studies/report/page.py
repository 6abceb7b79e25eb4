"""The whole page: which sections, in which order, and how they become one offline HTML file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from ..machine import write_atomically
from ..measures.case import Run
from ..study.registry import load_all
from ..verdict.digest import Digest, digest_of
from ..verdict.formatting import plural
from ..verdict.verdict import verdicts
from ..verdict.words import told
from . import headline, picture
from .blocks import Section
from .document import Head, encoded, html_document
from .section_appendix import how_to_reproduce, provenance
from .section_cases import case_table, failures
from .section_cost import run_time_against_error
from .section_errors import error_against_load, error_against_parameters
from .section_force import force_against_indentation
from .section_inputs import inputs
from .section_limits import small_strain_limits
from .section_measurement import against_measurement
from .section_measures import all_measures
from .section_scene import scene
from .section_view import heading, still, surfaces


class PictureError(ValueError):
    """There is nothing to draw."""


MOST_BYTES = 5_000_000

Make = Callable[[Digest], Section | None]

# the order of the page; a section that has nothing to say returns None. The viewer comes after BEFORE. What other
# files `section_NAME.py` have in their SECTIONS comes before the APPENDIX
BEFORE: tuple[Make, ...] = (
    headline.headline,
    error_against_parameters,
    error_against_load,
)
AFTER: tuple[Make, ...] = (
    inputs,
    against_measurement,
    force_against_indentation,
    small_strain_limits,
    run_time_against_error,
    all_measures,
)
APPENDIX: tuple[Make, ...] = (case_table, failures, provenance, how_to_reproduce)


@cache
def _after() -> tuple[Make, ...]:
    """What comes after the viewer."""
    others = load_all("vdmbench.report", "section_")
    return (*AFTER, *(make for module in others for make in getattr(module, "SECTIONS", ())), *APPENDIX)


def write_picture(run: Run, path: Path) -> None:
    """Write a PNG of the first key case: the reference, the model that comes closest, and their difference.

    Raises
    ------
    PictureError
        no finished case with a displacement to draw.
    OSError
        disk full or read-only.
    """
    digest = Digest(run)
    role, case = digest.key_cases[0] if digest.cases else ("", None)
    panels = [] if case is None else still(digest, case)[0]
    if case is None or not panels:
        raise PictureError("there is no finished case to draw")
    write_atomically(path, picture.labelled(panels, heading(digest, role, case)))


def write_report(run: Run, path: Path) -> None:
    """Write the page of a run; the same run gives the same bytes.

    Raises
    ------
    OSError
        disk full or read-only.
    """
    write_atomically(path, encoded(page_html(run)))


def page_html(run: Run, *, stills: bool = True) -> str:
    """The page as text, with still pictures of the surface or without."""
    # overflow is no surprise in what a model that broke down left behind; its numbers are shown as not finite
    with np.errstate(all="ignore"):
        return _page_html(digest_of(run), stills=stills)


def every_section(digest: Digest) -> list[Section]:
    """All that has something to say, but for the viewer."""
    with np.errstate(all="ignore"):
        return _made(digest, (*BEFORE, *_after()))


def _made(digest: Digest, makers: Sequence[Make]) -> list[Section]:
    return [section for make in makers if (section := make(digest))]


def _page_html(digest: Digest, *, stills: bool) -> str:
    run, found = digest.run, verdicts(digest)
    before, after = _made(digest, BEFORE), _made(digest, _after())
    head = Head(
        told(found),
        {name: digest.colour(name) for name in digest.models},
        headline.what_to_take(found),
        headline.against_limits(found, digest),
        scene(digest),
    )

    def page(sections: list[Section]) -> str:
        return html_document(
            title=run.study.study.title,
            name=run.study.study.name,
            head=head,
            cases=[digest.case_name(case) for case in digest.cases],
            counts=_counts(run),
            models=digest.legend,
            sections=sections,
        )

    text = ""
    for view in surfaces(digest, stills=stills):
        text = page([*before, *view, *after])
        if len(encoded(text)) <= MOST_BYTES:
            break
    return text


def _counts(run: Run) -> list[tuple[str, str]]:
    """(what, tone) of the three numbers of a run."""
    counts = [(f"{plural(len(run.cases), 'case')} done", "")]
    if len(run.failed) > run.damaged:
        counts.append((f"{len(run.failed) - run.damaged} failed", "bad"))
    if run.damaged:
        counts.append((f"{run.damaged} damaged", "bad"))
    if run.missing:
        counts.append((f"{len(run.missing)} missing", "muted"))
    return counts
