"""Configuration: all choices of how a frame is relit, as one file.

    python examples/10_configuration.py [SIZE]

Picture: a frame relit by the default; by the preset `fast`; by a configuration of your own (the paper's schedule,
no bounces).
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import hyjax
from hyjax.configuration import LightOptions

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/10_configuration.png")
FOLDER = OUT.with_suffix("")

own = dataclasses.replace(
    hyjax.Configuration(),
    name="own",
    schedule=hyjax.Schedule.preset("paper-80"),
    light=LightOptions(sampling=1, bounces=False),
).check()
FOLDER.mkdir(parents=True, exist_ok=True)
(FOLDER / "own.json").write_text(own.to_json())

settings = hyjax.RelightSettings(
    scene=hyjax.SceneSettings(size=SIZE), frames="8", lights="evening-lamps", quiet=True
)
pictures = []
for name in ("default", "fast", str(FOLDER / "own.json")):
    out = FOLDER / Path(name).stem
    # What `hyjax relight --configuration NAME` does: PNG, EXR, contact sheet, lights.json and run.json.
    record = hyjax.relight_capture(dataclasses.replace(settings, configuration=name, out=out))
    pictures.append(np.asarray(Image.open(out / "008.relit.png"), np.float32)[..., :3] / 255.0)
    print(f"{name}: {', '.join(sorted(path.name for path in out.iterdir()))}")

hyjax.write_png(OUT, np.concatenate(pictures, axis=1))
print(f"{OUT}: by {record['versions']['jax']=}")
