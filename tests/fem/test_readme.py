"""`fem_reference/README.md`: its example runs."""

from __future__ import annotations

import re
from pathlib import Path

import fem_reference

README = Path(fem_reference.__file__).with_name("README.md").read_text(encoding="utf-8")


def test_examples_run() -> None:
    examples = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(examples) == 2, "the second goes on from the first"
    exec(compile("".join(examples), "README.md", "exec"), {})
