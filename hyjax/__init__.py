"""Relight camera frames of real rooms: the Hybrelighter pipeline as pure JAX functions.

The functions here take and return arrays and work under jit, grad and vmap (checks of values, such as κ > 0, happen
only where the values are known). Cameras, meshes and ray casting are in
`hyjax.geometry`, captures in `hyjax.data`, scenes in `hyjax.scene`.

Names are loaded when they are first asked for; `__init__.pyi` says from where.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
