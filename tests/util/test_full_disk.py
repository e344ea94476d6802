"""Disks that are full: writers either write a whole file, or say so and leave what was there."""

import contextlib
import json
import logging
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from extras import need

from hyjax.export.run import write_files
from hyjax.geometry.mesh import save_mesh
from hyjax.util.cache import cached_arrays
from hyjax.util.errors import InputError
from hyjax.util.files import atomic_write, new_folder, write_text
from hyjax.util.images import write_depth, write_exr, write_labels, write_png
from hyjax.util.run_log import RunLog, read_lines

PICTURE = np.random.default_rng(0).random((40, 50, 3)).astype(np.float32)
LINES = [{"iteration": number, "text": "x" * 40} for number in range(20)]


def write_guide(path: Path) -> None:
    import safetensors.numpy

    with atomic_write(path) as temporary:
        temporary.write_bytes(safetensors.numpy.save({"a": PICTURE}))


def write_plot(path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    figure.subplots().plot(PICTURE[:, 0, 0])
    with atomic_write(path) as temporary:
        figure.savefig(temporary)


def write_video(path: Path) -> None:
    need("captures")

    from hyjax.data.video_frames import new_video

    random = np.random.default_rng(0)
    with atomic_write(path) as temporary, new_video(temporary, (40, 50), 30) as add:
        for _ in range(4):
            add(random.integers(0, 256, (40, 50, 3), dtype=np.uint8))


def write_pictures(path: Path) -> None:
    with new_folder(path, replace=True) as folder:
        write_png(folder / "a.png", PICTURE)
        write_text(folder / "b.json", json.dumps(LINES))
        (folder / "c.bin").write_bytes(bytes(9000))


def write_export(path: Path) -> None:
    write_files(path.parent, {f"{path.name}/weights/a.bin": bytes(9000), f"{path.name}/model.txt": b"model"})


WRITERS: dict[str, Callable[[Path], object]] = {
    "a.png": lambda path: write_png(path, PICTURE),
    "depth.png": lambda path: write_depth(path, 3 * PICTURE[..., 0]),
    "labels.png": lambda path: write_labels(path, (PICTURE[..., 0] * 3).astype(np.uint8)),
    "a.exr": lambda path: write_exr(path, PICTURE),
    "a.json": lambda path: write_text(path, json.dumps(LINES)),
    "a.html": lambda path: write_text(path, "<p>µ</p>" * 500),
    "a.ply": lambda path: save_mesh(path, trimesh.creation.icosphere(2)),
    "a.glb": lambda path: save_mesh(path, trimesh.creation.icosphere(2)),
    "a.safetensors": write_guide,
    "plot.png": write_plot,
    "a.mp4": write_video,
    "pictures": write_pictures,
    "export": write_export,
}


@contextlib.contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """No file may grow beyond so many bytes: writing fails as on a full disk (Python ignores SIGXFSZ)."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def contents(path: Path) -> dict[str, bytes]:
    """Files of a folder, or a file, by name."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {str(file.relative_to(path)): file.read_bytes() for file in files if file.is_file()}


SLOW = {"plot.png": pytest.mark.slow}  # Matplotlib takes long to load
SIZES = 8
"""Number of sizes that are too small for a file."""


@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW.get(name, ())) for name in WRITERS])
def test_a_file_is_whole_or_refused(name: str, tmp_path: Path) -> None:
    """At each of some sizes: all of it, or an `InputError` and what was there before."""
    write = WRITERS[name]
    write(tmp_path / name)
    whole = contents(tmp_path / name)
    largest = max(map(len, whole.values()))
    refused = 0
    for size in sorted({*np.linspace(0, largest - 1, SIZES, dtype=int).tolist(), largest}):
        before = contents(tmp_path / name)
        try:
            with no_file_beyond(size):
                write(tmp_path / name)
        except InputError as error:
            refused += 1
            assert "cannot write" in str(error) and "\n" not in str(error) and ".part" not in str(error)
            assert name in str(error)
            assert contents(tmp_path / name) == before
        else:
            assert size == largest or name == "a.mp4", f"{size} of {largest} bytes were enough"
        assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert refused >= SIZES - (name == "a.mp4")


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_small_disk(name: str, tmp_path: Path) -> None:
    """A file system of 8 to 96 KiB, which takes a file's beginning and then no more."""
    for size in range(8, 100, 8):
        with small_disk(tmp_path / "disk", size << 10) as disk:
            try:
                WRITERS[name](disk / name)
            except InputError as error:
                assert "free some space" in str(error)
                assert not list(disk.iterdir())
            else:
                assert [entry.name for entry in disk.iterdir()] == [name]
                shutil.copytree(disk, tmp_path / str(size))
    made = [contents(folder / name) for folder in tmp_path.glob("[0-9]*")]
    WRITERS[name](tmp_path / name)
    lengths = {key: len(content) for key, content in contents(tmp_path / name).items()}
    assert made and all({key: len(content) for key, content in each.items()} == lengths for each in made)


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def test_a_log_goes_on_after_a_line_that_did_not_fit(tmp_path: Path) -> None:
    log = RunLog(tmp_path / "log.jsonl")
    log.add(LINES[0])
    size = log.path.stat().st_size  # type: ignore[union-attr]
    for room in (0, 1, size - 1):
        with no_file_beyond(size + room), pytest.raises(InputError, match=r"log\.jsonl: cannot write"):
            log.add(LINES[1])
        assert read_lines(tmp_path / "log.jsonl", dict.keys, "a line") == LINES[:1]
    log.add(LINES[2])
    assert read_lines(tmp_path / "log.jsonl", dict.keys, "a line") == [LINES[0], LINES[2]]


def test_rows_of_a_sweep_go_on_after_one_that_did_not_fit(tmp_path: Path) -> None:
    from hyjax.sweep.rows import RowStore, RowWriter

    writer = RowWriter(tmp_path)
    writer.add({"key": "a", "kind": "result"})
    with no_file_beyond(writer.path.stat().st_size + 5), pytest.raises(InputError, match="make room and resume"):
        writer.add({"key": "b", "kind": "result"})
    writer.add({"key": "c", "kind": "result"})
    writer.close()
    assert RowStore(tmp_path).refresh().done() == {"a", "c"}


def test_a_full_cache_costs_time_and_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def parse(arrays: object) -> float:
        return float(arrays["a"].sum())  # type: ignore[index]

    with caplog.at_level(logging.WARNING), no_file_beyond(100):
        for number in range(3):
            made = cached_arrays(tmp_path / "full" / f"{number}.npz", parse, lambda: {"a": PICTURE})
            assert made == parse({"a": PICTURE})
    assert len(caplog.records) == 1 and "cannot keep" in caplog.text
    assert not list((tmp_path / "full").iterdir())


def test_a_program_that_cannot_be_kept_still_runs(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hyjax.util import programs

    monkeypatch.setattr(programs, "_folder", tmp_path)
    double = programs.KeptFunction(lambda x: 2 * x)
    with caplog.at_level(logging.WARNING), no_file_beyond(100):
        np.testing.assert_array_equal(double(np.arange(3)), [0, 2, 4])
    assert "cannot keep" in caplog.text and not list(tmp_path.iterdir())
