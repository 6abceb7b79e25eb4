"""The position scanner finds the same keys as tomllib, each on the line where it is written."""

import tomllib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vdmbench.study.toml_lines import MAX_DEPTH, key_lines, statements

TEXT = '''# comment with "quotes" and [brackets]
title = "a # b"  # not in the text
"quoted.dot" = 1
a.b."c.d".'e f' = [1,
  [2, 3],  # ] in a comment
  { x = 1, y.z = "]" },
]
multi = """one ""\\" [no.table]
key = 2
"""
literal = \'\'\'
[neither]
\'\'\'

[ table . "dotted key" ]
inline = { p = { q = [ { r = 1 } ] } }

[[items]]
name = "first"
[items.sub]
deep = 1
[[items]]
name = "second"
[[items.parts]]
n = 1
[[items.parts]]
n = 2
"esc\\u0041\\t" = 3
'''


def paths_of(value: Any, path: tuple[str | int, ...] = ()) -> set[tuple[str | int, ...]]:
    found = {path} if path else set()
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in pairs:
        found |= paths_of(child, (*path, key))
    return found


def lines_of(text: str) -> dict[tuple[str | int, ...], int]:
    return key_lines(list(statements(text)))


def test_every_kind_of_key_is_on_its_line() -> None:
    lines = lines_of(TEXT)
    assert set(lines) == paths_of(tomllib.loads(TEXT))
    source = ["", *TEXT.split("\n")]
    expected = {
        ("title",): 2,
        ("quoted.dot",): 3,
        ("a", "b", "c.d", "e f"): 4,
        ("a", "b", "c.d", "e f", 0): 4,
        ("a", "b", "c.d", "e f", 1, 1): 5,
        ("a", "b", "c.d", "e f", 2, "y", "z"): 6,
        ("multi",): 8,
        ("literal",): source.index("literal = '''"),
        ("table", "dotted key", "inline", "p", "q", 0, "r"): source.index(
            "inline = { p = { q = [ { r = 1 } ] } }"
        ),
        ("items",): source.index("[[items]]"),
        ("items", 0, "sub", "deep"): source.index("deep = 1"),
        ("items", 1): source.index('name = "second"') - 1,
        ("items", 1, "name"): source.index('name = "second"'),
        ("items", 1, "parts", 0, "n"): source.index("n = 1"),
        ("items", 1, "parts", 1): source.index("n = 2") - 1,
        ("items", 1, "parts", 1, "escA\t"): source.index('"esc\\u0041\\t" = 3'),
    }
    assert {path: lines[path] for path in expected} == expected


@pytest.mark.parametrize(
    "text",
    [
        'a = """"quoted""""\nb = 1',
        "a = ''''quoted'''''\nb = 1",
        'a = """\\\\"""\nb = 1',
        'a = "\\""\r\nb = 1\r\n',
        'a = ""\nb = \'\'\nc = """"""\nd = 1',
        "a = [\n# [\n]\nb = {}\nc = [{}, {},]\n",
        "a = 1979-05-27 07:32:00\nb = -inf\n",
        "1.2 = 3\n'' = 4",
        "[a.b]\nx = 1\n[a]\ny = 2\n[a.c.d]\n",
        "[[a]]\n[[a]]\n[a.b]\nc = 1\n[[a.d]]\n[a.d.e]\n",
        "",
        "# only a comment",
    ],
)
def test_awkward_texts_give_the_keys_of_tomllib(text: str) -> None:
    assert set(lines_of(text)) == paths_of(tomllib.loads(text))


@given(st.text(alphabet="[]{}=.,'\"#\\ab1 \n", max_size=40))
def test_any_text_that_is_toml_gives_the_keys_of_tomllib(text: str) -> None:
    found = list(statements(text))
    try:
        sound = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert set(key_lines(found)) == paths_of(sound)


def test_the_depth_limit_itself_is_allowed() -> None:
    """What is deeper is refused with its line: tests/robustness/test_study_files.py."""
    text = "a = " + "[" * (MAX_DEPTH - 1) + "]" * (MAX_DEPTH - 1)
    assert set(lines_of(text)) == paths_of(tomllib.loads(text))
