"""Shared by all tests: strictness settings and the data folder."""

import os
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import jax
import pytest

hypothesis.settings.register_profile("hyjax", derandomize=True, deadline=None, max_examples=25, database=None)
hypothesis.settings.load_profile("hyjax")


@pytest.fixture(scope="session")
def kitchen() -> Path:
    """The 7-Scenes kitchen capture, at $HYJAX_DATA/kitchen or beside the checkout in shared/data."""
    data = os.environ.get("HYJAX_DATA") or Path(__file__).parents[2] / "shared" / "data"
    folder = Path(data) / "kitchen"
    if not folder.is_dir():
        pytest.skip(f"no kitchen capture in {folder}; point HYJAX_DATA at the folder that holds kitchen/")
    return folder


@pytest.fixture(scope="module")
def strict_ranks() -> Iterator[None]:
    """Refuse implicit rank promotion, as the modules of the paper's equations must never need it."""
    with jax.numpy_rank_promotion("raise"):
        yield
