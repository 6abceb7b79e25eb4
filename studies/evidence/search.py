"""The search for the multiples of a rule with the least error, and which of them the loads do not tell.

The operators are linear in their moduli: c times all of them leaves the part of an answer that follows prescribed
movements and divides by c the part that follows forces. Of two answers the best c is therefore the solution of a
linear least-squares problem, and only the ratios of the moduli are searched. Where the answer is not what this
foretells (of a nonlinear model, or beside moduli that are not fitted) all of them are searched from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from solver_common.arrays import Array

from ..study.errors import InputError

WIDEST = math.log(1e5)  # of a ratio between two moduli, beside that of their rules
_MOST = 2.0 * WIDEST  # of a modulus over its rule's
_TOLERANCE = 1e-4  # of a logarithm
_FIRST_STEP = 0.2  # of a logarithm, where all moduli are searched
_SEEN = 1e-3  # of an answer: a modulus whose double changes less of it cannot be told
_FORETOLD = 1e-4  # of an answer
_ROUNDING = 1e-6  # of an answer
_FAILED = 1e300  # the loss where a model has no answer
_ADD = "add loads given by force or pressure"


class CalibrationError(InputError):
    """A study that nothing can be fitted on; the message says why."""


@dataclass(frozen=True)
class Least:
    """Multiples of the rule with the least error; `kept` says which stay at their rule and why, "" where none."""

    multiples: Array
    kept: str = ""


def least(name: str, names: Sequence[str], answer: Callable[[Array], Array], target: Array) -> Least:
    """The multiples of the rule's moduli with the answer nearest to the target.

    Parameters
    ----------
    name, names : of the model and of its moduli
    answer : the model's (M,) answer to multiples, one for each modulus
    target : (M,)

    Raises
    ------
    CalibrationError
        a model whose answers, all to forces, move against the target.
    """
    ones = np.ones(len(names))
    rule = answer(ones)
    doubled = [answer(ones + unit) for unit in np.eye(len(names))]
    free = [place for place, after in enumerate(doubled) if _differ(after, rule, _SEEN)]
    unseen = [name for place, name in enumerate(names) if place not in free]
    told = [f"{_stay(unseen)}: the training loads do not depend on {_them(unseen)}"] if unseen else []
    if not free:
        return Least(ones, f"{told[0]}, as movements do not; {_ADD}")

    def whole(multiples: Array) -> Array:
        out = ones.copy()
        out[free] = multiples
        return out

    all_doubled = doubled[free[0]] if len(free) == 1 else answer(whole(np.full(len(free), 2.0)))
    search = _Search(lambda multiples: answer(whole(multiples)), target, len(free), rule, all_doubled)
    ratios = search.ratios()
    if not search.has_scale:
        told.insert(
            0,
            f"of {_and([names[place] for place in free])} only the ratio is fitted, and {_stay([names[free[0]]])}: "
            f"the training loads do not depend on a common factor, as movements do not; {_ADD}",
        )
        return Least(whole(ratios), "; ".join(told))
    factor, foretold = search.scaled(ratios)
    if search.only_forces:
        if not factor > math.exp(-_MOST):
            raise CalibrationError(f"{name} moves against the reference on the training loads: no fit")
        return Least(whole(ratios / factor), "; ".join(told))
    multiples = search.verified(ratios / factor, foretold)
    if not _differ(search.answer(2.0 * multiples), search.answer(multiples), _SEEN):
        fitted = [names[place] for place in free]
        best = _and([f"{multiple:.2g}" for multiple in multiples])
        told.insert(
            0,
            f"{_stay(fitted)}: the best would be {best} times that, where the training loads hardly depend on it",
        )
        multiples = np.ones(len(free))
    return Least(whole(multiples), "; ".join(told))


def _differ(after: Array, before: Array, share: float) -> bool:
    return bool(np.linalg.norm(after - before) > share * np.linalg.norm(before))


def _and(names: Sequence[str]) -> str:
    return " and ".join(names)


def _stay(names: Sequence[str]) -> str:
    return f"{_and(names)} {'stays at its rule' if len(names) == 1 else 'stay at their rules'}"


def _them(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"


@dataclass(frozen=True)
class _Search:
    """Over `count` moduli; what the model answers with their rule, and with twice all of them."""

    answer: Callable[[Array], Array]
    target: Array
    count: int
    rule: Array
    doubled: Array

    @property
    def has_scale(self) -> bool:
        """Whether a common factor of the moduli changes the answer."""
        return _differ(self.doubled, self.rule, _SEEN)

    @property
    def only_forces(self) -> bool:
        """Whether the answer goes as 1 over the common factor."""
        return not _differ(2.0 * self.doubled, self.rule, _ROUNDING)

    def scaled(self, ratios: Array) -> tuple[float, Array]:
        """The best factor on the part that follows forces, 1 over that on the moduli, and the answer foretold."""
        first = self.answer(ratios)
        if not self.has_scale:
            return 1.0, first
        forces = first if self.only_forces else 2.0 * (first - self.answer(2.0 * ratios))
        movements = first - forces
        factor = float(forces @ (self.target - movements)) / float(forces @ forces)
        factor = min(max(factor, math.exp(-_MOST)), math.exp(_MOST))
        return factor, movements + factor * forces

    def ratios(self) -> Array:
        """The best ratios of the moduli, each with its best common factor."""
        if self.count == 1:
            return np.ones(1)

        def loss(log_ratios: Array) -> float:
            _, foretold = self.scaled(np.exp(np.concatenate([[0.0], log_ratios])))
            return _square(foretold - self.target)

        if self.count == 2:
            # the loss can have a flat end, where one modulus no longer matters: look first, then close in
            grid = np.linspace(-WIDEST, WIDEST, 13)
            best = int(np.argmin([loss(np.array([x])) for x in grid]))
            low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])
            found = minimize_scalar(
                lambda x: loss(np.array([x])),
                bounds=(low, high),
                method="bounded",
                options={"xatol": _TOLERANCE},
            )
            log_ratios = np.array([found.x])
        else:
            result = minimize(
                loss,
                np.zeros(self.count - 1),
                method="Nelder-Mead",
                options={"xatol": _TOLERANCE, "fatol": 1e-10},
            )
            log_ratios = np.asarray(result.x)
        return np.exp(np.concatenate([[0.0], log_ratios]))

    def verified(self, multiples: Array, foretold: Array) -> Array:
        """The multiples where their answer is as foretold; else what a search from them or the rule finds."""

        def loss(logs: Array) -> float:
            try:
                return _square(self.answer(np.exp(logs)) - self.target)
            except CalibrationError:  # a nonlinear model that is too soft for its load
                return _FAILED

        try:
            if not _differ(self.answer(multiples), foretold, _FORETOLD):
                return multiples
        except CalibrationError:
            pass
        start = min((np.zeros(self.count), np.log(multiples)), key=loss)
        result = minimize(
            loss,
            start,
            method="Nelder-Mead",
            bounds=[(-_MOST, _MOST)] * self.count,
            options={
                "xatol": _TOLERANCE,
                "fatol": 1e-10,
                "initial_simplex": start
                + _FIRST_STEP * np.vstack([np.zeros(self.count), np.eye(self.count)]),
            },
        )
        return np.exp(np.asarray(result.x))


def _square(values: Array) -> float:
    return float(values @ values)
