"""Export of a graph: the cascade of a schedule as a file for another runtime, checked before it is written.

    python examples/13_export_a_graph.py [SIZE]

Picture: a filter; the same repaired by the exported file.
"""

import sys
from pathlib import Path

import numpy as np
from jax import export

import hyjax
from hyjax.export.run import export_file
from hyjax.export.settings import ExportSettings

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/13_export_a_graph.png")

# `to` may be stablehlo, iree, onnx, litert or coreml; all but StableHLO need an extra.
settings = ExportSettings(
    to="stablehlo",
    what="plain-cascade",
    scene=hyjax.SceneSettings(size=SIZE),
    schedule="paper-50",
    out=OUT.with_suffix(""),
    quiet=True,
)
folder = export_file(settings)
(file,) = folder.glob("*.jaxexport")
repair = export.deserialize(bytearray(file.read_bytes()))
print(f"{file}: {file.stat().st_size // 1000} kB; inputs {[str(shape) for shape in repair.in_avals]}")

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
view, setup = scene.view(8), scene.lights("two-colors")
raw = hyjax.shade(view.gbuffer, setup.lights) / setup.reference_lux
by_file = repair.call(raw, view.display)
by_jax = hyjax.cascade(raw, view.display, settings.open_schedule())
print(f"differs from JAX by {float(abs(by_file - by_jax).max()):.1e}")

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(raw), hyjax.to_display(by_file)], axis=1))
