"""Video: refined light is carried along the surface from frame to frame, so that it does not flicker.

    python examples/12_video.py [SIZE]

Picture: four frames, relit with the memory. They are farther apart than those of a recording, so outlines of
earlier frames are left at jumps of depth, and do not fade.
"""

import sys
from pathlib import Path

import numpy as np

import hyjax

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/12_video.png")
FRAMES = range(8, 12)

scene = hyjax.Scene.open(hyjax.SceneSettings(size=SIZE))
setup, schedule = scene.lights("evening-lamps", at_photo_sources=True), hyjax.Schedule.preset("hyjax")
video = hyjax.video.Video()  # the memory: light at the last frame's surface points

pictures, changes = [], []
for index in FRAMES:
    view = scene.view(index)
    shaded = scene.shade(view, setup)
    alone = hyjax.relight(view, shaded, view.display, schedule)
    steady = hyjax.relight(
        view,
        shaded,
        view.display,
        schedule,
        temporal_filter=video.filter(view, setup, view.display, schedule),
    )
    changes.append(float(abs(steady.relight_filter - alone.relight_filter).mean()))
    pictures.append(hyjax.to_display(steady.image))

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate(pictures, axis=1))
print(f"{OUT}: the memory changes the filter by {', '.join(f'{change:.3f}' for change in changes)}")
