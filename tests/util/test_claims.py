"""Folders that one process at a time writes to."""

import subprocess
import sys
from pathlib import Path

import pytest

from hyjax.util.claims import claimed
from hyjax.util.errors import InputError

CLAIM = """
import sys
from pathlib import Path
from hyjax.util.claims import claimed
with claimed(Path(sys.argv[1])):
    print("claimed", flush=True)
    sys.stdin.read()
"""


def test_a_folder_is_of_one_process_until_it_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", CLAIM, str(tmp_path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as other:  # type: ignore[call-overload]
        assert other.stdout.readline() == "claimed\n"
        with pytest.raises(InputError, match="another run writes there"), claimed(tmp_path):
            pass
        other.kill()
        other.wait()
        with claimed(tmp_path):
            pass
    assert not list(tmp_path.iterdir())


def test_a_process_may_claim_a_folder_again(tmp_path: Path) -> None:
    command = [sys.executable, "-c", CLAIM, str(tmp_path)]
    with claimed(tmp_path):
        with claimed(tmp_path):
            pass
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        assert "another run writes there" in done.stderr
    assert subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL).returncode == 0


def test_no_folder_and_a_missing_one(tmp_path: Path) -> None:
    with claimed(None):
        pass
    with pytest.raises(InputError, match="missing: cannot write"), claimed(tmp_path / "missing"):
        pass
