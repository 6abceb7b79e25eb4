"""Small typed studies for cases and runs made by hand."""

from __future__ import annotations

import dataclasses
from typing import Any

from vdmbench.measures.case import CaseResult
from vdmbench.study.config import resolved
from vdmbench.study.schema import Study

_LEAST: dict[str, Any] = {
    "study": {"name": "ball", "models": ["vdm-paper"]},
    "geometry": {"shape": "sphere"},
    "tissue": {"youngs_modulus": 5e3, "poisson_ratio": 0.45},
}


def typed_study(**tables: Any) -> Study:
    """A study of these tables, which need not fit each other, and of the least that a study has."""
    return Study.model_validate(_LEAST | tables)


def asked(case: CaseResult, **tables: Any) -> CaseResult:
    """The case with these tables of its study in place of its own."""
    return dataclasses.replace(case, study=Study.model_validate(resolved(case.study) | tables))
