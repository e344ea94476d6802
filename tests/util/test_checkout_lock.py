"""Asking for the checkout's commit leaves the checkout as it was."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from hyjax.util.checkout import commit


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_index_is_not_written(tmp_path: Path) -> None:
    """Else it is locked for it, and a run that is killed meanwhile leaves the lock."""
    (tmp_path / "a.txt").write_text("a")
    author = ["-c", "user.name=a", "-c", "user.email=a@example.org"]
    for words in (["init", "-q"], ["add", "a.txt"], [*author, "commit", "-qm", "first"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    os.utime(tmp_path / "a.txt", (1e9, 1e9))  # which `git status` would note
    before = (tmp_path / ".git" / "index").read_bytes()
    assert len(commit(tmp_path)) == 40
    assert (tmp_path / ".git" / "index").read_bytes() == before
