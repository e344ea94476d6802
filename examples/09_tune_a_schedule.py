"""Tuning a schedule: the one of the diffusion that makes the best picture within a time budget on this machine.

    python examples/09_tune_a_schedule.py [SIZE]

Picture: the scan's raw filter; refined by the schedule that was found; the accurate surface's filter.
"""

import sys
from pathlib import Path

import numpy as np

import hyjax
from hyjax.tuning.settings import FrameOptions, TuneScene

SIZE = sys.argv[1] if len(sys.argv) > 1 else "320x240"
OUT = Path("out/examples/09_tune_a_schedule.png")

settings = hyjax.TuneSettings(
    scene=TuneScene(size=SIZE),
    budget_ms=(40.0,),  # or fps=(25,)
    frames="2,8",
    holdout="20",
    frame=FrameOptions(trials=12),  # a short search; leave it out for one of five minutes
    extra=False,  # no other points of the curve of quality against time
    quiet=True,
)
tuned = hyjax.tune_schedule(settings=settings)
best = tuned.best[0]
print(f"{best.time.p95:.1f} ms (95 %), loss {best.tuning['loss']:.4f} on the tuning frames")
for known in tuned.references:
    print(f"beside it {known.name}: {known.time.median:.1f} ms, loss {known.tuning['loss']:.4f}")
print(tuned.schedule)

scan, true = (hyjax.Scene.open(hyjax.SceneSettings(size=SIZE, mesh=mesh)) for mesh in ("scan", "true"))
view, setup = scan.view(20), scan.lights("two-colors")
raw, target = (hyjax.shade(s.view(20).gbuffer, setup.lights) / setup.reference_lux for s in (scan, true))
refined = hyjax.cascade_known(raw, view.gbuffer.hit[..., None], view.display, tuned.schedule)

OUT.parent.mkdir(parents=True, exist_ok=True)
hyjax.write_png(OUT, np.concatenate([hyjax.to_display(x) for x in (raw, refined, target)], axis=1))
OUT.with_suffix(".json").write_text(tuned.schedule.to_json())  # for `hyjax relight --schedule`
