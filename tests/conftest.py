"""Shared by all tests: strictness settings, data and weights from outside."""

import contextlib
import ctypes
import gc
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import jax
import numpy as np
import pytest
import shape_checks
from common import UNOPTIMISED, data_folder

shape_checks.install()

from hyjax.metrics import LpipsWeights, load_lpips
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

# `experiments` is not installed; after what is, so that `hyjax` stays the installed one.
sys.path.append(str(Path(__file__).parents[1]))

FLAGS = os.environ.get("XLA_FLAGS", "")
os.environ["XLA_FLAGS"] = f"{UNOPTIMISED} {FLAGS}"
jax.block_until_ready(jax.jit(lambda x: x + 1)(0.0))  # XLA reads its flags with the first program
os.environ["XLA_FLAGS"] = FLAGS
COMPILED = "HYJAX_TESTS_COMPILED"
MOST_RESIDENT_MIB = 1000

hypothesis.settings.register_profile("hyjax", derandomize=True, deadline=None, max_examples=15, database=None)
hypothesis.settings.load_profile("hyjax")


def pytest_configure(config: pytest.Config) -> None:
    """What one worker has compiled the others take."""
    if COMPILED not in os.environ:
        folder = tempfile.TemporaryDirectory()
        config.add_cleanup(folder.cleanup)
        os.environ[COMPILED] = folder.name
        config.add_cleanup(lambda: os.environ.pop(COMPILED))
    jax.config.update("jax_compilation_cache_dir", os.environ[COMPILED])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests first: at the end no worker waits for another."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Compiled programs of earlier files are dropped where a worker has grown large."""
    last = nextitem is None or nextitem.path != item.path
    if last and resident_mib() > MOST_RESIDENT_MIB:
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)  # glibc


def resident_mib() -> float:
    """Memory of this process; 0 where the system does not tell."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20 if statm.is_file() else 0.0


@pytest.fixture(scope="session")
def kitchen() -> Path:
    """The 7-Scenes kitchen capture."""
    folder = data_folder() / "kitchen"
    if not folder.is_dir():
        pytest.skip(f"no kitchen capture in {folder}; point HYJAX_DATA at the folder that holds kitchen/")
    return folder


@pytest.fixture(scope="session")
def scanner3d_chair() -> Path:
    """A real scan by 3D Scanner App."""
    folder = data_folder() / "scanner3d_chair"
    if not folder.is_dir():
        pytest.skip(f"no scan in {folder}; point HYJAX_DATA at the folder that holds scanner3d_chair/")
    return folder


@pytest.fixture(scope="session")
def lpips_reference() -> dict[str, np.ndarray]:
    """The pictures of the LPIPS reference example: ref, p0 and p1, display values in [0, 1]."""
    folder = data_folder() / "lpips_reference"
    if not folder.is_dir():
        pytest.skip(f"no pictures in {folder}; point HYJAX_DATA at the folder that holds lpips_reference/")
    return {name: read_image(folder / f"ex_{name}.png") for name in ("ref", "p0", "p1")}


@pytest.fixture(scope="session")
def lpips_weights() -> LpipsWeights:
    """LPIPS-Alex, from the folder `weights` beside the data, or from where a user would have it."""
    path = data_folder().parent / "weights" / "lpips_alex_v0.1.npz"
    try:
        return load_lpips(path if path.is_file() else None)
    except InputError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def strict_ranks() -> Iterator[None]:
    """Refuse implicit rank promotion, as the modules of the paper's equations must never need it."""
    with jax.numpy_rank_promotion("raise"):
        yield
