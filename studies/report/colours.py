"""The colour maps of surfaces: perceptually even, and safe for colour-blind readers.

Viridis (displacement) and inferno (difference) by S. van der Walt and N. Smith, in the public domain (CC0): 52 of
their 256 entries; linear interpolation between them is within two levels of 255.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

_ENTRIES = {
    "viridis": (
        "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a3a538b38598c355e8d33638d"
        "31688e2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c"
        "35b7793dbc7446c06f50c46a5ac86465cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51d"
        "fde725"
    ),
    "inferno": (
        "00000402020c0504170a072210092d160b391e0c45260c512f0a5b380962400a67490b6a510e6c59106e61136e69166e71196e"
        "781c6d801f6c88226a902568982766a02a63a82e5fb0315bb73557bf3952c63d4dcc4248d34743d94d3ddf5337e45a31e9612b"
        "ed6925f1711ff47918f78212f98b0bfa9407fb9d07fca60cfcb014fbba1ffac42af8cd37f6d746f4e156f2ea69f2f27df5f992"
        "fcffa4"
    ),
}
LEVELS = 256


@cache
def colour_map(name: str) -> NDArray[np.float64]:
    """(256, 3) red, green and blue from 0 to 1, by the name of the map."""
    knots = np.frombuffer(bytes.fromhex(_ENTRIES[name]), np.uint8).reshape(-1, 3) / 255.0
    at, where = np.linspace(0.0, 1.0, LEVELS), np.linspace(0.0, 1.0, len(knots))
    return np.stack([np.interp(at, where, channel) for channel in knots.T], axis=1)
