"""The claims in the documents are those of the code, each with its picture."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from tools import claims, documents, gallery
from vdmbench.evidence.claims import CLAIMS
from vdmbench.report.judgement import FAILS, HOLDS, OPEN, WITHIN_LIMITS


def test_every_claim_is_decided() -> None:
    rows = documents.cells(documents.shown(claims.DOCUMENT, claims.PART))[1:]
    assert [row[0] for row in rows] == [f"{c.number}. {c.text}" for c in CLAIMS.values()]
    assert {row[1] for row in rows} <= {HOLDS, WITHIN_LIMITS, FAILS, OPEN}
    assert sum(row[1] == OPEN for row in rows) <= 1, "claim 8: the reference's own error decides"
    assert not [row for row in rows if "bar not measured" in row[2]]
    shown = {name for row in rows for name in row[3].split(", ")}
    assert shown == set(claims.studies_on_trial())


def test_every_claim_has_its_picture() -> None:
    for number in CLAIMS:
        path = gallery.GALLERY / f"claim-{number}.svg"
        root = ElementTree.fromstring(path.read_text())
        assert f"(../gallery/{path.name})" in claims.DOCUMENT.read_text()
        assert root.get("aria-label")
        style = root.findtext("{http://www.w3.org/2000/svg}style") or ""
        assert "prefers-color-scheme: dark" in style
        used = set(re.findall(r"var\((--[a-z0-9-]+)\)", path.read_text()))
        assert used <= set(re.findall(r"(--[a-z0-9-]+):", style)), "a colour that is not defined"
