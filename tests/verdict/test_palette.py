"""A model keeps its colour and marker in every report."""

import itertools

from vdmbench.report.plots import look
from vdmbench.study.registry import all_models
from vdmbench.verdict.palette import COLOURS, places


def looks(names: list[str]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(look(k).values()) for name, k in places(names).items()}


def test_a_look_hangs_on_the_name_and_on_nothing_else_of_the_study() -> None:
    names = [
        *(name for name in all_models() if name.startswith(("vdm-", "fem"))),
        "of-a-plugin",
        "vdm-vector:nonlinear",
    ]
    every = looks(names)
    for some in ([names[2]], names[::-1], names[1::3], [*names[4:], *names[:4]]):
        assert looks(some) == {name: every[name] for name in some}
    assert places(["vdm-paper", "bem"]) == {"vdm-paper": 0, "bem": 3}, "as published pages have it"


def test_no_two_models_of_a_study_look_alike() -> None:
    names = [f"mine-{k}" for k in range(30)] + list(all_models())
    assert len(set(places(names).values())) == len(names), "some of the thirty hashes collide"
    assert len(set(looks(names[-18:]).values())) == 18
    for a, b in itertools.combinations(range(COLOURS**2), 2):
        assert {**look(a), "linestyle": ""} != {**look(b), "linestyle": ""}, "told apart without a line too"
