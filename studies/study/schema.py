"""The study file as typed tables: every key with its type, its unit and its help text beside it.

All lengths, pressures and so on are floats in SI after validation. Conditions between keys are in `checks`;
reading a file is in `config`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    ConfigDict,
    PrivateAttr,
    SerializeAsAny,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
)

from .errors import Finding, Source, StudyError
from .kinds import (
    SI,
    Axis,
    Coordinate,
    Direction,
    Enters,
    Fraction,
    Key,
    Length,
    LineForce,
    Modulus,
    Name,
    Plains,
    Position,
    Pressure,
    Ratio,
    Rotation,
    Share,
    Table,
    Time,
    Vector3,
    not_negative,
    number_check,
    one_line,
    positive,
    within,
)
from .loads import Constraint
from .measured import MOST_TABLES, Measured
from .registry import SCANNED, Parameter, all_models, own_parameters
from .shapes import Geometry

YoungsModulus = Annotated[float, SI("Pa"), within(10, 1e10, "Pa")]
PoissonRatio = Annotated[
    float,
    SI("1"),
    number_check(lambda v: -1 < v <= 0.5, "must be above -1 and at most 0.5 (incompressible)"),
]

Foundation = Annotated[float, SI("Pa/m"), not_negative]


class Tissue(Table):
    """[tissue]"""

    youngs_modulus: YoungsModulus = Key("Young's modulus")
    poisson_ratio: PoissonRatio = Key("Poisson's ratio, at most 0.5; surface models keep the volume")
    density: Annotated[float, SI("kg/m^3"), within(10, 1e5, "kg/m^3")] = Key(
        "mass density; only gravity uses it", 1060.0
    )
    law: Literal["neo-hookean", "mooney-rivlin", "yeoh", "fung", "ogden"] | None = Key(
        "law of large strain, of fem: neo-hookean where left out; its moduli at small strain are these", None
    )
    second_share: Fraction | None = Key("mooney-rivlin: c2 / (c1 + c2)", None)
    second_ratio: Annotated[float, SI("1"), not_negative] | None = Key("yeoh: c2 / c1", None)
    third_ratio: Annotated[float, SI("1"), not_negative] | None = Key("yeoh: c3 / c1", None)
    exponent: Ratio | None = Key("fung: b of exp(b (I1 - 3)), as Demiray has it", None)
    exponents: Annotated[Plains, number_check(lambda v: v != 0, "must not be zero")] | None = Key(
        "ogden: the exponents", None
    )
    shares: Annotated[Plains, positive] | None = Key(
        "ogden: share of each term in the shear modulus; they sum to 1", None
    )


# --- laws of large strain and their keys of [tissue]: dimensionless numbers beside the small-strain moduli ---


NEO_HOOKEAN = "neo-hookean"


# law, of `fem_reference.materials` -> the keys that it needs
LAWS: Mapping[str, tuple[str, ...]] = {
    NEO_HOOKEAN: (),
    "mooney-rivlin": ("second_share",),
    "yeoh": ("second_ratio", "third_ratio"),
    "fung": ("exponent",),
    "ogden": ("exponents", "shares"),
}
LAW_KEYS = tuple(key for keys in LAWS.values() for key in keys)


Vdm = dict[str, float | str]

MOST_STEPS = 10_000  # of a load history: each keeps the displacement of every node
MOST_NAMES = 200  # of models, regions, constraints
MOST_VALUES = 100_000  # of an axis of a sweep
MOST_LEVELS = 4  # of meshes for a reference's error bar


# --- the tables ---


class StudyInfo(Table):
    """[study]"""

    name: Annotated[Name, Enters.NOTHING] = Key("names the run directory: letters, digits, _ . -")
    title: Annotated[str, AfterValidator(one_line), Enters.NOTHING] = Key(
        "one line for the report; the name where left out",
        default_factory=lambda given: given["name"],
        max_length=200,
    )
    models: Annotated[tuple[str, ...], Enters.CASE] = Key(
        'models to run: registered names, with a solver if wanted, as in "vdm-paper:quasi-linear"',
        strict=False,
        max_length=MOST_NAMES,
    )
    reference: Annotated[str | None, Enters.CASE] = Key(
        "the model that the others are compared with, one of `models`; none: no comparison", None
    )
    condition: bool = Key("whether the models estimate the condition of the system that they solve", False)
    homogeneous: tuple[str, ...] = Key(
        "models of this study that may answer as if there were no inclusions; the others know them, or "
        "are refused",
        (),
        strict=False,
        max_length=MOST_NAMES,
    )
    max_cases: Annotated[int, Enters.NOTHING] = Key("refuse a sweep of more cases", 1000, ge=1, le=100_000)


class VdmTable(Table):
    """[vdm]: what is left out comes from a documented rule of the model"""

    bulk_modulus: Modulus | None = Key("B of the paper", None)
    connectivity_modulus: Modulus | None = Key("B_ij of the paper", None)
    shear_modulus: Modulus | None = Key("mu of boundary elements", None)
    coarse_nodes: int | None = Key(
        "sparse form: most nodes of its coarse body, 200 to 2,000", None, ge=200, le=2000
    )
    parts: int | None = Key(
        "boundary elements, nonlinear solver: into how many parts the body is cut; left out: as many as"
        " its rotations need",
        None,
        ge=1,
        le=64,
    )
    compressibility: Literal["tissue", "fluid"] | None = Key(
        "boundary elements: the tissue's own Poisson's ratio, or a fluid that keeps the volume; left out: tissue",
        None,
    )
    foundation: Foundation | None = Key("k, stiffness against normal displacement per area", None)
    surface_tension: LineForce | None = Key("T, tension of the skin; in the vector form its mean", None)
    stretch_stiffness: LineForce | None = Key("E_s, stiffness of edges against stretch", None)
    rotation: Rotation | None = Key("rotation that costs the skin no energy", None)
    penalty: Ratio | None = Key(
        "alpha of (25) and (26), which only lu solves; left out: held nodes are eliminated exactly", None
    )
    tolerance: Annotated[Ratio, number_check(lambda v: v < 1, "must be below 1")] | None = Key(
        "of the iterative solvers, residual over right-hand side; left out: 1e-10", None
    )
    stop: Literal["printed", "intended", "residual"] | None = Key(
        "of Figure 8, where an iteration ends: the length of the answer rests, the answer rests, or the"
        " residual is small; left out: printed",
        None,
    )
    volume_row: Literal["printed", "corrected"] | None = Key(
        "(33) in print or the volume's gradient; left out: printed in figure-8, else corrected", None
    )

    def given(self) -> Vdm:
        """The parameters that are set."""
        return self.model_dump(exclude_none=True)


def model_table() -> type[VdmTable]:
    """The table of a single model: the keys of [vdm], and those that models declare as their own."""
    all_models()  # loads the families
    return _table_with(tuple(own_parameters().items()))


@cache
def _table_with(own: tuple[tuple[str, Parameter], ...]) -> type[VdmTable]:
    fields: dict[str, Any] = {
        key: (Annotated[float, SI(parameter.unit)] | None, Key(parameter.help, None))
        for key, parameter in own
    }
    return create_model("ModelTable", __base__=VdmTable, **fields) if own else VdmTable


def _of_model(value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> VdmTable:
    if not isinstance(value, dict) or value.keys() <= VdmTable.model_fields.keys():
        table: VdmTable = handler(value)
        return table
    return model_table().model_validate(value, context=info.context)


class HalfSpace(Table):
    """Nodes on one side of a plane across an axis"""

    axis: Axis = Key("axis that the plane is perpendicular to")
    fraction: Fraction | None = Key("place of the plane as a fraction of the body's extent", None)
    value: Coordinate | None = Key("place of the plane as a coordinate", None)


class Ball(Table):
    """Nodes within a ball"""

    center: Position = Key("centre")
    radius: Length = Key("radius")


class Box(Table):
    """Nodes within a box"""

    min: Position = Key("lowest coordinates")
    max: Position = Key("highest coordinates")


class Cap(Table):
    """Nodes within a cone, seen from the centroid of the body"""

    direction: Direction = Key("axis of the cone, of any length")
    angle: Annotated[float, SI("rad"), positive, within(0, math.pi, "rad")] = Key("half of the opening angle")


class Places(Table):
    """Where all of its keys hold"""

    below: HalfSpace | None = Key("below a plane", None)
    above: HalfSpace | None = Key("above a plane", None)
    ball: Ball | None = Key("in a ball", None)
    box: Box | None = Key("in a box", None)
    cap: Cap | None = Key("in a cone from the centroid", None)
    group: str | None = Key("in a named group of the mesh file", None, min_length=1)


class Region(Places):
    """[regions.NAME]: the nodes for which all of its keys hold"""

    cavity: bool | None = Key("true: walls of cavities; else all but a group is on the outer surface", None)


class Load(Table):
    """[load]"""

    factors: Plains = Key("the load history: factors on pressures, forces and displacements", (1.0,))
    steps: int | None = Key(
        "equal steps from each factor to the next, the first from zero; one where left out",
        None,
        ge=1,
        le=1000,
    )

    @property
    def history(self) -> tuple[float, ...]:
        """All load factors in order, expanded."""
        count = self.steps or 1
        starts = (0.0, *self.factors)
        return tuple(
            end if step == count else start + (end - start) * step / count
            for start, end in zip(starts, self.factors, strict=False)
            for step in range(1, count + 1)
        )


class Gravity(Table):
    """[gravity]"""

    acceleration: Annotated[Vector3, SI("m/s^2", 3)] = Key(
        "acceleration along x, y, z; the weight is the same at every load factor"
    )
    scanned: bool | None = Key(
        "whether the geometry was scanned under this weight: the rest shape is found from it, and "
        "displacements count from the scanned shape",
        None,
    )


class Environment(Table):
    """[environment]"""

    pressure: Pressure = Key("P_ep, pressure of the surroundings, from which others count: it moves nothing")


class Anisotropy(Table):
    """[anisotropy]"""

    fibre_direction: Direction = Key("direction of the fibres, of any length")
    contrast: Ratio = Key(
        "Young's modulus along the fibres over `tissue.youngs_modulus` (FEM, 1 or more); "
        "B_ij, T and E_s of an edge, B_i and k of a node along them over those across (VDM)"
    )


class Inclusion(Places):
    """[[inclusions]]: the tetrahedra in the middle of which all of its keys hold, with moduli of their own"""

    name: Name = Key("names it in sweeps and reports")
    youngs_modulus: YoungsModulus = Key("its Young's modulus")
    poisson_ratio: PoissonRatio | None = Key(
        "its Poisson's ratio, the tissue's where left out; ratios that differ are above 0", None
    )


class Range(Table):
    """An axis as a range, of numbers"""

    start: Any = Key("its first value")
    stop: Any = Key("its last value")
    num: int | None = Key("how many values; a latin-hypercube takes none", None, ge=2, le=MOST_VALUES)
    scale: Literal["linear", "log"] = Key("in equal steps or in equal ratios", "linear")


class Known(Table):
    """How well a number is known: one of the keys"""

    sd: Any = Key("its standard deviation; the study has its mean", None)
    range: Any = Key("list of its least and its most value, all between as likely", None)


NEVER_SWEPT = {"study", "sweep", "inputs", "limits", "calibration", "acceptance", "measured"}
# tables that decide the amount of computation, or the body itself
NEVER_AN_INPUT = {*NEVER_SWEPT, "geometry", "load", "uncertainty"}


class Sweep(Table):
    """[sweep]: further keys are axes, each the dotted path of a key of the study"""

    model_config = ConfigDict(extra="allow")

    mode: Literal["grid", "zip", "one-at-a-time", "latin-hypercube"] = Key(
        "every combination; one after the other in step; the study as it is written, then each axis "
        "alone; or random samples of ranges",
        "grid",
    )
    samples: int | None = Key("latin-hypercube: number of cases", None, ge=1)
    seed: int | None = Key("latin-hypercube: seed, 0 where left out", None, ge=0, lt=2**32)


class Inputs(Table):
    """[inputs]: how well numbers are known; its keys are dotted paths of keys of the study"""

    model_config = ConfigDict(extra="allow")


class Limits(Table):
    """[limits]: search the small-strain limits"""

    thresholds: Annotated[Plains, number_check(lambda v: 0 < v < 1, "must lie between 0 and 1")] = Key(
        "growths of the relative L2 displacement error to find; the search raises all loads in proportion, "
        "from the study's own to 64 times them, or to a largest principal strain of 4, a fibre three times "
        "as long as at rest",
        (0.05, 0.10),
    )


class Calibration(Table):
    """[calibration]: which loads a fit may see; the others are held out. What a study sets is not fitted"""

    training: int | None = Key("the first so many cases train; half of them where left out", None, ge=1)


class Uncertainty(Table):
    """[uncertainty]: the reference's own error, from meshes whose tetrahedra are split into eight"""

    levels: int = Key(
        "mesh levels, the study's own included; each costs 10 to 20 times the one before",
        2,
        ge=2,
        le=MOST_LEVELS,
    )


class Acceptance(Table):
    """[acceptance]: how far off a model may be; the verdict answers each, and no result depends on them"""

    displacement_error: Share = Key('most displacement error at full load, such as "5 %" or 0.05', 0.10)
    deformation_error: Share = Key("most deformation error, the error in the change of shape", 0.10)
    largest_difference: Length | None = Key("most difference at any node; none where left out", None)
    frame_time: Time | None = Key("most time that a frame may take; none where left out", None)


class Study(Table):
    """A whole study file, validated, in SI units."""

    study: StudyInfo = Key("what is compared")
    geometry: SerializeAsAny[Geometry] = Key("the body")
    tissue: Tissue = Key("its material")
    inclusions: tuple[Inclusion, ...] | None = Key(
        "parts of the inside with moduli of their own", None, strict=False, max_length=MOST_NAMES
    )
    vdm: VdmTable = Key("parameters of the VDM models", VdmTable())
    regions: dict[Name, Region] = Key("named sets of surface nodes", {}, max_length=MOST_NAMES)
    constraints: tuple[SerializeAsAny[Constraint], ...] = Key(
        "what holds and loads the body", (), strict=False, max_length=MOST_NAMES
    )
    load: Load = Key("the load history", Load())
    gravity: Gravity | None = Key("weight", None)
    environment: Environment | None = Key("surroundings", None)
    anisotropy: Anisotropy | None = Key("one family of fibres", None)
    sweep: Annotated[Sweep, Enters.NOTHING] = Key("what is varied", Sweep())
    inputs: Annotated[Inputs | None, Enters.CASE] = Key("how well numbers are known", None)
    limits: Annotated[Limits | None, Enters.CASE] = Key("small-strain limits", None)
    calibration: Annotated[Calibration | None, Enters.NOTHING] = Key("how [vdm] is fitted", None)
    uncertainty: Annotated[Uncertainty | None, Enters.CASE] = Key("the reference's own error", None)
    acceptance: Annotated[Acceptance, Enters.NOTHING] = Key("how far off a model may be", Acceptance())
    measured: Annotated[tuple[Measured, ...] | None, Enters.CASE] = Key(
        "what was measured on such a body", None, strict=False, max_length=MOST_TABLES
    )
    models: dict[str, Annotated[SerializeAsAny[VdmTable], WrapValidator(_of_model)]] = Key(
        "[vdm] keys for one model only, and its own", {}, max_length=MOST_NAMES
    )

    _source: Source = PrivateAttr(default=Source())
    _cases: tuple[Any, ...] | None = PrivateAttr(default=None)  # of its sweep, if already made

    def __eq__(self, other: object) -> bool:
        """Whether the keys are equal; the source of a study does not count."""
        return isinstance(other, Study) and self.__dict__ == other.__dict__

    @property
    def text(self) -> str:
        """Text of its file, with the changes made to it; "" without a file."""
        return self._source.text

    @property
    def path(self) -> str:
        """Path of its file, or "study" without one."""
        return self._source.path

    def error(self, findings: Sequence[Finding]) -> StudyError:
        """The error for its mistakes, at their places in the file."""
        return self._source.error(findings, self.model_dump())

    def model_copy(self, **options: Any) -> Study:
        """A copy with changes, which makes its own cases."""
        copy = super().model_copy(**options)
        copy._cases = None
        return copy

    def model_parameters(self) -> dict[str, Vdm]:
        """The overrides of [models."NAME"], by full model name."""
        return {name: table.given() for name, table in sorted(self.models.items())}


# --- features of a study that not every model takes ---


def has_weight(study: Study) -> bool:
    """Whether the body's weight acts, which does not scale with the loads."""
    return study.gravity is not None and any(study.gravity.acceleration)


def extras_of(study: Study) -> frozenset[str]:
    """The entries of `vdmbench.study.registry.EXTRAS` that a study has."""
    found = {part.extra for part in study.constraints} - {""}
    if study.tissue.law not in (None, NEO_HOOKEAN):
        found.add("law")
    if study.geometry.cavities is not None:
        found.add("cavities")
    if study.geometry.cavities == "fluid":
        found.add("fluid in cavities")
    if study.inclusions:
        found.add("inclusions")
    if study.anisotropy is not None:
        found.add("fibres")
    if study.gravity is not None and study.gravity.scanned and has_weight(study):
        found.add(SCANNED)
    return frozenset(found)


def extras_for(name: str, study: Study) -> frozenset[str]:
    """The extras that a model of the study must take: those that it may ignore are left out."""
    return extras_of(study) - ({"inclusions"} if name in study.study.homogeneous else set())
