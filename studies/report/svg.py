"""SVG of matplotlib as a part of the page: it takes its colours and fonts from there.

Text, axes and curves are drawn in marker colours and turned into CSS variables afterwards, so that one drawing
serves light, dark and print. Ids come from a salt that the caller gives: the same data gives the same bytes.
"""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

from markupsafe import Markup, escape
from matplotlib.figure import Figure

from ..verdict.palette import COLOURS

ID = "told:"  # how the id of a curve begins whose words the page's script shows
# drawn in these, shown in the page's
INK, GRID, REFERENCE = "#010203", "#020304", "#030405"
MODELS = tuple(f"#0405{k:02x}" for k in range(COLOURS))
# the markers of the charts, o s ^ D v P X, in a box of 14 by 10 around (7, 5)
MARKER_PATHS = (
    "M7 1.2a3.8 3.8 0 1 1-.01 0Z",
    "M3.4 1.4h7.2v7.2h-7.2Z",
    "M7 .8 11.2 9H2.8Z",
    "M7 .4 11.6 5 7 9.6 2.4 5Z",
    "M7 9.2 2.8 1h8.4Z",
    "M5.6 1h2.8v2.6h2.6v2.8H8.4V9H5.6V6.4H3V3.6h2.6Z",
    "M4.8.8 7 3 9.2.8 11.2 2.8 9 5l2.2 2.2-2 2L7 7 4.8 9.2l-2-2L5 5 2.8 2.8Z",
)
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "sheet",
    "font.family": "DejaVu Sans",
    "font.size": 8.3,
    "text.color": INK,
    "text.parse_math": False,
    "axes.unicode_minus": True,
}


def svg_of(figure: Figure) -> str:
    """The SVG file of a figure, to be drawn inside `rc_context(STYLE)`."""
    out = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with warnings.catch_warnings():
        # a glyph that matplotlib's own font lacks is drawn by the browser's
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(out, format="svg", metadata=metadata, transparent=True)
    return out.getvalue()


def for_the_page(svg: str, alt: str, salt: str, attributes: str = "") -> Markup:
    """The <svg> element of a drawing with the page's colours, sized by CSS, ids unique on the page.

    `alt` says in words what it shows; `attributes` are further ones for scripts. Matplotlib has escaped the
    texts of the drawing.
    """
    # bare lines first: of patterns that begin with white space each takes as long as all of these together
    svg = "\n".join(filter(None, map(str.strip, svg[svg.index("<svg") :].split("\n"))))
    view_box = re.search(r'viewBox="([^"]+)"', svg)
    box = view_box.group(1) if view_box else ""
    svg = svg[svg.index(">") + 1 :]
    svg = svg.replace("xlink:href=", "href=")
    told = re.findall(rf' id="{ID}([^"]*)"', svg)
    svg = re.sub(rf' id="{ID}[^"]*"', f" {_TOLD}", svg)
    names = dict.fromkeys(re.findall(r' id="([^"]+)"', svg))
    used = {*re.findall(r"url\(#([^)]+)\)", svg), *re.findall(r'href="#([^"]+)"', svg)}
    short = {name: f"{salt}-{k}" for k, name in enumerate(n for n in names if n in used)}
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{short[m[1]]}"' if m[1] in short else "", svg)
    svg = re.sub(r"url\(#([^)]+)\)", lambda m: f"url(#{short[m[1]]})", svg)
    svg = re.sub(r'href="#([^"]+)"', lambda m: f'href="#{short[m[1]]}"', svg)
    colours = {INK: "var(--ink)", GRID: "var(--grid)", REFERENCE: "var(--reference)"}
    colours |= {code: f"var(--model-{k})" for k, code in enumerate(MODELS)}
    for code, variable in colours.items():
        svg = svg.replace(code, variable)
    svg = re.sub(r"\n<style.*?</style>", "", svg, flags=re.S)
    svg = re.sub(r" font-family: [^;\"]+;?", "", svg)
    svg = _TAG.sub(lambda tag: _BEYOND_HUNDREDTHS.sub("", tag[0]), svg)  # not in its texts
    svg = re.sub(r' transform="rotate\(-0 [^"]*"', "", svg)
    for text in told:
        svg = svg.replace(_TOLD, f'data-told="{text}"', 1)
    return Markup(
        f'<svg viewBox="{box}" role="img" aria-label="{escape(alt)}" class="plot"{attributes}>{svg}\n'
    )


_TOLD = "\ue001"  # where a curve's words come back
_TAG = re.compile(r"<[^>]*>")
_BEYOND_HUNDREDTHS = re.compile(r"(?<=\d\.\d\d)\d+")
