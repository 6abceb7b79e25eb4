"""The kind `indenter`: a rigid frictionless body that is pushed in along an axis, and touches where it will."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from .kinds import Direction, Length
from .loads import Acts, AnyConstraint, LoadKey, LoadKind, Placed, Pushed, register

_CAPSULE = ("length", "along")  # keys of a capsule alone


def _push(constraint: AnyConstraint, on: Placed) -> Acts:
    return Acts(
        pushed=Pushed(
            facets=on.facets(),
            shape=constraint.shape or "sphere",
            radius=constraint.radius or 0.0,
            length=constraint.length or 0.0,
            along=constraint.along,
            direction=constraint.push,
            depth=constraint.depth or 0.0,
        )
    )


def _check(constraint: AnyConstraint, region: frozenset[str]) -> Mapping[str, str]:  # noqa: ARG001
    if constraint.shape is None:
        return {}  # a faulty one, which has been told
    given = [key for key in _CAPSULE if key in constraint.model_fields_set]
    if constraint.shape == "capsule":
        return {key: "is missing; a capsule needs length and along" for key in _CAPSULE if key not in given}
    return dict.fromkeys(given, f"belongs to a capsule, not to a {constraint.shape}; leave it out")


register(
    LoadKind(
        name="indenter",
        help="touched by a rigid indenter, without friction",
        version="1",
        keys={
            "depth": LoadKey(
                Length,
                "way of the indenter at load factor 1, from where it first touches the region",
                is_load=True,
                example='a length, such as "5 mm"',
            ),
            "shape": LoadKey(
                Literal["sphere", "flat-punch", "capsule"],
                "of the indenter, whose axis goes through the middle of its region",
                needed=True,
                example="sphere, flat-punch or capsule",
            ),
            "radius": LoadKey(Length, "of the indenter", needed=True, example='a length, such as "10 mm"'),
            "length": LoadKey(Length, "of a capsule, between the middles of its ends"),
            "along": LoadKey(Direction, "axis of a capsule, across the push"),
            "push": LoadKey(
                Direction, "direction of the push, against the region's mean normal where left out"
            ),
        },
        holds=False,
        extra=lambda _: "indenter",
        act=_push,
        check=_check,
    )
)
