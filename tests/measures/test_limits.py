"""The search for small-strain limits on paths whose crossings are known in closed form."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vdmbench.measures.limits import (
    LARGEST,
    MOST_STRAIN,
    SMALL,
    LoadPath,
    LoadPoint,
    model_limits,
    on_finer_mesh,
)

E0 = 0.2


class Body:
    """Error E0 + c load^p, a reference that stops at one load and a model that stops at another."""

    def __init__(
        self,
        c: float = 1e-3,
        p: float = 1.0,
        reference_stops: float = math.inf,
        model_stops: float = math.inf,
        strain: Callable[[float], float] = lambda load: 1e-4 * load,
    ) -> None:
        self.c, self.p, self.strain = c, p, strain
        self.reference_stops, self.model_stops = reference_stops, model_stops
        self.loads: list[float] = []

    def __call__(self, load: float) -> LoadPoint | None:
        self.loads.append(load)
        if abs(load) > self.reference_stops:
            return None
        strain = self.strain(abs(load))  # the largest of any point; half of it is the strain of the axis
        error = math.nan if abs(load) > self.model_stops else E0 + self.c * abs(load) ** self.p
        return LoadPoint({"m": error, "flat": E0}, 1e-3 * abs(load), 0.5 * strain, strain)


def path_of(body: Callable[[float], LoadPoint | None], start: float = 1.0) -> LoadPath:
    """The path of a body whose study has a load of this size."""
    return LoadPath(lambda factor: body(factor * start))


@pytest.mark.parametrize("power", [0.7, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("start", [0.1, 30.0, 1000.0])
def test_crossings_of_a_power_law(power: float, start: float) -> None:
    body = Body(c=0.05 / 40.0**power, p=power)  # grown by 0.05 at a load of 40
    path = path_of(body, start)
    found = model_limits(path, "m", (0.1, 0.05))
    e0 = E0 + body.c * (SMALL * start) ** power
    assert_allclose(found.structural_error, e0, rtol=1e-12, atol=0)
    assert [limit.threshold for limit in found.limits] == [0.05, 0.1]
    for limit in found.limits:
        load = limit.load * start
        if limit.state == "beyond":  # only where the answer lies outside the loads tried
            assert body.c * (LARGEST * start) ** power < limit.threshold
            continue
        assert limit.state == "found"
        grown = body.c * load**power - (e0 - E0)
        assert_allclose(grown, limit.threshold, rtol=0.0201, atol=0)
        assert_allclose([limit.indentation, limit.strain], [1e-3 * load, 0.5e-4 * load])
    assert len(body.loads) == len(set(body.loads)) < 30  # each load once, and not many


def test_a_reference_that_stops_says_so_and_how_far_it_came() -> None:
    (limit,) = model_limits(path_of(Body(reference_stops=50.0)), "flat", (0.05,)).limits
    assert limit.state == "reference-stopped"
    assert 32.0 <= limit.load <= 50.0
    assert limit.load > 47.0  # the last loads close in on it


def test_a_model_that_stops_first_says_so() -> None:
    body = Body(c=0.05 / 90.0, model_stops=20.0)
    (limit,) = model_limits(path_of(body), "m", (0.05,)).limits
    assert limit.state == "model-stopped"
    assert 16.0 <= limit.load <= 20.0


def test_nothing_to_find_where_nothing_can_be_solved() -> None:
    nothing = model_limits(path_of(Body(reference_stops=0.0)), "m", (0.05,))
    assert math.isnan(nothing.structural_error)
    assert nothing.limits[0].state == "reference-stopped"
    model = model_limits(path_of(Body(model_stops=0.0)), "m", (0.05,))
    assert model.limits[0].state == "model-stopped"


def test_limits_of_a_finer_mesh_and_their_bars() -> None:
    """Against the closed form: power laws on both meshes, each with factors of its own."""

    loads = []

    def finer(load: float) -> LoadPoint:
        loads.append(load)
        return LoadPoint({"m": 0.21 + 8e-5 * load**2, "flat": E0}, 1.2e-3 * load, 0.45e-4 * load, 2e-4 * load)

    path, fine = path_of(Body(c=1e-4, p=2.0), 10.0), path_of(finer, 10.0)
    coarse = model_limits(path, "m", (0.05, 0.2))
    limits = on_finer_mesh(coarse, path, fine, "m")
    assert_allclose([limits.structural_error, limits.structural_bar], [0.21, 0.0125], rtol=0.02, atol=0)
    for threshold, limit in zip((0.05, 0.2), limits.limits, strict=True):
        load = math.sqrt(threshold / 8e-5)
        assert_allclose(
            [10.0 * limit.load, limit.indentation, limit.strain, limit.largest_strain],
            [load, 1.2e-3 * load, 0.45e-4 * load, 2e-4 * load],
            rtol=1e-3,
            atol=0,
        )
        moved = 1.0 - math.sqrt(0.8)  # from the limit of the coarse mesh, of that of the finer one
        searched = (
            1.25 * moved + 0.02 / 2.0
        )  # to 2 % of the threshold, which grows with the square of the load
        bars = [searched, 1.25 * (1.0 - 1.0 / 1.2) + searched, 1.25 * (1.0 / 0.9 - 1.0) + searched]
        assert_allclose([limit.bar, limit.indentation_bar, limit.strain_bar], bars, rtol=1e-3, atol=0)
    assert len(loads) == 3  # a small load, and one for each limit
    alone = on_finer_mesh(model_limits(path, "m", (0.05,)), path, path_of(finer, 10.0), "m").limits[0]
    assert_allclose([alone.load, alone.bar], [limits.limits[0].load, limits.limits[0].bar], rtol=1e-3, atol=0)
    unfound = on_finer_mesh(model_limits(path, "flat", (0.05,)), path, fine, "flat").limits[0]
    assert unfound.state == "beyond"
    assert np.isnan(unfound.bar)


def test_where_the_finer_mesh_has_no_structural_error_all_stays_without_bars() -> None:
    path = path_of(Body(c=1e-4, p=2.0), 10.0)
    coarse = model_limits(path, "m", (0.05,))
    limits = on_finer_mesh(coarse, path, path_of(Body(reference_stops=0.0), 10.0), "m")
    assert limits.limits[0] is coarse.limits[0]
    assert np.isnan([limits.structural_bar, limits.limits[0].bar, limits.limits[0].strain_bar]).all()


@pytest.mark.parametrize(
    "finer",
    [
        Body(c=-1e-5),  # the error falls
        Body(c=0.0),
        Body(c=1e-7, p=2.0),  # it grows, and would reach the threshold at 71 times the study's load
        Body(c=0.5e-4, p=2.0),  # at 32, beyond where the reference of the case's mesh stops
        Body(c=1e-16, p=2.0),
        Body(c=1e-4, p=2.0, reference_stops=10.0),  # the limit is at 22
        Body(c=1e-4, p=2.0, model_stops=10.0),
        Body(c=1e-4, p=2.0, strain=lambda load: 0.2 * load),
        Body(c=0.9e-4, p=2.0, strain=lambda load: 0.175 * load),  # 3.9 at 22, and 4.1 where it leads
    ],
)
def test_a_limit_that_the_finer_mesh_does_not_have_is_unresolved(finer: Body) -> None:
    """With the figures of the mesh that has it, and no bars."""
    path = path_of(Body(c=1e-4, p=2.0, reference_stops=28.0), 10.0)
    own = model_limits(path, "m", (0.05,))
    limits = on_finer_mesh(own, path, path_of(finer, 10.0), "m")
    (coarse,), (limit,) = own.limits, limits.limits
    assert coarse.state == "found"
    assert limit.state == "unresolved"
    assert_allclose(limits.structural_error, E0, rtol=1e-3, atol=0)
    assert (limit.load, limit.strain, limit.indentation) == (coarse.load, coarse.strain, coarse.indentation)
    assert np.isnan([limit.bar, limit.strain_bar, limit.indentation_bar]).all()


@pytest.mark.parametrize("power", [0.5, 6.0])
@pytest.mark.parametrize("start", [0.01, 30.0])
def test_a_search_ends_at_a_strain_that_says_nothing(power: float, start: float) -> None:
    """Near the load of that strain, 20, from below, in few steps; no model is asked beyond it."""
    body = Body(reference_stops=30.0, strain=lambda load: MOST_STRAIN * (load / 20.0) ** power)
    path = path_of(body, start)
    limits = [model_limits(path, name, (0.05, 0.1)).limits for name in ("flat", "m")]
    (end,) = {limit.load * start for found in limits for limit in found}
    assert {limit.state for found in limits for limit in found} == {"beyond"}
    if LARGEST * start < 20.0:
        assert end == LARGEST * start
    else:
        assert (0.85 if start < 20.0 else 0.6) * 20.0 <= end <= 20.0
    assert len(body.loads) < 17
    assert max(body.loads) <= max(start, 25.0)


def test_a_limit_below_that_strain_is_found_and_one_above_is_not() -> None:
    def strain(load: float) -> float:
        return MOST_STRAIN * (load / 20.0) ** 2

    low, high = model_limits(path_of(Body(c=0.05 / 18.0, strain=strain)), "m", (0.05, 0.1)).limits
    assert (low.state, high.state) == ("found", "beyond")
    assert_allclose(low.load, 18.0, rtol=0.025, atol=0)
    assert 18.0 < high.load <= 20.0
    unknown = model_limits(path_of(Body(strain=lambda _: math.nan)), "flat", (0.05,)).limits[0]
    assert unknown.load == LARGEST
