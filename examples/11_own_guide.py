"""Guide of your own: any features of the frame may say where light flows.

    python examples/11_own_guide.py [SIZE]

Picture: conductances under the frame's colours and under brightness divided out (white lets light pass); below,
the filter refined under each.
"""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/11_own_guide.png")

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
view, setup = scene.view(8), scene.lights("two-colors")
raw = hyjax.shade(view.gbuffer, setup.lights) / setup.reference_lux
known = view.gbuffer.hit[..., None]

# Colour without most of its brightness: cast shadows stop less light, borders of one colour let more pass.
brightness = view.display.mean(axis=-1, keepdims=True)
hue = view.display / (brightness + 0.1)
own = jnp.concatenate([0.25 * hue, 0.3 * brightness], axis=-1)  # any number of channels

rows = []
for name, guide in (("rgb", view.display), ("own", own)):
    down, right = hyjax.conductance(guide, 0.05)  # on the edges between neighbours: (h-1, w) and (h, w-1)
    passing = jnp.minimum(
        jnp.pad(down, ((0, 1), (0, 0)), mode="edge"), jnp.pad(right, ((0, 0), (0, 1)), mode="edge")
    )
    refined = hyjax.cascade_known(raw, known, guide, hyjax.Schedule.preset("hyjax"))
    print(f"{name}: mean conductance {float(passing.mean()):.2f}")
    rows.append(np.concatenate([jnp.repeat(passing[..., None], 3, axis=-1), hyjax.to_display(refined)], axis=0))

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate(rows, axis=1))
print(OUT)
