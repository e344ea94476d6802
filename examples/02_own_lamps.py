"""Lamps of your own: a lights file in YAML, and the same lamps made in Python.

    python examples/02_own_lamps.py [SIZE]

Picture: the photo; relit by the file; relit by lamps from Python, the bulb in another colour.
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/02_own_lamps.png")
LIGHTS = """
reference_lux: 25         # so much light leaves a frame as it is: less makes the picture brighter
lights:
  - {kind: point, position: [1.4, 1.6, 1.7], luminous_flux: 500, temperature: 2700, radius: 0.05}
  - {kind: spot, position: [3.2, 3.0, 2.4], target: [3.2, 3.0, 0], luminous_flux: 300, outer_degrees: 45}
  - {kind: ambient, illuminance: 4}
"""

OUT.parent.mkdir(parents=True, exist_ok=True)
file = OUT.with_suffix(".yaml")
file.write_text(LIGHTS)

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
by_file = scene.relit(8, file)

# Units are metres, lumens and lux; a light's colour is linear RGB.
blue = hyjax.LightSetup(
    (
        hyjax.PointLight(np.array([1.4, 1.6, 1.7]), 500.0, np.array([0.4, 0.6, 1.0]), radius=0.05),
        hyjax.AmbientLight(4.0, np.ones(3)),
    ),
    reference_lux=25.0,
)
by_python = scene.relit(8, blue)

pictures = [scene.frame(8).image, hyjax.to_display(by_file.image), hyjax.to_display(by_python.image)]
hyjax.write_png(OUT, np.concatenate(pictures, axis=1))
print(f"{OUT}: lamps from {file}")
