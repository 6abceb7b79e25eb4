"""JSON in stored files: sealed against change, of a known shape.

The seal tells damage and edits. It is no signature: who makes a file can seal it, so what is read is checked too.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..machine import json_text

LARGEST = 1e100  # of a stored number; its third power is still finite
SEAL = "seal"

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


_Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class AcceptanceShape(Shape):
    """The limits of [acceptance], in SI; a plan of an older program has none."""

    displacement_error: _Limit = 0.10
    deformation_error: _Limit = 0.10
    largest_difference: _Limit | None = None
    region: str | None = None
    frame_time: _Limit | None = None


class StudyShape(Shape):
    """What plan.json says of the study."""

    name: str
    title: str = ""
    models: list[str] = []
    reference: str | None = None
    claims: list[int] = []
    sweep: str | None = None
    acceptance: AcceptanceShape = AcceptanceShape()


class FilesShape(Shape):
    """The SHA-256 of the files beside plan.json."""

    study: str = Field(alias="study.toml")
    resolved: str = Field(alias="resolved.toml")


class PlanShape(Shape):
    """plan.json."""

    study: StudyShape
    cases: list[PlannedShape]
    files: FilesShape
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
    files: dict[str, str]
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


def sealed(value: Mapping[str, Any], name: str) -> bytes:
    """`value` as the text of the stored file `name`, with its seal."""
    plain = json.loads(json_text({key: entry for key, entry in value.items() if key != SEAL}))
    return json.dumps({**plain, SEAL: _seal(plain, name)}, indent=1).encode()


def unsealed(text: bytes, name: str, shape: type[Shape]) -> dict[str, Any]:
    """What `sealed` wrote as `name`. Raises ValueError as `parsed`, and where the seal is not that of the text."""
    parsed(text, shape)
    value: dict[str, Any] = json.loads(text)
    if value.pop(SEAL, None) != _seal(value, name):
        raise ValueError("its seal does not match: it was changed, or an older version wrote it")
    return value


def _seal(value: Mapping[str, Any], name: str) -> str:
    text = json.dumps(value, sort_keys=True)
    return hashlib.sha256(f"{name}\0{text}".encode()).hexdigest()
