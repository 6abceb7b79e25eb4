"""The documents as a site: pages from elsewhere in the repository join those of `docs/`, with their links mended.

A hook of mkdocs, named in `mkdocs.yml`.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
# where a document is in the repository -> where it is on the site
ELSEWHERE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changes.md",
    "studies/STUDY.md": "reference/study-keys.md",
    "results/FORMAT.md": "reference/files.md",
    "vdm/README.md": "methods/vdm.md",
    "fem_reference/README.md": "methods/elements.md",
    "results/verification.md": "evidence/verification.md",
    "results/calibrations.md": "evidence/calibrations.md",
    "results/error-bars.md": "evidence/error-bars.md",
}
_SITE = {on_site: home for home, on_site in ELSEWHERE.items()}
_LINK = re.compile(r"(!?)\[((?:[^][]|\[[^]]*\])*)\]\(([^)#\s]+)(#[^)]*)?\)")


def with_links_of_the_site(text: str, home: str, on_site: str) -> str:
    """A document with its links as the site has them; what is not on the site keeps its words alone.

    Parameters
    ----------
    home : where the document is in the repository
    on_site : where it is on the site
    """

    def mended(link: re.Match[str]) -> str:
        mark, words, target, anchor = link.groups()
        words = _LINK.sub(mended, words)
        if "://" in target:
            return f"{mark}[{words}]({target}{anchor or ''})"
        place = posixpath.normpath(posixpath.join(posixpath.dirname(home), target))
        there = ELSEWHERE.get(place) or (place.removeprefix("docs/") if place.startswith("docs/") else None)
        if there is None:
            return str(words)
        return f"{mark}[{words}]({posixpath.relpath(there, posixpath.dirname(on_site))}{anchor or ''})"

    return _LINK.sub(mended, text)


def on_files(files: Any, config: Any) -> Any:
    """mkdocs: add the documents that live elsewhere."""
    from mkdocs.structure.files import File

    for home, on_site in ELSEWHERE.items():
        files.append(File.generated(config, on_site, content=(ROOT / home).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """mkdocs: mend the links of a page."""
    on_site = page.file.src_uri
    return with_links_of_the_site(markdown, _SITE.get(on_site, f"docs/{on_site}"), on_site)
