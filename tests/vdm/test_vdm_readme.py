"""`vdm/README.md`: its example runs, and its table names functions and tests that exist."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path

import vdm

README = (Path(vdm.__file__).parent / "README.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| ([^|]+) \| `(vdm\.[\w.]+)` \| `(test_\w+)` \|$", README, flags=re.MULTILINE)
TESTS = "\n".join(p.read_text(encoding="utf-8") for p in Path(__file__).parents[1].glob("*/test_vdm_*.py"))


def covered_equations() -> set[int]:
    numbers: set[int] = set()
    for text, _, _ in ROWS:
        for first, last in re.findall(r"(\d+)(?:-(\d+))?", text):
            numbers |= set(range(int(first), int(last or first) + 1))
    return numbers


def test_every_numbered_equation_has_a_row():
    assert covered_equations() == set(range(1, 39))


def test_rows_name_code_and_tests_that_exist():
    for text, path, test in ROWS:
        assert pkgutil.resolve_name(path).__doc__, f"equation {text}: {path} has no docstring"
        assert f"def {test}(" in TESTS


def test_example_runs():
    example = re.search(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert example is not None
    exec(compile(example.group(1), "README.md", "exec"), {})
