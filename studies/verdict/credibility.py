"""What a run shows of its own credibility, by the categories of FDA's guidance and the factors of ASME V&V 40.

FDA, "Assessing the Credibility of Computational Modeling and Simulation in Medical Device Submissions", November
2023, sorts evidence into eight categories; ASME V&V 40-2018 names the factors of verification, validation and
applicability. All is computed from stored results. None of it judges whether it is enough: that depends on the
question that a model is to answer, and on what a wrong answer costs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..measures import uncertainty
from ..measures.case import CaseResult
from ..measures.input_spread import STRAIGHT
from .digest import Digest, failed_steps
from .formatting import listed, plural, short_percent

SHOWN, PARTLY, NOT = "shown", "partly", "not"


@dataclass(frozen=True)
class Evidence:
    """One category.

    Attributes
    ----------
    name, source : what it is called, and where: the category of FDA's guidance, the factor of V&V 40
    word : SHOWN, PARTLY or NOT
    why : in one line
    """

    name: str
    source: str
    word: str
    why: str


def credibility(digest: Digest) -> list[Evidence]:
    """Every category, in the order in which a model is tried; none where no case has a result."""
    if not digest.cases:
        return []
    return list(_evidence(digest))


def _evidence(digest: Digest) -> Iterator[Evidence]:
    yield Evidence("Code verification", "FDA category 1; V&V 40 code verification", *_code(digest))
    yield Evidence(
        "Calculation verification", "FDA category 8; V&V 40 calculation verification", *_calculation(digest)
    )
    yield Evidence("Input uncertainty", "FDA category 8; V&V 40 model inputs", *_inputs(digest))
    yield Evidence("Calibration", "FDA category 2", *_calibration(digest))
    yield Evidence(
        "Comparison with measurement", "FDA category 3; V&V 40 comparator and assessment", *_measured(digest)
    )
    yield Evidence("Applicability", "V&V 40 applicability", *_applicability(digest))


def _code(digest: Digest) -> tuple[str, str]:
    """What a run can show of its code: models that are other programs' equations held against each other."""
    others = [name for name in digest.compared if name != digest.coarse_reference]
    if digest.reference is None or not others:
        return (
            NOT,
            "no model is held against another one; the repository's tests hold each to exact solutions",
        )
    commits = {case.provenance.get("commit", "") for case in digest.cases}
    dirty = any(commit.endswith("-dirty") for commit in commits)
    state = ", from a changed source tree" if dirty else ""
    return PARTLY, (
        f"{plural(len(others), 'model')} held against {digest.reference} here{state}; exact solutions and orders "
        "of convergence are in the repository's tests, not in this run"
    )


def _calculation(digest: Digest) -> tuple[str, str]:
    estimates = [uncertainty.stored_estimate(case.reference_error) for case in digest.cases]
    found = [estimate for estimate in estimates if estimate is not None]
    unsolved = sum(bool(failed_steps(model)) for case in digest.cases for model in case.models.values())
    stopped = f"; {plural(unsolved, 'result')} stopped at some load" if unsolved else ""
    if not found:
        return NOT, f"one mesh only: levels = 3 in [uncertainty] measures the error of the mesh{stopped}"
    bar = short_percent(float(np.median([estimate.gci for estimate in found])))
    orders = sum(estimate.reasonable for estimate in found)
    count = f"{len(found)} of {plural(len(digest.cases), 'case')}"
    text = f"mesh levels bound the reference's error, {bar} (GCI, median), in {count}"
    if len(found) == len(digest.cases) and orders == len(found) and not unsolved:
        return SHOWN, f"{text}, with an observed order"
    why = "" if orders == len(found) else f"; an order was observed in {orders}"
    return PARTLY, f"{text}{why}{stopped}; the surface models are on one mesh"


def _inputs(digest: Digest) -> tuple[str, str]:
    known = [case.inputs for case in digest.cases if case.inputs is not None]
    if not known:
        return NOT, "the study has no [inputs], so that nothing tells how well its numbers are known"
    keys = listed(known[0].keys)
    finite = all(math.isfinite(spread.displacement) for one in known for spread in one.models.values())
    text = f"{keys} by {known[0].method}, in {len(known)} of {plural(len(digest.cases), 'case')}"
    rough = any(spread.bend > STRAIGHT for one in known for spread in one.models.values())
    lacks = [
        *(["a model has no answer to some variation"] if not finite else []),
        *(["an answer bends, so that first order is rough"] if rough else []),
    ]
    shape = "the body's shape is not among them"
    if len(known) == len(digest.cases) and not lacks:
        return SHOWN, f"{text}; {shape}"
    return PARTLY, "; ".join([text, *lacks, shape])


def _calibration(digest: Digest) -> tuple[str, str]:
    given = {key for case in digest.cases for key in _parameters(case)}
    if not given:
        return NOT, "no parameter is fitted here: all come from the tissue, by rule"
    return PARTLY, (
        f"{listed(sorted(given))} given by the study; vdmbench calibrate tells of a fit and of the loads held out"
    )


def _parameters(case: CaseResult) -> set[str]:
    tables = [case.study.vdm_parameters(), *case.study.model_parameters().values()]
    return {key for table in tables for key, value in table.items() if isinstance(value, int | float)}


def _measured(digest: Digest) -> tuple[str, str]:
    found = [case.measurement for case in digest.cases if case.measurement is not None]
    name = digest.reference if digest.reference is not None else digest.focus
    if not found or name is None:
        return NOT, "nothing was compared with an experiment: [[measured]] holds models against one"
    values = within = bare = 0
    for one in found:
        if name in one.simulated:
            known = np.isfinite(one.error(name))
            values, within = values + int(known.sum()), within + int(one.within(name)[known].sum())
            bare += name not in one.inputs or not np.isfinite(one.inputs[name]).any()
    text = f"{name} is within the validation uncertainty in {within} of {plural(values, 'value')}"
    sources = [source for one in found for source in one.sources.values() if source]
    text += f" ({listed(dict.fromkeys(sources))})" if sources else ""
    if not values:
        return NOT, f"{name} has no answer where something was measured"
    if bare:
        return PARTLY, f"{text}, which has no part of the inputs"
    return (SHOWN if within == values else PARTLY), text


def _applicability(digest: Digest) -> tuple[str, str]:
    measured = sum(case.measurement is not None for case in digest.cases)
    if not measured:
        return NOT, "nothing was measured, so that nothing tells how near these cases are to what was"
    if measured == len(digest.cases):
        return (
            PARTLY,
            "each case here was measured; how near your own use is to these cases is yours to argue",
        )
    return (
        PARTLY,
        f"measured were {measured} of {plural(len(digest.cases), 'case')}; the others are predictions beside them",
    )
