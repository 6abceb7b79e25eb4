"""The studies with other values of the inputs that tell what comes of not knowing them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .fields import targets
from .inputs import Input, places, read_inputs
from .problems import Finding, Loc
from .sweep import substituted
from .validation import validate

if TYPE_CHECKING:
    from .schema import Study

SENSITIVITIES, SAMPLING, SOBOL, MORRIS = "sensitivities", "sampling", "sobol", "morris"
INSTALL = "pip install --constraint constraints.txt --editable '.[sensitivity]'"
_SAMPLES = {SAMPLING: 64, SOBOL: 64, MORRIS: 8}
_MOST = 2000  # variations of a case
# what no variation has: it decides nothing of an answer, or would begin anew
_NOT_VARIED = ("inputs", "sweep", "measured", "limits", "calibration")


@dataclass(frozen=True)
class Variation:
    """A study in which some inputs have other values: key -> value, SI."""

    values: Mapping[str, float]
    study: Study


def count_of(method: str, keys: int, samples: int | None) -> int:
    """How many variations a case has."""
    number = samples or _SAMPLES.get(method, 0)
    extra = {SENSITIVITIES: 0, SAMPLING: number, SOBOL: number * (keys + 2), MORRIS: number * (keys + 1)}
    return extra[method] + (2 * keys if method in (SENSITIVITIES, MORRIS) else 0)


def shares(method: str, keys: int, samples: int | None, seed: int | None) -> NDArray[np.float64]:
    """(V, K) samples of the unit cube.

    Raises
    ------
    ImportError
        SALib, which Sobol and Morris need, is not installed; the message has the command.
    """
    number, start = samples or _SAMPLES[method], seed or 0
    if method == SAMPLING:
        from scipy.stats import qmc

        return np.asarray(qmc.LatinHypercube(keys, rng=start).random(number))
    problem = unit_cube(keys)
    if method == SOBOL:
        sample = _salib("sample.sobol").sample(problem, number, calc_second_order=False, seed=start)
    else:
        sample = _salib("sample.morris").sample(problem, number, seed=start)
    return np.asarray(sample, dtype=float)


def unit_cube(keys: int) -> dict[str, Any]:
    """What SALib calls a problem: so many numbers from 0 to 1."""
    names = [f"x{k}" for k in range(keys)]
    return {"num_vars": keys, "names": names, "bounds": [[0.0, 1.0]] * keys}


def _salib(module: str) -> Any:
    try:
        return import_module(f"SALib.{module}")
    except ImportError:
        raise ImportError(f"Sobol and Morris indices need SALib, which is not installed: {INSTALL}") from None


def analysis(method: str) -> Any:
    """SALib's analysis of the samples of a method. Raises ImportError."""
    return _salib(f"analyze.{method}")


def varied_values(inputs: Sequence[Input], study: Study) -> list[dict[str, float]]:
    """The values of each variation: per key the lower and the upper, then the samples.

    Raises
    ------
    ImportError
        SALib is asked for and not installed.
    """
    table = study.inputs
    if table is None:
        return []
    found: list[dict[str, float]] = []
    if table.method in (SENSITIVITIES, MORRIS):
        found += [{one.key: end} for one in inputs for end in one.ends]
    if table.method != SENSITIVITIES:
        place = Input.on_grid if table.method == MORRIS else Input.at
        found += [
            {one.key: place(one, float(share)) for one, share in zip(inputs, row, strict=True)}
            for row in shares(table.method, len(inputs), table.samples, table.seed)
        ]
    return found


def variations(study: Study) -> tuple[list[Variation], list[Finding]]:
    """The studies that tell what comes of not knowing the inputs, and what is wrong with some of them."""
    if study.inputs is None:
        return [], []
    data = study.model_dump(by_alias=True, exclude_none=True)
    inputs, findings = read_inputs(data)
    if findings:
        return [], findings
    count = count_of(study.inputs.method, len(inputs), study.inputs.samples)
    if count > _MOST:
        text = f"makes {count:,} variations of each case, more than the {_MOST:,} allowed; take fewer samples"
        return [], [(("inputs",), text)]
    try:
        values = varied_values(inputs, study)
    except ImportError as error:
        return [], [(("inputs", "method"), str(error))]
    of_key = {one.key: one for one in inputs}
    written = {key: loc for key, loc, _ in places(data, targets(data))}
    rest = {key: value for key, value in data.items() if key not in _NOT_VARIED}
    found: list[Variation] = []
    for changed in values:
        varied = rest
        for key, value in changed.items():
            varied = substituted(varied, of_key[key].loc, value)
        other, faults = validate(varied, study._source)
        if other is None:
            findings += _of_variation(faults, changed, of_key, written)
            if findings:
                return [], findings
            continue
        other._source = study._source
        found.append(Variation(changed, other))
    return found, findings


def _of_variation(
    faults: Sequence[Finding],
    changed: Mapping[str, float],
    of_key: Mapping[str, Input],
    written: Mapping[str, Loc],
) -> Iterator[Finding]:
    """The faults of a variation, at the place of the input that makes them."""
    for loc, text in faults[:1]:
        key = next((key for key in changed if of_key[key].loc == loc), next(iter(changed)))
        yield written.get(key, ("inputs",)), f"at {changed[key]:g}: {text}; give a range that ends before"
