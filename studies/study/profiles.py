"""Shapes of a contact's pressure on a cap or ball. One more is a function, here or in a file `profile_NAME.py`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from .modules import load_all

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

PROFILES: dict[str, Callable[[Array], Array]] = {}
VERSIONS = {"uniform": "1"}


def profile(function: Callable[[Array], Array], version: str = "1") -> Callable[[Array], Array]:
    """Register pressure over its peak at rho, 0 in the middle and 1 at the rim, beyond which it is nothing.

    Parameters
    ----------
    version : raised whenever its values change; part of the keys of results

    Raises
    ------
    ValueError
        a name that is taken.
    """
    name = function.__name__
    if name in VERSIONS:
        raise ValueError(f"a profile {name!r} is registered already")
    PROFILES[name], VERSIONS[name] = function, version
    return function


# numpy is slow to load: not where a study is only checked


@profile
def hertz(rho: Array) -> Array:
    """Pressure over its peak: sqrt(1 - rho^2), nothing beyond the rim rho = 1."""
    import numpy as np

    return np.asarray(np.sqrt(np.clip(1.0 - rho**2, 0.0, None)))


@profile
def gaussian(rho: Array) -> Array:
    """Pressure over its peak: exp(-9/2 rho^2), the third standard deviation at the rim rho = 1, nothing beyond."""
    import numpy as np

    return np.where(rho < 1.0, np.exp(-4.5 * rho**2), 0.0)


load_all("vdmbench.study", "profile_")  # last: they use what is above

if TYPE_CHECKING:
    Profile = str
else:
    Profile = Literal[("uniform", *PROFILES)]
