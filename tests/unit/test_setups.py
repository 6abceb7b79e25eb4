"""Set-ups are shared by what they were made from, and let go of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from studies.meshing.mesh import Mesh
from studies.setups import (
    MOST_WAITING,
    content_key,
    most_at_once,
    needed_again,
    next_turn,
    next_uses,
    shared,
    sharing,
    watched,
)
from studies.study_file.schema import Ball, Region


@dataclass(frozen=True)
class Point:
    x: float
    name: str = ""


def make(**inputs: object) -> list[object]:
    return [inputs]


def other(**inputs: object) -> list[object]:
    return [inputs]


def ball(radius: float) -> Region:
    return Region(ball=Ball(center=(0.0, 0.0, 1.0), radius=radius))


def mesh(height: float) -> Mesh:
    points = np.eye(4, 3) * [1.0, 1.0, 1.0 + height]
    return Mesh(points, np.array([[0, 1, 2, 3]]), np.arange(4), np.zeros((0, 3), dtype=np.int64))


def test_the_same_inputs_give_the_same_object_inside_only() -> None:
    points = np.arange(6.0).reshape(2, 3)
    assert shared(make, a=points) is not shared(make, a=points)
    with sharing():
        first = shared(make, a=points, b=1)
        assert shared(make, b=1, a=points.copy()) is first
        assert shared(make, a=points, b=2) is not first
        assert shared(make, a=points.T.copy(), b=1) is not first
        assert shared(make, a=points.astype(np.float32), b=1) is not first
        assert shared(other, a=points, b=1) is not first
        with sharing():
            assert shared(make, a=points, b=1) is first, "an inner block is part of the outer one"
        assert shared(make, a=points, b=1) is first
    with sharing():
        assert shared(make, a=points, b=1) is not first


def test_what_two_turns_do_not_ask_for_is_let_go() -> None:
    with sharing():
        first = shared(make, a=1)
        next_turn()
        assert shared(make, a=1) is first
        next_turn()
        next_turn()
        assert shared(make, a=1) is not first


def test_what_is_needed_again_is_kept_until_then() -> None:
    with sharing():
        with needed_again(3):
            first = shared(make, a=1)
        for _ in range(3):
            next_turn()
            shared(make, a=2)
        assert shared(make, a=1) is first
        for _ in range(2):
            next_turn()
        assert shared(make, a=1) is not first


def test_next_uses_are_of_the_set_ups_that_were_used_last() -> None:
    assert next_uses("aabab") == [1, 3, 4, None, None]
    assert most_at_once(next_uses("aabab")) == 2
    assert most_at_once(next_uses("aabbc")) == 1
    ring = [f"{k}" for k in range(MOST_WAITING)]
    assert most_at_once(next_uses(ring * 2)) == MOST_WAITING
    assert next_uses(ring * 2) == [*range(MOST_WAITING, 2 * MOST_WAITING), *[None] * MOST_WAITING]
    ring.append("one more")
    assert next_uses(ring * 2) == [None] * 2 * len(ring)


def test_uses_are_watched() -> None:
    with sharing():
        shared(make, a=1)
        with watched() as used:
            shared(make, a=1)
            shared(make, a=2)
    assert [setup.uses for setup in used] == [2, 1]


def test_content_keys_tell_things_apart() -> None:
    things = [
        None, 0, 0.0, False, "", "0", (), (0,), ((0,),), {"a": 1}, {"a": 1.0}, {"b": 1},
        np.zeros(2), np.zeros((2, 1)), np.zeros(2, dtype=np.int64),
        Point(1.0), Point(2.0), Point(1.0, "a"), ("ab", "c"), ("a", "bc"),
        ball(0.1), ball(0.2), Ball(center=(0.0, 0.0, 1.0), radius=0.2), mesh(0.0), mesh(1.0),
    ]  # fmt: skip
    assert content_key(ball(0.1)) == content_key(ball(0.1))
    assert content_key(mesh(0.0)) == content_key(mesh(0.0))
    assert len({content_key(thing) for thing in things}) == len(things)
    assert content_key([1, 2]) == content_key((1, 2))
    assert content_key({"a": 1, "b": 2}) == content_key({"b": 2, "a": 1})
    with pytest.raises(TypeError, match="object has no content key"):
        content_key(object())
