"""[tissue]: moduli, density, and the law of large strain."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .kinds import SI, not_negative, number_check, positive
from .table import Table

YoungsModulus = Annotated[
    float,
    SI("Pa"),
    positive,
    number_check(
        lambda v: 10 <= v <= 1e10,
        'must lie between 10 Pa and 10 GPa (a mixed-up unit? a bare number is in Pa: write "5 kPa")',
    ),
]
PoissonRatio = Annotated[
    float,
    SI("1"),
    number_check(lambda v: -1 < v <= 0.5, "must be above -1 and at most 0.5 (incompressible)"),
]


class Tissue(Table):
    """[tissue]"""

    youngs_modulus: YoungsModulus = Field(description="Young's modulus")
    poisson_ratio: PoissonRatio = Field(
        description="Poisson's ratio, up to and including 0.5; surface models keep the volume"
    )
    density: Annotated[
        float,
        SI("kg/m^3"),
        positive,
        number_check(
            lambda v: 10 <= v <= 1e5,
            'must lie between 10 and 100,000 kg/m^3 (a mixed-up unit? write "1.06 g/cm^3")',
        ),
    ] = Field(1060.0, description="mass density; only gravity uses it")
    law: Literal["neo-hookean", "mooney-rivlin", "yeoh", "fung", "ogden"] | None = Field(
        None,
        description="law of large strain, of fem: neo-hookean where left out; its moduli at small strain are these",
    )
    second_share: (
        Annotated[float, SI("1"), number_check(lambda v: 0 <= v <= 1, "must lie between 0 and 1")] | None
    ) = Field(None, description="mooney-rivlin: c2 / (c1 + c2)")
    second_ratio: Annotated[float, SI("1"), not_negative] | None = Field(None, description="yeoh: c2 / c1")
    third_ratio: Annotated[float, SI("1"), not_negative] | None = Field(None, description="yeoh: c3 / c1")
    exponent: Annotated[float, SI("1"), positive] | None = Field(
        None, description="fung: b of exp(b (I1 - 3)), as Demiray has it"
    )
    exponents: (
        Annotated[tuple[float, ...], SI("1", (0,)), number_check(lambda v: v != 0, "must not be zero")] | None
    ) = Field(None, description="ogden: the exponents")
    shares: Annotated[tuple[float, ...], SI("1", (0,)), positive] | None = Field(
        None, description="ogden: share of each term in the shear modulus; they sum to 1"
    )
