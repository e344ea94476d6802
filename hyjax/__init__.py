"""Relight camera frames of real rooms: the Hybrelighter pipeline as pure JAX functions.

The functions here take and return arrays and work under jit, grad and vmap (checks of values, such as κ > 0, happen
only where the values are known). Cameras, meshes and ray casting are in
`hyjax.geometry`, captures in `hyjax.data`, scenes in `hyjax.scene`.

Names are loaded when they are first asked for; `__init__.pyi` says from where.
"""

import os
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path

import lazy_loader

_SUM_OPTION = "--xla_cpu_experimental_ynn_fusion_type"


def _avoid_wrong_sums() -> None:
    """Have XLA sum by its own code where jaxlib is 0.10.2 or 0.11.

    There sums by YNNPACK on a processor with several cores are wrong at times, without a word, as
    `jnp.mean(x, where=mask)` in a jitted function. Sources: jax-ml/jax#39103, tensorflow/tensorflow#126812. XLA
    reads the variable when JAX starts its first backend.
    """
    found, flags = find_spec("jaxlib"), os.environ.get("XLA_FLAGS", "").strip()
    if found is None or found.origin is None or _SUM_OPTION in flags:
        return
    releases = Path(found.origin).parents[1].glob("jaxlib-*.dist-info")
    if not any(path.name.startswith(("jaxlib-0.10.2.", "jaxlib-0.11.")) for path in releases):
        return
    option = f"{_SUM_OPTION}=-reduce"
    started = getattr(sys.modules.get("jax._src.xla_bridge"), "_backends", None)
    if started or (flags and not flags.startswith("-")):  # a file's name, to which nothing can be added
        place = "set it before JAX's first use, or import hyjax first" if started else f"add it to {flags}"
        danger = f"XLA_FLAGS lacks {option}, without which sums may be wrong (jax-ml/jax#39103)"
        warnings.warn(f"{danger}: {place}", stacklevel=3)  # the line that imports hyjax
        return
    os.environ["XLA_FLAGS"] = f"{flags} {option}".strip()


_avoid_wrong_sums()
__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
