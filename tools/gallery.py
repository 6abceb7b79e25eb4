"""The pictures that the documents show of the claims: a figure of each as SVG, for light and dark."""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path

from markupsafe import escape

from tools.documents import GALLERY, ROOT
from vdmbench.evidence.claims_page import Verdict
from vdmbench.report.blocks import Figure
from vdmbench.report.plots import shape
from vdmbench.verdict.palette import COLOURS

_CSS = ROOT / "studies" / "report" / "templates" / "page.css"
_COLUMNS = 3  # of pictures in a row
_WIDTH, _HEIGHT = 317.0, 216.0  # of a figure, in its own units
_LINE, _SIDE = 13.0, 8.0
_GLYPHS = "●■▲◆▼✚✖"  # the markers of the figures: o s ^ D v P X
_PLAIN = str.maketrans("[]|", "() ")  # what would end a picture's text in Markdown
_DASHES = ("dashed", "dash-dotted", "dotted")
_LETTERS = 60  # in a line of the legend


def claim_picture(verdict: Verdict) -> str | None:
    """A claim's first figure with its verdict above and its legend below, for light and dark; None without one."""
    if not verdict.judgement.figures:
        return None
    figure = verdict.judgement.figures[0]
    legend = _legend(figure, verdict.digests[0].legend)
    title = textwrap.wrap(f"{verdict.claim.number}. {verdict.claim.text}", 52)
    texts = [_text(k, line, "claim") for k, line in enumerate(title)]
    texts.append(_text(len(title), f"{verdict.judgement.verdict}: {figure.title}", "verdict"))
    top = _LINE * (max(len(title), 2) + 1.6)  # neighbours in a table stand at one height
    height = top + _HEIGHT + _LINE * (len(legend) + 0.8)
    body = str(figure.svg).replace(
        "<svg ", f'<svg x="{_SIDE:g}" y="{top:g}" width="{_WIDTH:g}" height="{_HEIGHT:g}" ', 1
    )
    below = [
        f'<text x="{_SIDE:g}" y="{top + _HEIGHT + _LINE * (k + 1):g}">{line}</text>'
        for k, line in enumerate(legend)
    ]
    told = re.search(r'aria-label="([^"]*)"', body)
    parts = [*texts, body, *below]
    return _picture(_WIDTH + 2 * _SIDE, height, told.group(1) if told else "", parts)


def _picture(width: float, height: float, told: str, parts: Sequence[str]) -> str:
    """An SVG of these parts, for light and dark; `told` says in words what is shown."""
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
            f'height="{height:g}" role="img" aria-label="{told}">',
            f"<style>{figure_style()}</style>",
            f'<rect width="{width:g}" height="{height:g}" fill="var(--paper)"/>',
            *parts,
            "</svg>\n",
        ]
    )


def _text(line: int, text: str, kind: str) -> str:
    return f'<text class="{kind}" x="{_SIDE:g}" y="{_LINE * (line + 1.2):g}">{escape(text)}</text>'


def _legend(figure: Figure, models: Sequence[tuple[int, str, bool]]) -> list[str]:
    """Lines of markers and names of the models that the figure draws."""
    svg = str(figure.svg)
    told = re.search(r'aria-label="([^"]*)"', svg)
    words = html.unescape(told.group(1)) if told else ""
    lines: list[list[str]] = [[]]
    letters = 0
    for number, name, is_reference in models:
        colour = "reference" if is_reference else f"model-{number % COLOURS}"
        drawn = re.search(rf"(?:: |, | and ){re.escape(name)} (?:from )?[\d−]", words)
        if not drawn or f">{escape(name)}<" in svg:  # the name stands in the figure
            continue
        name = f"{name} (reference)" if is_reference else f"{name}{_dashed(number)}"
        if letters + len(name) + 4 > _LETTERS and lines[-1]:
            lines.append([])
            letters = 0
        mark = glyph(0 if is_reference else number)
        lines[-1].append(f'<tspan fill="var(--{colour})">{mark}</tspan> {escape(name)}')
        letters += len(name) + 4
    return ["  ".join(line).replace("  <", "\u2003<") for line in lines if line]


def _dashed(number: int) -> str:
    """How the line of a place in the palette is broken, where colours come again."""
    return f" ({_DASHES[(number // COLOURS - 1) % 3]})" if number >= COLOURS else ""


def glyph(number: int) -> str:
    """A letter that looks like the marker of a place in the palette."""
    return _GLYPHS[shape(number)]


def figure_style() -> str:
    """The colours of the page, light and dark, and what else its figures take from its style sheet."""
    css = _CSS.read_text()
    light = re.search(r":root \{[^}]*\}", css)
    dark = re.search(r"@media \(prefers-color-scheme: dark\) \{\s*:root \{[^}]*\}\s*\}", css)
    if light is None or dark is None:
        raise RuntimeError(f"{_CSS} has lost its colours")
    own = (
        "text { font: 9.5px sans-serif; fill: var(--ink); } .claim { font-weight: 600; } "
        ".verdict { fill: var(--quiet); } .plot { fill: var(--ink); } .plot text { font-family: sans-serif; }"
    )
    return re.sub(r"\s+", " ", f"{light.group(0)} {dark.group(0)} {own}")


def write_claim_pictures(found: Sequence[Verdict], directory: Path = GALLERY) -> list[tuple[str, str]]:
    """Write `claim-N.svg` of every claim that has a figure; (file name, what it shows) of each."""
    for old in directory.glob("claim-*.svg"):
        old.unlink()
    written = []
    for verdict in found:
        picture = claim_picture(verdict)
        if picture is not None:
            path = directory / f"claim-{verdict.claim.number}.svg"
            path.write_text(picture, encoding="utf-8")
            title = verdict.judgement.figures[0].title
            written.append((path.name, f"Claim {verdict.claim.number}, {verdict.judgement.verdict}: {title}"))
    return written


def as_markdown(pictures: Sequence[tuple[str, str]]) -> str:
    """The pictures as a table of so many columns, each a link to its full size."""
    cells = [
        f"[![{told.translate(_PLAIN)}](../gallery/{name})](../gallery/{name})" for name, told in pictures
    ]
    rows = [cells[k : k + _COLUMNS] for k in range(0, len(cells), _COLUMNS)]
    if not rows:
        return ""
    rows[-1] += [""] * (_COLUMNS - len(rows[-1]))
    lines = [f"| {' | '.join(row)} |\n" for row in rows]
    lines.insert(1, f"|{' --- |' * _COLUMNS}\n")
    return "".join(lines)
