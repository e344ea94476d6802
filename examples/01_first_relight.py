"""First relight: a frame of the built-in room under its evening lamps.

    python examples/01_first_relight.py [SIZE]

Picture: the photo; the same frame relit.
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/01_first_relight.png")

# Without `capture=Path(...)` this is the built-in room, rendered on first use and kept in the cache folder.
scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
relit = scene.relit(8, "evening-lamps")

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([scene.frame(8).image, hyjax.to_display(relit.image)], axis=1))
print(f"{OUT}: mean light {float(relit.relight_filter.mean()):.2f} of the photo's")
