"""What a gate found, as JUnit XML for continuous integration and as Markdown for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree

from .gate import MISSING, NEW, NOT_COMPARABLE, REGRESSED, SAME, Finding, counts

_SKIPPED = (NOT_COMPARABLE, MISSING, NEW)  # nothing was compared


def describe(finding: Finding) -> str:
    """One finding in a line."""
    place = " / ".join(part for part in (finding.case, finding.model, finding.metric) if part)
    if finding.why:
        return f"{finding.outcome}: {place}: {finding.why}"
    unit = "" if finding.unit == "1" else f" {finding.unit}"
    return (
        f"{finding.outcome}: {place}: {_number(finding.was)}{unit} -> {_number(finding.now)}{unit} "
        f"(tolerance {_number(finding.tolerance)}{unit})"
    )


def summary(findings: Sequence[Finding]) -> str:
    """The counts in one line."""
    return ", ".join(f"{count} {outcome}" for outcome, count in counts(findings).items()) or "nothing"


def junit(study: str, findings: Sequence[Finding], *, allow_missing: bool = False) -> bytes:
    """JUnit XML: one test case per finding.

    What got worse is a failure, and what is missing unless that is allowed; what was not compared is skipped.
    """
    failures = REGRESSED if allow_missing else (*REGRESSED, MISSING)
    skipped = tuple(outcome for outcome in _SKIPPED if outcome not in failures)
    suite = ElementTree.Element(
        "testsuite",
        name=_clean(f"accuracy of {study}"),
        tests=str(len(findings)),
        failures=str(sum(f.outcome in failures for f in findings)),
        skipped=str(sum(f.outcome in skipped for f in findings)),
        errors="0",
    )
    for finding in findings:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=_clean(".".join(part for part in (study, finding.model) if part)),
            name=_clean(": ".join(part for part in (finding.case, finding.metric) if part)),
        )
        if finding.outcome in failures:
            ElementTree.SubElement(case, "failure", message=_clean(describe(finding)))
        elif finding.outcome in skipped:
            ElementTree.SubElement(case, "skipped", message=_clean(describe(finding)))
    root = ElementTree.Element("testsuites")
    root.append(suite)
    out: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return out


def markdown(study: str, baseline: str, findings: Sequence[Finding]) -> str:
    """A summary with a table of everything that is not as it was; `baseline` is a sentence on it."""
    text = f"# Accuracy of {_cell(study)}\n\n{summary(findings)}. {_cell(baseline)}\n"
    changed = [finding for finding in findings if finding.outcome != SAME]
    if changed:
        text += "\n| outcome | case | model | metric | was | is | tolerance | why |\n" + "| --- " * 8 + "|\n"
    for finding in changed:
        cells = [finding.outcome, finding.case, finding.model, finding.metric]
        cells += [_number(value) for value in (finding.was, finding.now, finding.tolerance)]
        text += f"| {' | '.join(_cell(cell) for cell in (*cells, finding.why))} |\n"
    return text


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.4g}"


def _cell(text: str) -> str:
    return _clean(text).replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def _clean(text: str) -> str:
    """Without the characters that XML 1.0 cannot hold."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)
