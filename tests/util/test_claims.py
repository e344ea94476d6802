"""Folders that one process at a time writes to."""

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from extras import need

from experiments.records import FILE, Results
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.settings import SceneSettings
from hyjax.training.run import train
from hyjax.training.settings import TrainSettings
from hyjax.tuning.settings import TuneSettings
from hyjax.tuning.study import FILE_NAME
from hyjax.tuning.tune import tune_schedule
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


@contextlib.contextmanager
def of_another(folder: Path) -> Iterator[None]:
    """A folder that somebody else has claimed: locks are of open files, not of processes."""
    fcntl = pytest.importorskip("fcntl", reason="no locks of files on this system")
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def test_a_relighting_that_is_refused_leaves_the_files_of_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[SceneSettings] = []
    monkeypatch.setattr(SceneSettings, "open_capture", lambda self, **_: opened.append(self))
    files = {tmp_path / name for name in ("run.json", "lights.json", "contact_sheet.png")}
    for file in files:
        file.write_text(file.name)
    with of_another(tmp_path), pytest.raises(InputError, match="another run writes there"):
        relight_capture(RelightSettings(out=tmp_path, quiet=True))
    assert not opened  # refused before the room is rendered
    assert {file for file in tmp_path.iterdir() if file.read_text() == file.name} == files


def test_a_tuning_of_a_folder_in_use_does_not_say_that_it_can_go_on(tmp_path: Path) -> None:
    need("tune")
    (tmp_path / FILE_NAME).write_text("{}\n")
    with of_another(tmp_path), pytest.raises(InputError, match="another run writes there"):
        tune_schedule(settings=TuneSettings(fps=(30.0,), out=tmp_path, quiet=True))


def test_a_training_that_is_refused_leaves_the_log_of_the_other(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text('{"iteration": 1, "loss": 0.5}\n{"iter')
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    settings = TrainSettings(pairs=("rooms",), size=32, batch=1, factors=(8,))
    for resume in (False, True):
        with of_another(tmp_path), pytest.raises(InputError, match="another run writes there"):
            train(settings, tmp_path, resume=resume, progress=False)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_an_experiment_that_is_refused_leaves_the_rows_of_the_other(tmp_path: Path) -> None:
    before = b'{"experiment": "paper", "settings": {}, "kind": "frame"}\n{"kin'
    (tmp_path / FILE).write_bytes(before)
    for resume in (False, True):
        with of_another(tmp_path), pytest.raises(InputError, match="another run writes there"):
            Results(tmp_path, "paper", TuneSettings(), resume=resume)
    assert (tmp_path / FILE).read_bytes() == before and len(list(tmp_path.iterdir())) == 1
