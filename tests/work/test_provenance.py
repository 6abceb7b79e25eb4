"""Where a result comes from: the commit of the program's source tree."""

import subprocess
from pathlib import Path

import pytest

from vdmbench.work import provenance


def git(tree: Path, *words: str) -> str:
    who = ("-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", "-C", tree, *who, *words], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_the_commit_is_that_of_the_tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "studies" / "work" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("first\n")
    monkeypatch.setattr(provenance, "__file__", str(source))
    assert provenance._commit() == "not a source tree"
    git(tmp_path, "init", "-q")
    assert provenance._commit() == "unknown", "nothing is committed yet"
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "first")
    assert provenance._commit() == git(tmp_path, "rev-parse", "HEAD")
    git(tmp_path, "tag", "v1")
    source.write_text("second\n")
    assert provenance._commit() == git(tmp_path, "rev-parse", "HEAD") + "-dirty"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert provenance._commit() == "unknown", "there is no git"
