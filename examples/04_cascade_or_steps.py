"""Cascade or steps: how far light gets in a cascade, and by steps at one resolution.

    python examples/04_cascade_or_steps.py [SIZE]

Picture: the raw filter of a rough scan; 50 steps in a cascade; 50 steps at half size; 1000 steps at half size.
"""

import sys
import time
from pathlib import Path

import jax
import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/04_cascade_or_steps.png")
KAPPA = 0.05

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
view = scene.view(8)
setup = scene.lights("two-colors")
raw = (
    hyjax.shade(view.gbuffer, setup.lights) / setup.reference_lux
)  # black where the scan has a hole, as in the paper

pictures = [hyjax.to_display(raw)]
for name in ("paper-50", "naive-50", "naive-1000"):
    schedule = hyjax.Schedule.preset(name, kappa=KAPPA)
    hyjax.cascade(raw, view.display, schedule).block_until_ready()  # the first call compiles
    start = time.perf_counter()
    refined = jax.block_until_ready(hyjax.cascade(raw, view.display, schedule))
    print(f"{name}: {1e3 * (time.perf_counter() - start):.1f} ms")
    pictures.append(hyjax.to_display(refined))

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate(pictures, axis=1))
print(OUT)
