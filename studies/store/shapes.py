"""JSON in stored files: of a known shape."""

from __future__ import annotations

from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

LARGEST = 1e100  # of a stored number; its third power is still finite

Hash = Annotated[str, Field(pattern=r"^[0-9a-f]{1,64}$")]  # names a file
Finite = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Number = Finite | None  # null where a number is not finite


class Shape(BaseModel):
    """What a stored text must hold; what it holds besides is passed over."""

    model_config = ConfigDict(strict=True)


S = TypeVar("S", bound=Shape)


class PlannedShape(Shape):
    """A case of plan.json."""

    hash: Hash
    label: str
    swept: dict[str, Finite | str]
    swept_units: dict[str, str]
    mesh: str = ""


class StudyShape(Shape):
    """What plan.json says of the study."""

    name: str


class PlanShape(Shape):
    """plan.json."""

    study: StudyShape
    cases: list[PlannedShape]
    surfaces: dict[str, str] = {}
    resumed: list[Hash] = []
    command: list[str] = []
    directory: str = ""


class FailureShape(Shape):
    """failed/<hash>.json."""

    hash: Hash
    code: str
    message: str
    remedy: str


class ToldShape(Shape):
    """told.json."""

    of: Hash
    told: dict[str, Any]


class ModelShape(Shape):
    """A model of a case."""

    status: list[Annotated[list[str], Field(min_length=1, max_length=3)]]
    parameters: dict[str, Finite | str | None]
    seconds_setup: Number
    peak_bytes: int
    version: str
    key: str


class MetricShape(Shape):
    """A metric of a case."""

    unit: str
    definition: str
    version: int


class MeasurementShape(Shape):
    """`measurement/about` of a case file."""

    sources: dict[str, str]
    others: list[str]


class CaseShape(Shape):
    """`case/about` of a case file."""

    label: str
    reference: str | None
    swept: dict[str, Finite | str]
    swept_units: dict[str, str]
    provenance: dict[str, str]
    reference_error: dict[str, Number]
    mesh_quality: dict[str, Number]
    models: dict[str, ModelShape]
    metrics: dict[str, MetricShape]


def parsed(text: str | bytes, shape: type[S]) -> S:
    """JSON of this shape.

    Raises
    ------
    ValueError
        no JSON, a number that is too large, or of another shape; one line says where.
    """
    try:
        return shape.model_validate_json(text)
    except ValidationError as error:
        raise ValueError(one_line(error)) from None


def one_line(error: ValidationError) -> str:
    """The first thing that is wrong, and where."""
    first = error.errors(include_url=False)[0]
    place = ".".join(map(str, first["loc"]))[:200]
    return f"{place!r}: {first['msg']}" if place else str(first["msg"])
