"""`fem_reference/README.md`: its example runs, and what it names exists."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import fem_reference
from fem_reference.linear import ELEMENTS

FOLDER = Path(fem_reference.__file__).parent
README = (FOLDER / "README.md").read_text(encoding="utf-8")


def test_examples_run() -> None:
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(examples) == 2, "the second goes on from the first"
    exec(compile("".join(examples), "README.md", "exec"), {})


def test_names_that_it_uses_exist() -> None:
    order = README.split("The modules of the fast path follow")[1].split("\n\n")[0]
    modules = re.findall(r"`(\w+)`", order)
    assert len(modules) >= 12
    assert all(find_spec(f"fem_reference.{name}") for name in modules)
    assert all(f"`{name}`" in README or name in README for name in ELEMENTS)
    for target in re.findall(r"\]\(([\w./-]+)\)", README):
        assert (FOLDER / target).exists(), target


SOLVER_MODULES = (
    "assembly condensed finite_strain follower krylov linear linear_algebra multigrid newton plain_body"
    " plain_finite_strain plain_linear tangent_solver"
)


@pytest.mark.parametrize("name", SOLVER_MODULES.split())
def test_a_solver_names_its_method_its_order_and_its_source(name: str) -> None:
    told = " ".join((import_module(f"fem_reference.{name}").__doc__ or "").split())
    places = [told.find(word) for word in ("Method: ", "Order: ", "Source: ")]
    assert -1 < places[0] < places[1] < places[2], told
