"""How a command ends where its verb raises: a line per problem, and an exit code that tells whose fault it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.command import vdmbench
from vdmbench.cli.arguments import verbs
from vdmbench.cli.main import _complain_of
from vdmbench.store.plain import OlderSchemaError, StoreError
from vdmbench.study.errors import InputError, Problem, StudyError


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (ImportError("no such library"), 4, ["no such library"]),
        (FileExistsError(17, "File exists", "x"), 4, ["x: is not a directory; remove it, or choose another"]),
        (OSError(28, "No space left on device", "x"), 4, ["x: No space left on device"]),
        (OSError(28, "No space left on device"), 4, ["No space left on device"]),
        (OSError("it is too late"), 4, ["it is too late"]),
        (StoreError("x.h5 is damaged"), 5, ["x.h5 is damaged"]),
        (OlderSchemaError("x.h5 is old"), 5, ["x.h5 is old"]),
        (InputError("no such thing"), 2, ["no such thing"]),
        (
            StudyError(Problem("s.toml", line, "a.b", "is bad") for line in (3, 5)),
            2,
            ["s.toml:3: a.b: is bad", "s.toml:5: a.b: is bad"],
        ),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_an_error_means_to_the_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int, said: list[str]
) -> None:
    def verb(_: object) -> int:
        raise error

    monkeypatch.setitem(verbs(), "list", verbs()["list"]._replace(do=verb))
    result = vdmbench("list", cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.splitlines() == [f"vdmbench: {line}" for line in said]


def test_a_bug_is_told_from_a_regression(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError) as caught:
        {}["on mine"]
    assert _complain_of(caught.value) == 70
    *trace, told = capsys.readouterr().err.splitlines()
    assert told == "vdmbench: this is a bug: KeyError('on mine'); please report it with the lines above"
    assert trace[0].startswith("Traceback")
