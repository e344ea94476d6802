"""Configuration: all choices of how a frame is relit, as one file.

    python examples/10_configuration.py [SIZE]

Picture: a frame relit by the default; by the preset `fast`; by a configuration of your own (the paper's schedule,
no bounces).
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/10_configuration.png")

paper = hyjax.Configuration.of(hyjax.Schedule.preset("paper-80"))  # the default but for its schedule
own = paper.with_choices({"sampling": 1, "bounces": False})  # by the names of hyjax/choices/table.py

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
pictures = [scene.relit(8, "evening-lamps", configuration).image for configuration in (None, "fast", own)]

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(picture) for picture in pictures], axis=1))
# own.to_json() is the file that `hyjax relight --configuration FILE` takes.
print(f"{OUT}: own choices are {own.light}")
