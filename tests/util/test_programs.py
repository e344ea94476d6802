"""Kept programs: read in another process, the same result, and made anew where they are damaged."""

import importlib
import os
import subprocess
import sys
import threading
import time
from fnmatch import fnmatch
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.light.kinds import AmbientLight, PointLight, pytree
from hyjax.light.setup import LightSetup
from hyjax.util import compiled_cache, programs, quick_programs
from hyjax.util.cache import remove_oldest
from hyjax.util.programs import KeptFunction

RUN = """
import logging, sys
logging.basicConfig(level=logging.WARNING, format="hyjax: %(message)s")
import jax, jax.numpy as jnp
import hyjax
from hyjax.util.compiled_cache import keep_compiled
from hyjax.util.programs import run_kept
keep_compiled()
points = jnp.linspace(0.0, 1.0, 300).reshape(10, 10, 3)
gbuffer = hyjax.GBuffer(points, points, points[..., 0], points[..., 0] > 0.1)
white = jnp.ones(3)
lights = (hyjax.PointLight(jnp.array([1.0, 1.0, 2.0]), 800.0, white, radius=0.1), hyjax.AmbientLight(60.0, white))
light = run_kept(hyjax.shade_each, gbuffer, lights)
other = jnp.tanh(light).sum()  # by JAX's own cache
print(float(light.sum()), float(other))
"""


def run(cache: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"HYJAX_CACHE": str(cache)}
    return subprocess.run(
        [sys.executable, "-c", RUN], capture_output=True, text=True, check=True, timeout=300, env=environment
    )


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A cache folder with programs, and what was printed."""
    cache = tmp_path_factory.mktemp("cache")
    return cache, run(cache).stdout


def stored(cache: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in (cache / "compiled").iterdir() if "-atime" not in file.name}


def test_a_second_process_reads_what_the_first_one_made(first: tuple[Path, str]) -> None:
    cache, printed = first
    before = stored(cache)
    assert any(name.startswith("light.shading.shade_each-") for name in before)
    again = run(cache)
    assert again.stdout == printed and again.stderr == "" and stored(cache) == before


def test_the_oldest_of_too_many_programs_go(first: tuple[Path, str], tmp_path: Path) -> None:
    files = [tmp_path / "compiled" / f"jit_{name}-cache" for name in "abc"]
    files[0].parent.mkdir()
    for age, file in enumerate(files):
        file.write_bytes(bytes(1000))
        os.utime(file, (1000.0 - age, 1000.0 - age))
    remove_oldest(files[0].parent, compiled_cache.JAX_PATTERN, 2500)
    assert [file.is_file() for file in files] == [True, True, False]
    assert any(fnmatch(name, compiled_cache.JAX_PATTERN) for name in stored(first[0])), "JAX names them otherwise"


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["truncated", "garbled", "flipped"])
def test_damaged_files_are_made_anew_with_a_line(first: tuple[Path, str], damage: str) -> None:
    cache, printed = first
    damaged = [cache / "compiled" / name for name in stored(cache) if "shade_each" in name or "tanh" in name]
    assert sorted(file.suffix for file in damaged) == ["", ".program"]  # JAX's and ours
    if damage == "flipped":  # a single byte shows itself by the checksum alone, which JAX's files need not have
        damaged = [file for file in damaged if file.suffix]
    for file in damaged:
        whole = file.read_bytes()
        middle = len(whole) // 2
        flipped = whole[:middle] + bytes([whole[middle] ^ 0xFF]) + whole[middle + 1 :]
        file.write_bytes({"truncated": whole[:middle], "garbled": bytes(len(whole)), "flipped": flipped}[damage])
    again = run(cache)
    assert again.stdout == printed
    assert again.stderr.count("\n") == again.stderr.count("damaged") == len(damaged)  # one for each kind of file
    healed = run(cache)
    assert healed.stdout == printed and healed.stderr == ""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(programs, "_folder", tmp_path)
    return tmp_path


def scaled(x: jax.Array, factor: float) -> jax.Array:
    return factor * x


def test_a_program_is_the_function(folder: Path) -> None:
    program = KeptFunction(scaled)
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(program(x, 2.0), 2.0 * x)
    np.testing.assert_array_equal(program(x, factor=3.0), 3.0 * x)
    np.testing.assert_array_equal(KeptFunction(scaled)(x, 4.0), 4.0 * x)  # read from the folder
    assert float(jax.grad(lambda factor: program(x, factor).sum())(1.0)) == 3.0
    np.testing.assert_array_equal(jax.vmap(program, (0, None))(x, 2.0), 2.0 * x)
    assert program(jnp.arange(3), 2).dtype == jnp.int32
    assert len(list(folder.iterdir())) == 3


def test_arrays_and_numbers_of_one_type_share_a_program(folder: Path) -> None:
    half = KeptFunction(lambda x: x / 2)
    for given in (3.0, np.float64(3.0), np.float32(3.0), jnp.float32(3.0), np.array(3.0)):
        assert float(half(given)) == 1.5
    assert len(half._ready) == 1


def test_trees_and_their_fixed_parts_tell_programs_apart(folder: Path) -> None:
    first = KeptFunction(lambda tree: jax.tree.leaves(tree)[0] + len(tree))
    assert int(first({"a": jnp.int32(1)})) == 2 and int(first({"a": jnp.int32(1), "b": jnp.int32(5)})) == 3
    lights = AmbientLight(1.0, (1.0, 1.0, 1.0)), PointLight((0.0, 0.0, 0.0), 1.0, (1.0, 1.0, 1.0))
    for light in lights:
        KeptFunction(lambda light: light.color)(LightSetup((light,)).lights[0])
    assert len(list(folder.iterdir())) == 4


def test_programs_of_another_version_are_made_anew_with_one_line(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    KeptFunction(scaled)(jnp.ones(2), 2.0)
    KeptFunction(scaled)(jnp.ones(3), 2.0)
    assert not caplog.records  # another shape is no other version
    monkeypatch.setattr(programs, "_surroundings", lambda: "another")
    monkeypatch.setattr(programs, "_told", False)
    for size in (2, 3):
        KeptFunction(scaled)(jnp.ones(size), 2.0)
    (line,) = (record.getMessage() for record in caplog.records)
    assert line == f"{folder}: programs in it are of another version, source or machine, and are made anew"
    assert len(list(folder.iterdir())) == 4


@pytest.mark.parametrize("name", ["XLA_FLAGS", "NPROC", "PJRT_NPROC", "JAX_ENABLE_X64"])
def test_what_changes_programs_is_part_of_their_key(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    here = programs._surroundings.__wrapped__()
    monkeypatch.setenv(name, f"{os.environ.get(name, '')}3")
    assert programs._surroundings.__wrapped__() != here


def test_only_optimised_programs_but_cascades_use_wide_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    cascade, other = KeptFunction(scaled), KeptFunction(scaled)
    cascade._name = programs.CASCADES[0]
    wide = quick_programs.WIDE_OPTIONS
    assert other._options() == wide and not wide.keys() & {**cascade._options(), **quick_programs.QUICK_OPTIONS}
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_prefer_vector_width=256")
    assert other._options() == {}
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.delenv("XLA_FLAGS")
    assert other._options() == cascade._options() == {}


def test_a_program_made_ready_is_the_one_that_runs(folder: Path) -> None:
    kept = KeptFunction(scaled)
    kept.make_ready(jnp.zeros(2), jnp.float32(0.0))
    (file,) = folder.iterdir()
    file.unlink()
    np.testing.assert_array_equal(kept(jnp.ones(2), jnp.float32(2.0)), [2.0, 2.0])
    assert not list(folder.iterdir())


def names(folder: Path) -> set[str]:
    """Ends of the names of kept programs."""
    return {file.name[file.name.index(".", file.name.rindex("-")) :] for file in folder.iterdir()}


def optimised(folder: Path) -> None:
    """Wait for the program that takes over, and for the quick one to go."""
    end = time.monotonic() + 30.0
    while names(folder) != {".program"}:
        assert time.monotonic() < end, names(folder)
        time.sleep(0.01)


def join_optimisers() -> None:
    """Wait for the threads of a context that has ended: a program takes over after its file is there."""
    for thread in threading.enumerate():
        if thread.name.startswith("optimised programs"):
            thread.join(30.0)


def test_a_quick_program_is_optimised_once_it_is_run_again(folder: Path) -> None:
    kept, arrays = KeptFunction(lambda x, factor: factor * jnp.sin(x)), (jnp.ones(2), 2.0)
    with quick_programs.quick_programs():
        quick = kept(*arrays)
        (first,) = kept._ready.values()
        assert np.array_equal(kept(*arrays), quick) and names(folder) == {quick_programs.QUICK_SUFFIX}
        quick_programs.optimise_programs()
        assert names(folder) == {quick_programs.QUICK_SUFFIX}, "what runs no more is left"
        kept(*arrays)
        optimised(folder)
    join_optimisers()
    (second,) = kept._ready.values()
    assert second is not first
    np.testing.assert_allclose(kept(*arrays), quick, rtol=1e-6)


def test_a_quick_program_is_read_by_the_next_start_and_optimised_there(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with quick_programs.quick_programs():
        KeptFunction(scaled)(jnp.ones(2), 2.0)
    lower = programs._lowered
    with monkeypatch.context() as patch, quick_programs.quick_programs():
        patch.setattr(programs, "_lowered", lambda *_: pytest.fail("compiled"))
        kept = KeptFunction(scaled)
        np.testing.assert_array_equal(kept(jnp.ones(2), 2.0), [2.0, 2.0])
        patch.setattr(programs, "_lowered", lower)
        quick_programs.optimise_programs()
        kept(jnp.ones(2), 3.0)
        optimised(folder)
    join_optimisers()
    np.testing.assert_array_equal(kept(jnp.ones(2), 4.0), [4.0, 4.0])


def test_what_one_context_has_not_optimised_the_next_one_does(folder: Path) -> None:
    kept = [KeptFunction(lambda x, number=number: jnp.sin(x) + number) for number in range(5)]
    end = time.monotonic() + 30.0
    while True:
        assert time.monotonic() < end
        with quick_programs.quick_programs():
            for function in kept:
                function(jnp.ones(2))
            quick_programs.optimise_programs()
            for function in kept:
                function(jnp.ones(2))
        if not any(function._to_optimise for function in kept):
            break
    optimised(folder)


def test_a_context_within_another_ends_nothing(folder: Path) -> None:
    with quick_programs.quick_programs():
        with quick_programs.quick_programs(wanted=False), quick_programs.quick_programs():
            pass
        KeptFunction(scaled)(jnp.ones(2), 2.0)
    assert names(folder) == {quick_programs.QUICK_SUFFIX}


def test_a_quick_program_is_for_its_context_alone(folder: Path) -> None:
    with quick_programs.quick_programs():
        KeptFunction(scaled)(jnp.ones(2), 2.0)
    KeptFunction(scaled)(jnp.ones(2), 2.0)
    quick_programs.optimise_programs()
    assert names(folder) == {".program"} and quick_programs._optimiser is None


def test_a_damaged_quick_program_is_made_again(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    with quick_programs.quick_programs():
        KeptFunction(scaled)(jnp.ones(2), 2.0)
    (file,) = folder.iterdir()
    file.write_bytes(file.read_bytes()[:-9])
    with quick_programs.quick_programs():
        np.testing.assert_array_equal(KeptFunction(scaled)(jnp.ones(2), 2.0), [2.0, 2.0])
    (line,) = (record.getMessage() for record in caplog.records)
    assert "damaged" in line and names(folder) == {quick_programs.QUICK_SUFFIX}


def test_the_folder_has_a_bound(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "MOST_BYTES", 0)
    np.testing.assert_array_equal(KeptFunction(scaled)(jnp.ones(2), 2.0), [2.0, 2.0])
    assert not list(folder.iterdir())


def test_code_from_outside_is_not_kept(folder: Path) -> None:
    @pytree
    class Torch(AmbientLight):
        """A kind of light whose code may change from one run to the next."""

    assert np.allclose(KeptFunction(lambda light: light.color)(Torch(1.0, (1.0, 1.0, 1.0))), 1.0)
    assert not list(folder.iterdir())


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(programs, "_folder", tmp_path / "file")
    np.testing.assert_array_equal(KeptFunction(scaled)(jnp.ones(2), 2.0), [2.0, 2.0])


def test_programs_are_forgotten_before_memory_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(programs, "_folder", tmp_path)
    before = programs.run_kept(_doubled, jnp.ones(3))
    assert not programs.forget_programs_in_time() and programs._functions[(_doubled,)]._ready
    monkeypatch.setattr(programs, "MOST_AREAS", 0.0)
    assert programs.forget_programs_in_time() and (_doubled,) not in programs._functions
    np.testing.assert_array_equal(programs.run_kept(_doubled, jnp.ones(3)), before)


def _doubled(x: jax.Array) -> jax.Array:
    return 2.0 * x


def _powered(x: jax.Array, *, factor: float = 1.0, power: int = 1) -> jax.Array:
    return factor * x**power


def test_programs_are_kept_for_every_value_of_all_fixed_arguments(folder: Path) -> None:
    x = jnp.arange(3.0)
    for fixed in ({}, {"factor": 2.0}, {"power": 2}, {"factor": 2.0, "power": 2}, {"power": 2, "factor": 3.0}):
        np.testing.assert_array_equal(programs.run_kept(_powered, x, **fixed), _powered(x, **fixed))
    assert len(list(folder.iterdir())) == 5
    programs.make_ready(_powered, x, power=2, factor=3.0)
    assert len(list(folder.iterdir())) == 5


def test_functions_with_options_of_their_own_exist() -> None:
    for name in (*programs.CASCADES, *programs.LONG):
        module, function = name.rsplit(".", 1)
        assert callable(getattr(importlib.import_module(f"hyjax.{module}"), function))
