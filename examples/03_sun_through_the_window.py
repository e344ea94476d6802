"""Sun through the window: with and without the light that the photo was taken under.

    python examples/03_sun_through_the_window.py [SIZE]

Picture: the photo; relit with its own light left in; relit with it divided out, and with bounces (the default).
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/03_sun_through_the_window.png")

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))

# A frame is surface times light: multiplied with new light it still has the old shadows and highlights in it.
kept = hyjax.Configuration().with_choices({"photo_light": "kept"})
pictures = [scene.relit(20, "golden-hour", configuration).image for configuration in (kept, None)]

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([scene.frame(20).image, *map(hyjax.to_display, pictures)], axis=1))

# How the photo's light was estimated, and how far it is believed: look here first where a picture is odd.
record = scene.photo_light.record()
print(f"{OUT}: lit by {', '.join(record['sources'])}; differences on planes fall to {record['flatness']:.2f}")
