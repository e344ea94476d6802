"""Shared by all tests: strictness settings, data and weights from outside."""

import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import jax
import numpy as np
import pytest

from hyjax.errors import InputError
from hyjax.images import read_image
from hyjax.metrics import LpipsWeights, load_lpips

# `experiments` is not installed; after what is, so that `hyjax` stays the installed one.
sys.path.append(str(Path(__file__).parents[1]))

# Most of what tests compile runs once, and optimising it takes longer than it saves. What tests start is optimised.
UNOPTIMISED = "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
FLAGS = os.environ.get("XLA_FLAGS", "")
os.environ["XLA_FLAGS"] = f"{UNOPTIMISED} {FLAGS}"
jax.block_until_ready(jax.jit(lambda x: x + 1)(0.0))  # XLA reads its flags with the first program
os.environ["XLA_FLAGS"] = FLAGS
COMPILED = "HYJAX_TESTS_COMPILED"

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


def data_folder() -> Path:
    """$HYJAX_DATA, or shared/data beside the checkout."""
    return Path(os.environ.get("HYJAX_DATA") or Path(__file__).parents[2] / "shared" / "data")


@pytest.fixture(scope="session")
def kitchen() -> Path:
    """The 7-Scenes kitchen capture."""
    folder = data_folder() / "kitchen"
    if not folder.is_dir():
        pytest.skip(f"no kitchen capture in {folder}; point HYJAX_DATA at the folder that holds kitchen/")
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
