"""Shadow pass: shadows refined by themselves, instead of in the filter that the cascade smooths.

    python examples/05_shadow_pass.py [SIZE]

Picture: light with raw shadows; both diffused together; light and shadows each refined alone, then multiplied.
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/05_shadow_pass.png")

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
view = scene.view(8)
setup = scene.lights("evening-lamps")
shaded = view.shade(setup, shadow_maps=scene.shadow_maps(setup))
light, shadow = shaded.illuminance, shaded.visibility  # a channel for each lamp
known = shaded.confidence > 0  # not in the scan's holes

cascade = hyjax.Schedule.preset("hyjax")
together = hyjax.cascade_known(light * shadow, known, view.display, cascade)
filled = hyjax.fill_visibility(shadow, (light > 0) & known, view.display)
refined = hyjax.shadow_pass(filled, view.display, hyjax.Schedule.preset("hyjax-scan-shadow"))
apart = hyjax.cascade_known(light, known, view.display, cascade) * refined

OUT.parent.mkdir(parents=True, exist_ok=True)
pictures = [hyjax.colored(each, setup.lights) / setup.reference_lux for each in (light * shadow, together, apart)]
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(picture) for picture in pictures], axis=1))
print(f"{OUT}: {shadow.shape[-1]} lamps")
