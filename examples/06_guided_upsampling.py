"""Guided upsampling: from an eighth of the size back to full size, without mixing across the frame's edges.

    python examples/06_guided_upsampling.py [SIZE]

Picture: a filter at full size; its cells; upsampled bilinearly; upsampled under the guide of the frame.
"""

import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/06_guided_upsampling.png")
FACTOR, KAPPA = 8, 0.05

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE, mesh="true"))  # the room's accurate surface: no holes
view = scene.view(8)
setup = scene.lights("two-colors")
fine = hyjax.shade(view.gbuffer, setup.lights) / setup.reference_lux

cells = hyjax.downsample(fine, FACTOR)
bilinear = hyjax.upsample(cells, FACTOR, fine.shape[:2])
guided = hyjax.guided_upsample(cells, FACTOR, view.display, KAPPA)
blocks = jnp.repeat(jnp.repeat(cells, FACTOR, axis=0), FACTOR, axis=1)[: fine.shape[0], : fine.shape[1]]

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(x) for x in (fine, blocks, bilinear, guided)], axis=1))
for name, picture in (("bilinear", bilinear), ("guided", guided)):
    print(f"{name}: {float(hyjax.metrics.psnr(hyjax.to_display(picture), hyjax.to_display(fine))):.1f} dB")
print(OUT)
